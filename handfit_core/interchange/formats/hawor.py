"""HaWoR: the folder of a clip with cam_space, whose files have the frames in their names, and its
world_space_res as five arrays."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Final

import numpy as np

from handfit_core.doors.values import Unfit
from handfit_core.hand_model.motion import HandMotion
from handfit_core.interchange import mano
from handfit_core.interchange.document import Document
from handfit_core.interchange.readers import Reader
from handfit_core.interchange.recording import Asked, Recording
from handfit_core.skeleton import SIDES

_FIRST_AND_LAST: Final = re.compile(r"(\d+)_(\d+)")
_FIVE: Final = ("trans", "rot", "hand_pose", "betas", "valid")


def _folder(document: Document) -> Path | None:
    """cam_space, given as that or as the folder that it is in."""
    if not document.is_folder:
        return None
    for folder in (document.path / "cam_space", document.path):
        if any(_chunks(folder / side) for side in "01"):
            return folder
    return None


def _chunks(folder: Path) -> list[Path]:
    return [path for path in Document(folder).files(".json") if _FIRST_AND_LAST.fullmatch(path.stem)]


def _five(document: Document) -> dict[str, Any] | None:
    """The arrays of a converted world_space_res, by the names of `_FIVE`."""
    names = {name.removeprefix("pred_"): name for name in document.names}
    if {*_FIVE[:3], "valid"} <= set(names):
        return {name: document.value(names[name]) for name in _FIVE if name in names}
    held = document.objects
    if isinstance(held, list) and len(held) == 5 and all(np.ndim(each) >= 2 for each in held):
        return dict(zip(_FIVE, held, strict=True))
    return None


def _recognises(document: Document) -> bool:
    if document.is_folder:
        return _folder(document) is not None
    five = _five(document)
    return five is not None and np.shape(five["rot"])[:1] == (2,)


def _read(document: Document, asked: Asked) -> Recording:
    return _of_folder(document, asked) if document.is_folder else _of_world(document, asked)


def _of_folder(document: Document, asked: Asked) -> Recording:
    folder = _folder(document)
    assert folder is not None
    assumed: list[str] = []
    found: list[mano.FoundHand] = []
    for index, side in enumerate(SIDES):
        for path in _chunks(folder / str(index)):
            match = _FIRST_AND_LAST.fullmatch(path.stem)
            assert match is not None
            first, last = int(match[1]), int(match[2])
            chunk = Document(path)
            if not 0 <= last - first < 10_000_000 or not isinstance(chunk.json, dict):
                raise Unfit(f"{path.name} must be JSON of the frames in its name, and is {chunk.found}")
            count = last - first + 1
            orient = mano.rotations("init_root_orient", chunk.value("init_root_orient"), 1, count)
            pose = mano.rotations("init_hand_pose", chunk.value("init_hand_pose"), 15, count)
            transl = mano.numbers("init_trans", chunk.value("init_trans"), 3)
            betas = mano.numbers("init_betas", chunk.value("init_betas"), 10)
            if len(transl) != count or len(betas) != count:
                raise Unfit(f"{path.name} must have {count} frames, as its name says, and has {len(transl)}")
            pose = mano.from_flat(pose, side, asked, "flat")
            found += [
                # HaWoR counts pictures from 0.
                mano.FoundHand(
                    side,
                    betas[row],
                    orient[row : row + 1],
                    pose[row : row + 1],
                    transl[row : row + 1],
                    first + row + 1,
                )
                for row in range(count)
            ]
    frames = np.array(sorted({hand.frame for hand in found}))
    posed = mano.followed(found, frames, asked, assumed)
    assumed.append("frames count from 1, where HaWoR counts them from 0")
    return mano.recording_of(
        "hawor",
        document,
        asked.rate,
        frames,
        posed,
        asked,
        assumed,
        chosen=True,
        mirrored_by="it may be a right hand's",
    )


def _of_world(document: Document, asked: Asked) -> Recording:
    five = _five(document)
    assert five is not None
    assumed = ["its world was taken to have the camera's axes, as in HaWoR's first frame"]
    valid = np.asarray(five["valid"], dtype=np.float64)
    if valid.ndim != 2 or len(valid) != len(SIDES):
        raise Unfit("valid must have the shape 2xT, the left hand first")
    count = valid.shape[1]
    posed = []
    for index, side in enumerate(SIDES):
        orient = mano.rotations("rot", np.asarray(five["rot"])[index], 1, count)
        pose = mano.rotations("hand_pose", np.asarray(five["hand_pose"])[index], 15, count)
        transl = mano.numbers("trans", np.asarray(five["trans"])[index], 3)
        betas = None if "betas" not in five else np.asarray(five["betas"])[index]
        there = valid[index] > 0.0
        shape = mano.shape_of(None if betas is None else betas[there], asked, assumed)
        pose = mano.from_flat(pose, side, asked, "flat")
        posed.append(mano.only(HandMotion(side, shape, orient, pose, transl), there))
    fps = asked.rate
    return mano.recording_of("hawor", document, fps, np.arange(1, count + 1), posed, asked, assumed)


READER = Reader(
    "HaWoR",
    "a clip's folder with cam_space/0 (left) and cam_space/1 (right), or world_space_res as an .npz with "
    "trans, rot, hand_pose, betas and valid",
    _recognises,
    _read,
)
