"""Put captured motion, or one pose of it, on a hand that is there already."""

from __future__ import annotations

import bpy

from handfit_core.errors import OptionError
from handfit_core.take import Take

from ..scene.apply import apply_hand, apply_track, track_for
from ..scene.store import captured_hands
from ..section import split
from ..wording import counted
from .mixins import HandOperator, errors_reported, polled_hand


class MANIENT_OT_apply_take(HandOperator, bpy.types.Operator):
    bl_idname = "manient.apply_take"
    bl_label = "Apply Motion"
    bl_description = (
        "Key the motion of another captured hand, or of a take file, on this hand. "
        "With a second captured hand selected it is the source, else a file is asked for. "
        "The other side's motion is mirrored"
    )

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})  # type: ignore
    filter_glob: bpy.props.StringProperty(default="*.npz", options={"HIDDEN"})  # type: ignore
    source: bpy.props.StringProperty(  # type: ignore
        name="Source",
        description="The captured hand to take the motion from; empty: the take file",
        options={"SKIP_SAVE"},
    )
    mode: bpy.props.EnumProperty(  # type: ignore
        name="Apply",
        items=(
            ("ANIMATION", "Animation", "Replace the keys from the source's first frame to its last"),
            ("POSE", "Pose", "Key one pose at the current frame"),
        ),
        default="ANIMATION",
    )
    source_frame: bpy.props.IntProperty(  # type: ignore
        name="Source Frame",
        description="Which of the take file's frames the pose comes from; 0 is the first with a hand",
        default=0,
        min=0,
    )
    wrist: bpy.props.BoolProperty(  # type: ignore
        name="Wrist",
        description="Apply the hand's place and rotation too, not only its fingers",
        default=True,
    )

    def invoke(self, context, event):
        """Take the other selected hand, or ask for a file."""
        target = polled_hand(context).armature
        others = [o for o in captured_hands(context.scene) if o != target and o.select_get()]
        if not self.source and len(others) == 1:
            self.source = others[0].name
        if self.source:
            return self.execute(context)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def draw(self, _context):
        layout = self.layout
        split(layout)
        layout.prop(self, "mode")
        if self.mode == "POSE" and not self.source:
            layout.prop(self, "source_frame")
        layout.prop(self, "wrist")

    @errors_reported
    def execute(self, context):
        hand = polled_hand(context)
        frame = context.scene.frame_current_final
        if self.source:
            source = context.scene.objects.get(self.source)
            if source is None:
                raise OptionError(f"The hand {self.source} is not in this scene any more")
            count = apply_hand(hand.armature, source, self.mode, frame, wrist=self.wrist)
        else:
            take = Take.load(bpy.path.abspath(self.filepath))
            count = apply_track(
                hand.armature,
                take,
                track_for(take, hand.side),
                self.mode,
                frame,
                source_frame=self.source_frame or None,
                wrist=self.wrist,
            )
        self.report({"INFO"}, f"Keyed {counted(count, 'frame')} on {hand.armature.name}")
        return {"FINISHED"}
