"""Move Keypoint: what dragging a point in the viewport does, for scripts."""

from __future__ import annotations

import bpy

from handfit_core.edit.corrections import Pins
from handfit_core.errors import OptionError
from handfit_core.skeleton import NUM_KEYPOINTS

from .. import shared_worker
from ..refiner import Refiner, why_not
from ..scene.store import active_hand, hand_of
from .mixins import PollMixin, errors_reported

_TIMEOUT_SECONDS = 120.0
"""seconds; the first answer may wait for the worker to start"""


class MANIENT_OT_move_keypoint(PollMixin, bpy.types.Operator):
    bl_idname = "manient.move_keypoint"
    bl_label = "Move Keypoint"
    bl_description = "Pin a point of the hand to a place in the picture and fit the hand to it again"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    hand: bpy.props.StringProperty(  # type: ignore
        name="Hand", description="Name of the hand's armature (empty: the active one)"
    )
    frame: bpy.props.IntProperty(  # type: ignore
        name="Frame", description="Scene frame", options={"SKIP_SAVE"}
    )
    keypoint: bpy.props.IntProperty(  # type: ignore
        name="Keypoint", description="0 is the wrist, 8 the index tip", min=0, max=NUM_KEYPOINTS - 1
    )
    x: bpy.props.FloatProperty(name="X", description="Pixels from the picture's left edge")  # type: ignore
    y: bpy.props.FloatProperty(name="Y", description="Pixels from the picture's upper edge")  # type: ignore
    remove: bpy.props.BoolProperty(  # type: ignore
        name="Remove", description="Remove the point's pin instead", options={"SKIP_SAVE"}
    )

    @classmethod
    def lacks(cls, context):
        """Anything that can be refined at all; `execute` checks the hand it is given."""
        hand = active_hand(context)
        return why_not(context, hand) if hand is not None else None

    @errors_reported
    def execute(self, context):
        """Fit and wait for it."""
        refiner = Refiner(self._armature(context))
        frame = self.frame if self.properties.is_property_set("frame") else context.scene.frame_current
        row = refiner.row_at(frame)
        if row is None:
            raise OptionError(f"frame {frame} was not captured: give a frame of the source")
        pins = self._pins(refiner.pins(row))
        if pins or refiner.touches(row):
            fields = refiner.request([row], [pins], refiner.start_poses([row]))()
            worker = shared_worker.worker()
            poses = refiner.poses(worker.wait(worker.submit("refit", **fields), timeout=_TIMEOUT_SECONDS))
            if not poses.present[0]:
                raise OptionError("no hand can be fitted to these points: move them nearer to the hand")
            refiner.correct(row, pins, poses, context.scene.manient.spread)
        else:
            refiner.unpin(row)
        context.scene.frame_set(context.scene.frame_current, subframe=context.scene.frame_subframe)
        return {"FINISHED"}

    def _armature(self, context) -> bpy.types.Object:
        if not self.hand:
            hand = active_hand(context)
            if hand is None:
                raise OptionError("no captured hand is active: select one, or give its name")
            return hand.armature
        obj = context.scene.objects.get(self.hand)
        hand = hand_of(obj) if obj is not None else None
        if hand is None:
            raise OptionError(f"there is no captured hand {self.hand!r} in this scene")
        why = why_not(context, hand)
        if why is not None:
            raise OptionError(why)
        return hand.armature

    def _pins(self, pins: Pins) -> Pins:
        others = {k: place for k, place in pins.items() if k != self.keypoint}
        if not self.remove:
            return {**others, self.keypoint: (self.x, self.y)}
        if self.keypoint not in pins:
            raise OptionError(f"keypoint {self.keypoint} has no pin in this frame")
        return others
