"""Which bones of an armature are a hand, and what a pose is to them. One file per kind of rig."""

from __future__ import annotations

import bpy

from handfit_core.errors import HandModelError
from handfit_core.skeleton import SIDES, Side

from ..plugins import found_in
from .rig import Rig

KINDS = found_in(__name__, Rig)
"""Every kind of rig that is known"""


def rig_of(armature: bpy.types.Object, side: Side | None = None) -> Rig:
    """The hand of an armature, of the kind that is surest of it; `side` None: of the surer side.

    Raises HandModelError where no kind recognises a hand.
    """
    sides = SIDES if side is None else (side,)
    found = [kind(armature, s) for kind in KINDS for s in sides if kind.recognises(armature, s) > 0.0]
    if not found:
        raise HandModelError(f"{armature.name!r} has no hand that is known here: select a captured hand")
    return max(found, key=lambda rig: rig.recognises(armature, rig.side))
