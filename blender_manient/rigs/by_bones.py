"""Characters of any kind, whose bones tell which of them are hands."""

from __future__ import annotations

import bpy

from handfit_core.common.skeleton import Side
from handfit_core.retarget.bones import Bones
from handfit_core.retarget.recognition import Found, hands_in, the_surest

from .character import Character, driven_bones


class AnyCharacter(Character):
    """Any rig in which bones fan out as a hand's do."""

    label = "By its bones"

    @classmethod
    def find(cls, armature: bpy.types.Object, bones: Bones, side: Side) -> Found | None:
        """Return the surest hand of that side whose own keys do something; None for none."""
        return the_surest(hands_in(bones, side), bones, driven_bones(armature))
