"""Leave: ends what a button has begun, from the same place in the panel."""

from __future__ import annotations

import bpy

from .. import screen
from ..modes import find_hands as find_mode
from . import add_hand, find_hands
from .mixins import PollMixin
from .refit_range import RangeFitOperator

_LEAVE = {
    "FIND": lambda: find_hands.unregister(),
    "ADD": lambda: add_hand.unregister(),
    "FIT": lambda: RangeFitOperator.stop(),
}
"""Ends each; its operator finds out with its next event"""


class MANIENT_OT_leave(PollMixin, bpy.types.Operator):
    bl_idname = "manient.leave"
    bl_label = "Leave"
    bl_description = "End this without changing anything, as Esc does"
    bl_options = {"INTERNAL"}  # noqa: RUF012

    what: bpy.props.EnumProperty(  # type: ignore
        items=[(name, name.capitalize(), "") for name in _LEAVE], options={"SKIP_SAVE"}
    )

    @classmethod
    def lacks(cls, _context):
        begun = find_mode.current is not None or add_hand.running() or RangeFitOperator.running
        return None if begun else "Nothing is under way"

    def execute(self, _context):
        _LEAVE[self.what]()
        screen.redraw("VIEW_3D")
        return {"FINISHED"}
