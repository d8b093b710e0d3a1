"""Parameters under the names with which the package smplx is called.

Written: both hands, for `smplx.MANO(use_pca=False, flat_hand_mean=True)`. Read: these, bodies of SMPL-X frame
by frame as SMPLer-X writes them, and whole sequences as ARCTIC's.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from handfit_core.doors.values import Unfit
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.motion import POSE_ARRAYS, HandMotion
from handfit_core.interchange import mano
from handfit_core.interchange.document import Document
from handfit_core.interchange.every_frame import EveryFrame, written
from handfit_core.interchange.readers import Reader
from handfit_core.interchange.recording import Asked, Recording
from handfit_core.interchange.writers import Writer
from handfit_core.skeleton import SIDES
from handfit_core.take import Take

_BODY: Final = {"global_orient", "body_pose", *tuple(f"{side}_hand_pose" for side in SIDES)}
_FRAME_AND_BOX: Final = re.compile(r"(\d+)_(\d+)")


def _of_hands(document: Document) -> bool:
    names = set(document.names)
    return any({f"{side}_hand_pose", f"{side}_global_orient"} <= names for side in SIDES)


def _of_body(document: Document) -> bool:
    return set(document.names) >= _BODY


def _bodies(document: Document) -> list[Path]:
    """The files of SMPLer-X's output folder, or of the folder `smplx` in it."""
    inside = Document(document.path / "smplx")
    folder = inside if inside.is_folder else document
    return [path for path in folder.files(".npz") if _FRAME_AND_BOX.fullmatch(path.stem)]


def _recognises(document: Document) -> bool:
    if document.is_folder:
        files = _bodies(document)
        return bool(files) and _of_body(Document(files[0]))
    return _of_hands(document) or _of_body(document)


def _read(document: Document, asked: Asked) -> Recording:
    if document.is_folder:
        return _smpler_x(document, asked)
    return _hands(document, asked) if _of_hands(document) else _sequence(document, asked)


def _hands(document: Document, asked: Asked) -> Recording:
    """Hands as `_write` has them."""
    assumed: list[str] = []
    posed, count = [], 0
    for side in SIDES:
        values = {
            name: document.value(f"{side}_{name}")
            for name in ("global_orient", "hand_pose", "transl", "betas")
        }
        if values["hand_pose"] is None:
            continue
        pose = mano.rotations(f"{side}_hand_pose", values["hand_pose"], 15)
        orient = mano.rotations(f"{side}_global_orient", values["global_orient"], 1, len(pose))
        pose = mano.from_flat(pose, side, asked, "flat")
        place = values["transl"]
        transl = mano.nowhere(len(pose)) if place is None else mano.numbers(f"{side}_transl", place, 3)
        shape = mano.shape_of(values["betas"], asked, assumed)
        hand = HandMotion(side, shape, orient, pose, transl)
        present = document.value(f"{side}_present")
        if present is not None:
            hand = mano.only(hand, mano.numbers(f"{side}_present", present, 1)[:, 0] > 0.0)
        posed.append(hand)
        count = max(count, len(orient))
    fps = mano.rate(document.value("fps"), asked)
    given = document.value("frame_numbers")
    frames = np.arange(1, count + 1) if given is None else np.asarray(given).reshape(-1)
    size, camera = _size_and_camera(document)
    return mano.recording_of(
        "smplx-keywords", document, fps, frames, posed, asked, assumed, size=size, intrinsics=camera
    )


def _size_and_camera(document: Document) -> tuple[tuple[int, int] | None, Intrinsics | None]:
    size, camera = document.value("picture_size"), document.value("intrinsics")
    if size is None or camera is None:
        return None, None
    width, height = mano.numbers("picture_size", size, 2)[0]
    return (int(width), int(height)), Intrinsics(*map(float, mano.numbers("intrinsics", camera, 4)[0]))


def _sequence(document: Document, asked: Asked) -> Recording:
    """A body over a sequence, with the flat hands that ARCTIC's bodies are posed with."""
    assumed = [mano.NO_PLACE]
    pelvis = _pelvis(document)
    turn = mano.standing(pelvis, assumed)
    posed = [mano.seen_from(hand, asked, turn) for hand in _of_one_body(document, asked, pelvis, "flat")]
    told = next((document.value(n) for n in ("mocap_frame_rate", "fps") if n in document.names), None)
    fps = mano.rate(told, asked)
    frames = np.arange(1, len(pelvis) + 1)
    return mano.recording_of("smplx-keywords", document, fps, frames, posed, asked, assumed)


def _pelvis(document: Document) -> np.ndarray:
    """(T, 3), of as many frames as the rest of the body, which tells three turns from one matrix."""
    body = mano.rotations("body_pose", document.value("body_pose"), mano.BODY_JOINTS)
    return mano.rotations("global_orient", document.value("global_orient"), 1, len(body))


def _of_one_body(
    document: Document, asked: Asked, pelvis: np.ndarray, counted: mano.Counted
) -> list[HandMotion]:
    body = mano.rotations("body_pose", document.value("body_pose"), mano.BODY_JOINTS, len(pelvis))
    hands = []
    for side in SIDES:
        name = f"{side}_hand_pose"
        value = document.value(name)
        if np.size(value) and np.shape(value)[-1] not in (3, 45):
            coefficients = np.asarray(value, dtype=np.float64)
            pose = mano.from_directions(coefficients.reshape(len(pelvis), -1), side, asked)
        else:
            pose = mano.rotations(name, value, 15, len(pelvis))
        pose = mano.from_flat(pose, side, asked, counted)
        hands.append(mano.of_body(side, pelvis, body, pose))
    return hands


def _smpler_x(document: Document, asked: Asked) -> Recording:
    """One body a file, FRAME_PERSON.npz, in the camera frame, its hands relative to the mean."""
    assumed = [mano.NO_PLACE]
    found: list[mano.FoundHand] = []
    paths: Sequence[Path] = _bodies(document)
    for path in paths:
        match = _FRAME_AND_BOX.fullmatch(path.stem)
        assert match is not None
        one = Document(path)
        if not _of_body(one):
            raise Unfit(f"{path.name} must hold a body of SMPL-X, and is {one.found}")
        pelvis = _pelvis(one)
        if len(pelvis) != 1:
            raise Unfit(f"{path.name} must hold one body, and has {len(pelvis)}")
        for hand in _of_one_body(one, asked, pelvis, "mean"):
            found.append(mano.FoundHand(**vars(hand), frame=int(match[1]), person=int(match[2])))
    frames = np.array(sorted({hand.frame for hand in found}))
    posed = mano.followed(found, frames, asked, assumed)
    if len({hand.person for hand in found}) > 1:
        assumed.append("persons are told apart by the number in the files' names, which may change places")
    fps = asked.rate
    return mano.recording_of("smplx-keywords", document, fps, frames, posed, asked, assumed, chosen=True)


def _write(take: Take, path: Path) -> None:
    frames = EveryFrame.of(take)
    camera = take.intrinsics
    arrays: dict[str, Any] = {
        "frame_numbers": frames.numbers,
        "fps": np.array(frames.fps),
        "picture_size": np.array([take.width, take.height]),
        "intrinsics": np.array([camera.fx, camera.fy, camera.cx, camera.cy]),
        "flat_hand_mean": np.array(True),
    }
    for side, hand in frames.hands.items():
        for name, rows in zip(POSE_ARRAYS, hand.pose, strict=True):
            arrays[f"{side}_{name}"] = rows
        arrays[f"{side}_betas"] = hand.betas[None]
        arrays[f"{side}_present"] = frames.present[side]
    written(path, arrays)


READER = Reader(
    "smplx's parameters",
    "left_hand_pose and right_hand_pose with global_orient and body_pose (SMPLer-X's folder smplx, ARCTIC's "
    ".smplx.npy), or hands as this program writes them",
    _recognises,
    _read,
)
WRITER = Writer("smplx's parameters", (".mano.npz",), _write)
