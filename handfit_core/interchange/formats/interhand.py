"""InterHand2.6M's MANO_NeuralAnnot.json: captures, frames and hands, relative to MANO's mean pose."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np

from handfit_core.doors.values import Unfit
from handfit_core.interchange import mano
from handfit_core.interchange.document import Document
from handfit_core.interchange.readers import Reader
from handfit_core.interchange.recording import Asked, Recording
from handfit_core.skeleton import SIDES

_PARTS: Final = {"pose", "shape", "trans"}


def _recognises(document: Document) -> bool:
    capture = _first(document.json)
    hands = _first(capture)
    if not isinstance(hands, dict) or not set(hands) <= set(SIDES):
        return False
    told = [hand for hand in hands.values() if hand is not None]
    return all(isinstance(hand, dict) and set(hand) >= _PARTS for hand in told) and bool(hands)


def _first(held: Any) -> Any:
    return next(iter(held.values()), None) if isinstance(held, dict) else None


def _read(document: Document, asked: Asked) -> Recording:
    assumed = ["its cameras are in another file: the hands are seen along the axes of its world"]
    captures: dict[str, Any] = document.json
    chosen = asked.person or 1
    if chosen > len(captures):
        raise Unfit(f"there is no person {chosen}: it has {len(captures)} captures")
    name = list(captures)[chosen - 1]
    if len(captures) > 1 and asked.person is None:
        assumed.append(f"capture {name}, the first of {len(captures)} (--person says which)")
    found: list[mano.FoundHand] = []
    for frame, hands in captures[name].items():
        for side in SIDES:
            hand = hands.get(side)
            if hand is None:
                continue
            row = mano.rotations("pose", np.reshape(hand["pose"], -1), 16, 1)
            found.append(
                mano.FoundHand(
                    side,
                    mano.numbers("shape", hand["shape"], 10)[0],
                    row[:, :3],
                    mano.from_flat(row[:, 3:], side, asked, "mean"),
                    mano.numbers("trans", hand["trans"], 3)[:1],
                    int(frame),
                )
            )
    if not found:
        raise Unfit(f"capture {name} has no hand")
    frames = np.array(sorted({hand.frame for hand in found}))
    posed = mano.followed(found, frames, replace(asked, person=None), assumed)
    fps = asked.rate
    return mano.recording_of("interhand", document, fps, frames, posed, asked, assumed, chosen=True)


READER = Reader(
    "InterHand2.6M",
    "JSON of captures, their frames, and right and left with pose, shape and trans",
    _recognises,
    _read,
)
