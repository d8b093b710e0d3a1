"""Our own hand model files, which Blender loads when a take names them."""

from __future__ import annotations

import io
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from handfit_core.hand_model import save_model_npz
from tests.hostile.engine import Case
from tests.hostile.mutations import mutants
from tests.hostile.npz import header_lies, lies
from tests.imitation_mano import imitation_model

FILE = "hand.npz"


@cache
def good_bytes() -> bytes:
    with TemporaryDirectory() as folder:
        return save_model_npz(imitation_model(pose_blendshapes=False), Path(folder) / FILE).read_bytes()


@cache
def good_arrays() -> dict[str, np.ndarray]:
    with np.load(io.BytesIO(good_bytes())) as archive:
        # With the optional ones, which the imitation lacks.
        return {name: archive[name] for name in archive.files} | {
            "quads": np.zeros((2, 4), np.int32),
            "uv": np.zeros((4, 2), np.float32),
            "uv_faces": np.zeros((2, 3), np.int32),
        }


def cases() -> Iterator[Case]:
    yield from mutants("model", "core.model", good_bytes, FILE, 8, side="right")
    yield from lies("model", "core.model", good_arrays, FILE, side="right")
    header = [("format",), ("version",), ("name",), ("side",)]
    yield from header_lies("model", "core.model", good_arrays, FILE, header, side="right")
