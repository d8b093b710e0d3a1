"""Animations of SMPL-X and SMPL+H bodies with hands, as AMASS, BEDLAM and BEAT2 have them."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

from handfit_core.doors.values import Unfit
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.interchange import mano
from handfit_core.interchange.document import Document
from handfit_core.interchange.every_frame import EveryFrame, written
from handfit_core.interchange.readers import Reader
from handfit_core.interchange.recording import Asked, Recording
from handfit_core.interchange.skeletons import UP_AXES
from handfit_core.interchange.writers import Writer
from handfit_core.skeleton import SIDES, Side
from handfit_core.take import Take

_HANDS: Final[dict[int, dict[Side, slice]]] = {
    156: {"left": slice(66, 111), "right": slice(111, 156)},
    165: {"left": slice(75, 120), "right": slice(120, 165)},
}
"""Where the hands are in a row of `poses`: of SMPL+H, and of SMPL-X, which has jaw and eyes before them"""
_NAMES: Final = {156: "SMPL+H", 165: "SMPL-X"}
_WRISTS: Final[dict[Side, slice]] = {"left": slice(60, 63), "right": slice(63, 66)}
_RATES: Final = ("mocap_frame_rate", "mocap_framerate", "fps", "frame_rate")
_PRESENT: Final = "hands_present"
"""(T, 2) bool, of our files only: frames in which the left and the right hand was seen"""


def _recognises(document: Document) -> bool:
    names = document.names
    if "poses" in names:
        return "trans" in names or any(rate in names for rate in _RATES)
    return {"pose_body", "pose_hand", "root_orient"} <= set(names)


def _read(document: Document, asked: Asked) -> Recording:
    assumed: list[str] = []
    pelvis, body, hands = _parts(document)
    told = next((document.value(name) for name in _RATES if name in document.names), None)
    fps = mano.rate(told, asked)
    if len(pelvis) > 1 and not any(np.any(np.nan_to_num(hand - hand[0])) for hand in hands.values()):
        assumed.append("the fingers never move: this body was captured without its hands")
    # BEAT2's files are posed with a model that adds the mean; all others' with one that does not.
    beat = str(document.value("model")) == "smplx2020"
    turn = mano.standing(pelvis, assumed)
    present = document.value(_PRESENT)
    posed = []
    for side in SIDES:
        flat = mano.from_flat(hands[side], side, asked, "mean" if beat else "flat")
        hand = mano.of_body(side, pelvis, body, flat)
        if present is not None:
            there = mano.numbers(_PRESENT, present, 2)[:, SIDES.index(side)] > 0.0
            hand = mano.only(hand, there)
        posed.append(mano.seen_from(hand, asked, turn))
    return mano.recording_of(
        "smplx", document, fps, np.arange(1, len(pelvis) + 1), posed, asked, [*assumed, mano.NO_PLACE]
    )


def _parts(document: Document) -> tuple[np.ndarray, np.ndarray, dict[Side, np.ndarray]]:
    """The pelvis (T, 3), the body's other joints (T, 63) and the hands (T, 45), axis-angle."""
    if "poses" not in document.names:
        pelvis = mano.rotations("root_orient", document.value("root_orient"), 1)
        body = mano.rotations("pose_body", document.value("pose_body"), mano.BODY_JOINTS, len(pelvis))
        both = mano.rotations("pose_hand", document.value("pose_hand"), 30, len(pelvis))
        return pelvis, body, {"left": both[:, :45], "right": both[:, 45:]}
    poses = np.asarray(document.value("poses"), dtype=np.float64)
    poses = poses.reshape(len(poses), -1) if poses.ndim > 2 else poses
    if poses.ndim != 2 or poses.shape[1] not in _HANDS or not len(poses):
        found = "x".join(map(str, poses.shape))
        without = ": SMPL's bodies have no fingers" if poses.shape[-1:] in ((66,), (72,)) else ""
        raise Unfit(f"poses must have 165 numbers a frame (SMPL-X) or 156 (SMPL+H), and are {found}{without}")
    poses = mano.rotations("poses", poses, poses.shape[1] // 3)
    hands: dict[Side, np.ndarray] = {side: poses[:, part] for side, part in _HANDS[poses.shape[1]].items()}
    if not any(np.any(np.nan_to_num(hand)) for hand in hands.values()):
        raise Unfit(f"the fingers of this {_NAMES[poses.shape[1]]} animation never move: it has none")
    return poses[:, :3], poses[:, 3:66], hands


def _write(take: Take, path: Path) -> None:
    """The wrists are those of a body that stands still with its arms out, y-up; their place is not kept, as
    it depends on the body."""
    frames = EveryFrame.of(take)
    poses = np.zeros((len(frames.numbers), 165))
    present = np.zeros((len(poses), 2), dtype=bool)
    for side, hand in frames.hands.items():
        poses[:, _HANDS[165][side]] = hand.hand_pose
        turned = UP_AXES["y"] @ rotvec_to_rotmat(hand.global_orient)
        poses[:, _WRISTS[side]] = rotmat_to_rotvec(turned)
        present[:, SIDES.index(side)] = frames.present[side]
    arrays: dict[str, Any] = {
        "trans": np.zeros((len(poses), 3)),
        "gender": np.array("neutral"),
        "betas": np.zeros(16),
        "poses": poses,
        "mocap_frame_rate": np.array(frames.fps),
        "surface_model_type": np.array("smplx"),
        _PRESENT: present,
    }
    written(path, arrays)


READER = Reader(
    "SMPL-X or SMPL+H",
    "an .npz with poses of 165 or 156 numbers a frame, trans and mocap_frame_rate (AMASS, BEDLAM, BEAT2)",
    _recognises,
    _read,
)
WRITER = Writer("SMPL-X", (".smplx.npz",), _write)
