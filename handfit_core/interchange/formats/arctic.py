"""ARCTIC's *.mano.npy: both hands in axis-angle, relative to MANO's mean pose, in the world's frame."""

from __future__ import annotations

from typing import Final

import numpy as np

from handfit_core.doors.values import Unfit
from handfit_core.hand_model.motion import HandMotion
from handfit_core.interchange import mano
from handfit_core.interchange.document import Document
from handfit_core.interchange.readers import Reader
from handfit_core.interchange.recording import Asked, Recording
from handfit_core.interchange.skeletons import UP_AXES
from handfit_core.skeleton import SIDES

_PARTS: Final = {"rot", "pose", "trans"}


def _recognises(document: Document) -> bool:
    hands = [document.value(side) for side in SIDES if side in document.names]
    return bool(hands) and all(isinstance(hand, dict) and set(hand) >= _PARTS for hand in hands)


def _read(document: Document, asked: Asked) -> Recording:
    assumed = [mano.UNTOLD_WORLD]
    posed = []
    for side in SIDES:
        hand = document.value(side)
        if hand is None:
            continue
        orient = mano.rotations("rot", hand["rot"], 1)
        pose = mano.rotations("pose", hand["pose"], 15, len(orient))
        transl = mano.numbers("trans", hand["trans"], 3)
        if len(transl) != len(orient):
            raise Unfit(f"trans has {len(transl)} rows where {len(orient)} are expected")
        pose = mano.from_flat(pose, side, asked, "mean")
        shape = mano.shape_of(hand.get("shape"), asked, assumed)
        posed.append(mano.seen_from(HandMotion(side, shape, orient, pose, transl), asked, UP_AXES["z"]))
    fps = asked.rate
    frames = np.arange(1, len(posed[0].hand_pose) + 1)
    return mano.recording_of("arctic", document, fps, frames, posed, asked, assumed)


READER = Reader("ARCTIC", "a .mano.npy with rot, pose and trans of right and left", _recognises, _read)
