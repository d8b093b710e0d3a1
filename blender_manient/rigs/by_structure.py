"""Characters with names that nobody knows."""

from __future__ import annotations

import bpy

from handfit_core.retarget.bones import Bones
from handfit_core.retarget.hand_map import Found, the_surest
from handfit_core.retarget.structure import LABEL, structured_hands
from handfit_core.skeleton import Side

from .character import Character, driven_bones


class StructuredCharacter(Character):
    """Any rig in which bones fan out as a hand's do. Never as sure as names."""

    label = LABEL

    @classmethod
    def find(cls, armature: bpy.types.Object, bones: Bones, side: Side) -> Found | None:
        """By how bones branch and lie."""
        return the_surest(structured_hands(bones, side), bones, driven_bones(armature))
