"""Takes: damaged files, lies in the zip, in every array, and in every field of the header."""

from __future__ import annotations

import io
from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np

from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model import load_model
from handfit_core.media.source import Source
from handfit_core.skeleton import SIDES
from handfit_core.take import HandTrack, Take
from tests.hostile.engine import Case
from tests.hostile.mutations import mutants
from tests.hostile.npz import header_lies, lies

FRAMES = 6
_FIELDS = (
    "format version source source.kind source.files source.orientation fps width height intrinsics intrinsics.fx "
    "intrinsics.cx solver model model_digests model_digests.left sides"
)
HEADER = [tuple(field.split(".")) for field in _FIELDS.split(" ")]


def good_take(**fields: Any) -> Take:
    """Two hands that a camera sees, in a picture that is not there."""
    camera = Intrinsics(200.0, 200.0, 80.0, 60.0)
    hands = []
    for side in SIDES:
        found = load_model("open-hand", side)
        transl = np.linspace([0.0, 0.0, 0.5], [0.1, 0.0, 0.6], FRAMES)
        pose, turned = np.zeros((FRAMES, 45)), np.linspace([0.1, 0, 0], [0.9, 0.2, 0], FRAMES)
        points = found.posed(np.zeros(10), turned, pose, transl).keypoints
        hands.append(
            HandTrack(
                side=side,
                betas=np.zeros(10),
                global_orient=turned,
                hand_pose=pose,
                transl=transl,
                joints_3d=points,
                keypoints_2d=camera.project(points),
                reprojection_error=np.full(FRAMES, 0.5),
                detected=np.ones(FRAMES, bool),
                score=np.full(FRAMES, 0.9),
                keypoints_depth=np.zeros((FRAMES, 21)),
                world_landmarks=points - points[:, :1],
                doubtful=np.arange(FRAMES) == 2,
            )
        )
    values: dict[str, Any] = {
        "source": Source("photo", ("/nowhere/picture.png",)),
        "fps": 25.0,
        "frame_numbers": np.arange(1, FRAMES + 1),
        "width": 160,
        "height": 120,
        "intrinsics": camera,
        "solver": "fast",
        "model": "open-hand",
        "model_digests": {side: load_model("open-hand", side).digest for side in SIDES},
        "hands": tuple(hands),
    }
    return Take(**{**values, **fields})


@cache
def good_bytes() -> bytes:
    return good_take().to_bytes()


@cache
def one_hand() -> dict[str, np.ndarray]:
    with np.load(io.BytesIO(good_take(hands=good_take().hands[:1]).to_bytes())) as archive:
        return {name: archive[name] for name in archive.files}


def cases() -> Iterator[Case]:
    yield from mutants("take", "core.take", good_bytes, "a.take.npz", 12)
    yield from lies("take", "core.take", one_hand, "a.take.npz")
    yield from header_lies("take", "core.take", one_hand, "a.take.npz", HEADER)
    # The same doors as an artist opens them, where Blender builds what it reads.
    yield from mutants("import", "blender.import_take", good_bytes, "a.take.npz", 2)
    for case in (*lies("import", "blender.import_take", one_hand, "a.take.npz"),
                 *header_lies("import", "blender.import_take", one_hand, "a.take.npz", HEADER)):  # fmt: skip
        if case.known or sum(case.name.encode()) % 5 == 0:
            yield case
