"""Characters whose bones are called as a program that is known calls them."""

from __future__ import annotations

import bpy

from handfit_core.retarget.bones import Bones
from handfit_core.retarget.hand_map import Found, the_surest
from handfit_core.retarget.names import named_hands
from handfit_core.skeleton import Side

from .character import Character, driven_bones


class NamedCharacter(Character):
    """A rig of one of the tables of `names.py`; the table's name is what the rig is taken for."""

    label = "By its names"

    @classmethod
    def find(cls, armature: bpy.types.Object, bones: Bones, side: Side) -> Found | None:
        """By the tables that explain the most names."""
        return the_surest(named_hands(bones, side), bones, driven_bones(armature))
