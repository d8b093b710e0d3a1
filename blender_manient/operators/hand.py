"""What is done with the active captured hand as a whole."""

from __future__ import annotations

import bpy
import numpy as np

from handfit_core.common.errors import OptionError, TakeError
from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, NUM_JOINTS
from handfit_core.take import Take

from ..common.section import split
from ..common.wording import counted
from ..rigs.controls import in_use, with_moved
from ..scene import corrections
from ..scene.apply import apply_hand, apply_track, track_for
from ..scene.controls import add_controls, bake_controls, remove_controls
from ..scene.editable import why_not_bakeable, why_not_editable
from ..scene.mirror import mirror_hand
from ..scene.origin import origin_to_wrist, why_not_at_wrist
from ..scene.reshape import reset
from ..scene.store import CapturedHand, captured_hands
from ..scene.timing import span_of
from .base import HandOperator, polled_hand, select_alone, show_frame_again

_FINGER_ITEMS = tuple(
    (f.upper(), f.capitalize(), f"The joints of the {f} finger") for f in FINGERS if f != "thumb"
)


class MANIENT_OT_mirror_hand(HandOperator, bpy.types.Operator):
    """Add the opposite hand with the same motion, mirrored across the middle of the camera's view, or beside
    the hand where the two would overlap."""

    bl_label = "Mirror Hand"

    def run(self, context):
        armature = mirror_hand(polled_hand(context))
        if context.mode == "OBJECT" and armature.name in context.view_layer.objects:
            select_alone(context, armature)


class MANIENT_OT_origin_to_wrist(HandOperator, bpy.types.Operator):
    """Move the origin of the hand's object to where its wrist is in this frame. The hand stays where it is in
    every frame, and so does its relation to the picture."""

    bl_label = "Origin to Wrist"

    @staticmethod
    def why_not(armature):
        return why_not_editable(armature) or why_not_at_wrist(armature)

    def run(self, context):
        origin_to_wrist(polled_hand(context))


class MANIENT_OT_reset_shape(HandOperator, bpy.types.Operator):
    """Give the hand the proportions back that it was captured with."""

    bl_label = "Reset Shape"

    def run(self, context):
        reset(polled_hand(context))


class MANIENT_OT_apply_take(HandOperator, bpy.types.Operator):
    """Key the motion of another captured hand, or of a take file, on this hand. With a second captured hand
    selected it is the source, else a file is asked for. The other side's motion is mirrored."""

    bl_label = "Apply Motion"

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})
    filter_glob: bpy.props.StringProperty(default="*.npz", options={"HIDDEN"})
    source: bpy.props.StringProperty(
        name="Source",
        description="The captured hand to take the motion from; empty: the take file",
        options={"SKIP_SAVE"},
    )
    mode: bpy.props.EnumProperty(
        name="Apply",
        items=(
            ("ANIMATION", "Animation", "Replace the keys from the source's first frame to its last"),
            ("POSE", "Pose", "Key one pose at the current frame"),
        ),
        default="ANIMATION",
    )
    source_frame: bpy.props.IntProperty(
        name="Source Frame",
        description="Which of the take file's frames the pose comes from; 0 is the first with a hand",
        min=0,
    )
    wrist: bpy.props.BoolProperty(
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
        layout = split(self.layout)
        layout.prop(self, "mode")
        if self.mode == "POSE" and not self.source:
            layout.prop(self, "source_frame")
        layout.prop(self, "wrist")

    def run(self, context):
        hand, frame = polled_hand(context), context.scene.frame_current_final
        if self.source:
            source = context.scene.objects.get(self.source)
            if source is None:
                raise OptionError(f"The hand {self.source} is not in this scene any more")
            count = apply_hand(hand.armature, source, self.mode, frame, wrist=self.wrist)
        else:
            take = Take.load(bpy.path.abspath(self.filepath))
            wanted = {"source_frame": self.source_frame or None, "wrist": self.wrist}
            count = apply_track(hand.armature, take, track_for(take, hand.side), self.mode, frame, **wanted)
        return f"Keyed {counted(count, 'frame')} on {hand.armature.name}"


class MANIENT_OT_lock_joints(HandOperator, bpy.types.Operator):
    """Keep joints as they are when the hand is fitted again."""

    bl_label = "Lock Joints"
    anywhere = True

    lock: bpy.props.BoolProperty(name="Lock", default=True)
    joints: bpy.props.EnumProperty(
        name="Joints",
        items=(
            ("SELECTED", "Selected Bones", "The bones selected in Pose mode; in other modes all joints"),
            ("ALL", "All", "All 16 joints"),
            ("WRIST", "Wrist", "Where the hand is and how it is turned"),
            ("THUMB", "Thumb", "The joints of the thumb"),
            *_FINGER_ITEMS,
        ),
        default="SELECTED",
    )

    @classmethod
    def description(cls, _context, properties):
        does = cls.bl_description if properties.lock else "Let refining move joints again"
        return f"{does}: the bones selected in Pose mode, else all"

    def run(self, context):
        hand = polled_hand(context)
        chosen = self._chosen(context, hand)
        if not chosen:
            raise OptionError("No bone of this hand is selected: select some in Pose mode")
        locked = list(hand.armature.manient.locked)
        for joint in chosen:
            locked[joint] = self.lock
        hand.armature.manient.locked = locked

    def _chosen(self, context, hand: CapturedHand) -> list[int]:
        if self.joints == "WRIST":
            return [0]
        if self.joints.lower() in FINGER_JOINTS:
            return list(FINGER_JOINTS[self.joints.lower()])
        if self.joints == "ALL" or context.mode != "POSE":
            return list(range(NUM_JOINTS))
        selected = {bone.name for bone in context.selected_pose_bones or () if bone.id_data == hand.armature}
        meant = with_moved(hand.armature, hand.rig.bones, selected)
        return [joint for joint, name in enumerate(hand.rig.bones) if name in meant]


class MANIENT_OT_clear_corrections(HandOperator, bpy.types.Operator):
    """Remove pins and applied poses, and what they did to the animation."""

    bl_label = "Clear Corrections"
    anywhere = True

    scope: bpy.props.EnumProperty(
        name="Scope",
        items=(
            ("FRAME", "This Frame", "Only the correction of the current frame"),
            ("RANGE", "Range", "The preview range where it is used, else the scene's frames"),
            ("ALL", "All", "Every correction of this hand"),
        ),
        default="FRAME",
    )

    @classmethod
    def description(cls, _context, properties):
        item = properties.bl_rna.properties["scope"].enum_items[properties.scope]
        return f"{cls.bl_description}. {item.description}"

    @staticmethod
    def why_not(armature):
        none = None if corrections.corrections_text(armature) else "This hand has no corrections"
        return why_not_editable(armature) or none

    def run(self, context):
        armature, scene, everything = polled_hand(context).armature, context.scene, self.scope == "ALL"
        try:
            frames = np.array(corrections.corrections_of(armature).corrected, dtype=np.float64)
            places = corrections.timing_of(armature).scene_frames(frames)
            if self.scope == "FRAME":
                chosen = np.abs(places - scene.frame_current_final) < 0.5
            elif self.scope == "RANGE":
                first, last = span_of(scene)
                chosen = (places > first - 0.5) & (places < last + 0.5)
            else:
                chosen = np.ones(len(places), dtype=bool)
            lost = set(frames[chosen].tolist()) & set(corrections.displaced(armature))
            count = corrections.clear_corrections(armature, None if everything else frames[chosen].tolist())
        except TakeError:
            if not everything:
                raise
            # What cannot be read cannot be taken out of the keys: they stay as they are.
            corrections.forget_corrections(armature)
            lost = "The corrections could not be read: they are gone, the keys stay"
            return self._done(lost, kind="WARNING")
        if count == 0 and not everything:
            where = "in this frame" if self.scope == "FRAME" else "in this range"
            raise OptionError(f"There is no correction {where}")
        show_frame_again(context)
        if lost:
            which = ", ".join(f"{f:g}" for f in sorted(lost))
            which = f"The keys of the corrected source frames {which} were moved or replaced"
            return self._done(f"{which}: these keys stay as they are", kind="WARNING")
        return f"{counted(count, 'correction')} cleared"


class _ControlsOperator(HandOperator):
    """The base of operators after which the armature has other bones."""

    has_controls: bool
    """True if the operator is for hands that have controls, and not for those without"""

    @staticmethod
    def why_not(armature):
        why = why_not_editable(armature)
        if why is None and armature.data.library is not None:
            return "The bones of this hand are linked from another file: make them local first"
        return why

    @classmethod
    def poll_reason(cls, context):
        why = super().poll_reason(context)
        if why or bool(polled_hand(context).rig.controls) == cls.has_controls:
            return why
        return "This hand has no controls" if cls.has_controls else "This hand has its controls"


class MANIENT_OT_add_controls(_ControlsOperator, bpy.types.Operator):
    """Give the hand bones to animate it with on top of its captured keys: one for each finger, one for all
    fingers, one for the hand."""

    bl_label = "Add Controls"
    has_controls = False

    def run(self, context):
        add_controls(polled_hand(context))


class MANIENT_OT_remove_controls(_ControlsOperator, bpy.types.Operator):
    """Take the controls away, with their keys, limits and shapes."""

    bl_label = "Remove Controls"
    has_controls = True

    bake: bpy.props.BoolProperty(
        name="Bake",
        description="Write what the controls do into the keys first; else the hand goes back to its keys",
        default=True,
    )

    def run(self, context):
        hand = polled_hand(context)
        if self.bake and in_use(hand.armature):
            bake_controls(hand)
        remove_controls(hand)


class MANIENT_OT_bake_controls(HandOperator, bpy.types.Operator):
    """Write what the controls do into the hand's keys, and put the controls at rest. Dragged points go where
    keys change."""

    bl_label = "Bake Controls"

    @staticmethod
    def why_not(armature):
        why = why_not_bakeable(armature)
        return why or (None if in_use(armature) else "The controls are at rest: there is nothing to bake")

    def run(self, context):
        bake_controls(polled_hand(context))
