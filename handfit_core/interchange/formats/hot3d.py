"""HOT3D: mano_hand_pose_trajectory.jsonl, and the folders of its clips with *.hands.json.

15 coefficients of MANO's principal directions with its mean pose, the wrist as smplx has it: its turn is
global_orient and its place transl, in the world. Hand 0 is the left one.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Final

import numpy as np

from handfit_core.doors.values import Unfit, whole
from handfit_core.geometry.rotations import quat_to_rotmat, rotmat_to_rotvec
from handfit_core.interchange import mano
from handfit_core.interchange.document import Document
from handfit_core.interchange.readers import Reader
from handfit_core.interchange.recording import Asked, Recording
from handfit_core.interchange.skeletons import UP_AXES
from handfit_core.skeleton import SIDES

_OF_CLIPS: Final = re.compile(r"(\d+)\.hands\.json")


def _recognises(document: Document) -> bool:
    if document.is_folder:
        return bool(_clip(document))
    lines = document.lines
    return bool(lines) and isinstance(lines[0], dict) and {"timestamp_ns", "hand_poses"} <= set(lines[0])


def _clip(document: Document) -> list[Path]:
    return [path for path in document.files(".json") if _OF_CLIPS.fullmatch(path.name)]


def _read(document: Document, asked: Asked) -> Recording:
    assumed = [mano.UNTOLD_WORLD]
    found: list[mano.FoundHand] = []
    told = None
    if document.is_folder:
        numbers = []
        for path in _clip(document):
            match = _OF_CLIPS.fullmatch(path.name)
            assert match is not None
            numbers.append(int(match[1]))
            hands = Document(path).json
            if not isinstance(hands, dict):
                raise Unfit(f"{path.name} is no JSON of hands")
            for side in SIDES:
                pose = (hands.get(side) or {}).get("mano_pose")
                if pose is not None:
                    found.append(_hand(numbers[-1], SIDES.index(side), pose, asked))
    else:
        lines = _of_one_camera(document.lines or [])
        times = [whole("timestamp_ns", line["timestamp_ns"]) for line in lines]
        if len(times) > 1 and np.median(np.diff(times)) > 0:
            told = 1.0 / (1e-9 * float(np.median(np.diff(times))))
        numbers = list(range(1, len(lines) + 1))
        for number, line in zip(numbers, lines, strict=True):
            for index, pose in line["hand_poses"].items():
                if index not in ("0", "1"):
                    raise Unfit(f"hand_poses must be 0 (left) and 1 (right), and has {index[:40]}")
                found.append(_hand(number, int(index), pose, asked))
    frames = np.array(sorted(numbers))
    posed = [
        mano.seen_from(hand, asked, UP_AXES["z"]) for hand in mano.followed(found, frames, asked, assumed)
    ]
    fps = mano.rate(told, asked)
    return mano.recording_of("hot3d", document, fps, frames, posed, asked, assumed, chosen=True)


def _of_one_camera(lines: list[Any]) -> list[Any]:
    """The lines of the first camera: Aria's glasses have several, which take their pictures at almost the
    same time and have a line each."""
    kept: list[Any] = []
    for line in lines:
        time = whole("timestamp_ns", line["timestamp_ns"])
        # Nanoseconds between pictures of one moment
        if not kept or not 0 <= time - kept[-1]["timestamp_ns"] < 4_000_000:
            kept.append(line)
    return kept


def _hand(frame: int, index: int, pose: dict[str, Any], asked: Asked) -> mano.FoundHand:
    side = SIDES[index]
    if "joint_angles" in pose:
        raise Unfit("it has joint_angles, which are UmeTrack's hands: give the file of MANO's hands")
    given = pose["pose"] if "pose" in pose else pose["thetas"]
    coefficients = mano.numbers("pose", given, 15)[:1]
    wrist = pose["wrist_xform"]
    if isinstance(wrist, dict):
        orient = rotmat_to_rotvec(quat_to_rotmat(mano.numbers("q_wxyz", wrist["q_wxyz"], 4)))[:1]
        transl = mano.numbers("t_xyz", wrist["t_xyz"], 3)[:1]
    else:
        both = mano.numbers("wrist_xform", wrist, 6)[:1]
        orient, transl = both[:, :3], both[:, 3:]
    betas = mano.numbers("betas", pose["betas"], 10)[0] if pose.get("betas") is not None else mano.NO_SHAPE
    flat = mano.from_flat(mano.from_directions(coefficients, side, asked), side, asked, "mean")
    return mano.FoundHand(side, betas, orient, flat, transl, frame)


READER = Reader(
    "HOT3D",
    "mano_hand_pose_trajectory.jsonl, or a clip's folder with *.hands.json",
    _recognises,
    _read,
)
