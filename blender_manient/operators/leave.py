"""Leave: ends what a button has begun."""

from __future__ import annotations

import bpy

from ..common import screen
from .add_hand import MANIENT_OT_add_hand
from .base import InternalOperator
from .find_hands import MANIENT_OT_find_hands
from .refit_range import RangeFitOperator

_LEAVE = {"FIND": MANIENT_OT_find_hands.leave, "ADD": MANIENT_OT_add_hand.leave, "FIT": RangeFitOperator.stop}
"""By the mode, the function that ends it; its operator finds out with its next event"""


class MANIENT_OT_leave(InternalOperator, bpy.types.Operator):
    """End this without changing anything, as Esc does."""

    bl_label = "Leave"

    what: bpy.props.EnumProperty(
        items=[(name, name.capitalize(), "") for name in _LEAVE], options={"SKIP_SAVE"}
    )

    @classmethod
    def poll_reason(cls, context):
        begun = MANIENT_OT_find_hands.current or MANIENT_OT_add_hand.current or RangeFitOperator.fitting()
        return None if begun else "Nothing is under way"

    def run(self, context):
        _LEAVE[self.what]()
        screen.redraw("VIEW_3D")
