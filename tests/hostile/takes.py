"""Takes: damaged files, lies in the zip, in every array, and in every field of the header."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from handfit_core.common.skeleton import SIDES
from handfit_core.geometry.camera import Intrinsics
from handfit_core.take import Take
from tests.hostile.engine import Case
from tests.hostile.mutations import mutants
from tests.hostile.npz import header_lies, lies, some
from tests.takes import seen_as, take_of, track_of

FILE = "a.take.npz"
FRAMES = 6
_FIELDS = (
    "format version source source.kind source.files source.orientation fps width height intrinsics intrinsics.fx "
    "intrinsics.cx solver model model_digests model_digests.left sides"
)
HEADER = [tuple(field.split(".")) for field in _FIELDS.split(" ")]


def good_take(**fields: Any) -> Take:
    """Two hands that a camera sees, in a picture that is not there."""
    camera = Intrinsics(200.0, 200.0, 80.0, 60.0)
    transl = np.linspace([0.0, 0.0, 0.5], [0.1, 0.0, 0.6], FRAMES)
    pose, turned = np.zeros((FRAMES, 45)), np.linspace([0.1, 0, 0], [0.9, 0.2, 0], FRAMES)
    hands = []
    for side in SIDES:
        hand = track_of(side, turned, pose, transl, camera, doubtful=np.arange(FRAMES) == 2)
        world = hand.joints_3d - hand.joints_3d[:, :1]
        hand = seen_as(hand, keypoints_depth=np.zeros((FRAMES, 21)), world_landmarks=world)
        touches = np.full((FRAMES, 21), np.nan)
        touches[2, 8] = 4.0
        hands.append(replace(hand, expected_error=np.full((FRAMES, 5), 0.01), touches=touches))
    return replace(take_of(hands, camera, 160, 120), **fields)


@cache
def good_bytes() -> bytes:
    return good_take().to_bytes()


@cache
def one_hand() -> dict[str, np.ndarray]:
    with np.load(io.BytesIO(good_take(hands=good_take().hands[:1]).to_bytes())) as archive:
        return {name: archive[name] for name in archive.files}


def cases() -> Iterator[Case]:
    yield from mutants("take", "core.take", good_bytes, FILE, 12)
    yield from lies("take", "core.take", one_hand, FILE)
    yield from header_lies("take", "core.take", one_hand, FILE, HEADER)
    # As an artist opens them, where Blender builds what it reads.
    door = "blender.import_take"
    yield from mutants("import", door, good_bytes, FILE, 2)
    for case in (*lies("import", door, one_hand, FILE), *header_lies("import", door, one_hand, FILE, HEADER)):
        if case.known or some(case.name, 5):
            yield case
