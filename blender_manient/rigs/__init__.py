"""Which bones of an armature are a hand, and what a pose is to them. One file per kind of rig."""

from __future__ import annotations

import bpy

from handfit_core.errors import HandModelError
from handfit_core.skeleton import SIDES, Side

from ..plugins import failed, found_in, tell_once
from .rig import Rig

KINDS: list[type[Rig]] = found_in(__name__, Rig, first=("captured_hand",))
"""Every kind of rig that is known; of those that are equally sure of a hand the first is taken"""


def rig_of(armature: bpy.types.Object, side: Side | None = None) -> Rig:
    """The hand of an armature, of the kind that is surest of it; `side` None: of the surer side.

    Raises HandModelError where no kind recognises a hand.
    """
    surest, found = 0.0, None
    for kind in KINDS:
        for one in SIDES if side is None else (side,):
            try:
                sure = kind.recognises(armature, one)
                if sure > surest:
                    surest, found = sure, kind(armature, one)
            except Exception as error:  # polls ask at every redraw
                tell_once(failed(kind, error))
    if found is None:
        raise HandModelError(f"{armature.name!r} has no hand that is known here: select a captured hand")
    return found
