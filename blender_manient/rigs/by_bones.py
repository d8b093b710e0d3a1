"""Characters that their bones' names or structure tell."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

import bpy

from handfit_core.common.skeleton import Side
from handfit_core.retarget.bones import Bones
from handfit_core.retarget.hand_map import Found, the_surest
from handfit_core.retarget.names import named_hands
from handfit_core.retarget.structure import LABEL, structured_hands

from .character import Character, driven_bones


class NamedCharacter(Character):
    """A rig of one of the tables of `names.py`; the table's name is what the rig is taken for."""

    label = "By its names"
    hands: ClassVar[Callable[[Bones, Side], list[Found]]] = staticmethod(named_hands)
    """Every hand of one side, the surest first"""

    @classmethod
    def find(cls, armature: bpy.types.Object, bones: Bones, side: Side) -> Found | None:
        """The surest hand whose own keys do something."""
        return the_surest(cls.hands(bones, side), bones, driven_bones(armature))


class StructuredCharacter(NamedCharacter):
    """Any rig in which bones fan out as a hand's do. Never as sure as names."""

    label = LABEL
    hands = staticmethod(structured_hands)
