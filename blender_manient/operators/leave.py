"""Leave: ends what a button has begun."""

from __future__ import annotations

import bpy

from ..common import screen
from . import add_hand, find_hands
from .base import InternalOperator
from .modes import find_hands as find_mode
from .refit_range import RangeFitOperator

_LEAVE = {"FIND": find_hands.unregister, "ADD": add_hand.unregister, "FIT": RangeFitOperator.stop}
"""Ends each; its operator finds out with its next event"""


class MANIENT_OT_leave(InternalOperator, bpy.types.Operator):
    """End this without changing anything, as Esc does."""

    bl_label = "Leave"

    what: bpy.props.EnumProperty(
        items=[(name, name.capitalize(), "") for name in _LEAVE], options={"SKIP_SAVE"}
    )

    @classmethod
    def poll_reason(cls, context):
        begun = find_mode.current is not None or add_hand.running() or RangeFitOperator.fitting()
        return None if begun else "Nothing is under way"

    def run(self, context):
        _LEAVE[self.what]()
        screen.redraw("VIEW_3D")
