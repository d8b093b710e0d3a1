"""Put a hand's fingers into a relaxed pose."""

from __future__ import annotations

import bpy
import numpy as np

from handfit_core.hand_model.anatomy import relaxed_pose
from handfit_core.hand_model.kept import kept_model
from handfit_core.skeleton import NUM_JOINTS

from ..scene.corrections import correct_frames, timing_of
from ..scene.editable import why_not_keyable
from ..scene.keys import keyed_bones, set_pose
from .needs_hand import OnHand, errors_reported, hand_in


class MANIENT_OT_relax_pose(OnHand, bpy.types.Operator):
    bl_idname = "manient.relax_pose"
    bl_label = "Relaxed Pose"
    bl_description = (
        "Relax the fingers at the current frame; the wrist stays. Like a dragged point, this fades out over "
        "Spread, and Clear takes it back. Bones that are animated get a key, others only with Auto Keying"
    )
    why_not = staticmethod(why_not_keyable)

    @errors_reported
    def execute(self, context):
        """Set or correct the fifteen finger bones."""
        hand = hand_in(context)
        armature, rig = hand.armature, hand.rig
        model = kept_model(hand.take.model, hand.side)
        still = np.zeros((1, 3))
        quats, _ = rig.to_bones(model.shaped(), still, relaxed_pose(model)[None], still)
        quats[:, 0] = np.nan  # not the wrist
        chosen = keyed_bones(rig)
        if context.scene.tool_settings.use_keyframe_insert_auto:
            chosen = np.ones(NUM_JOINTS, dtype=bool)
        chosen[0] = False
        if chosen.any():
            (frame,) = timing_of(armature).source_frames(np.array([context.scene.frame_current_final]))
            wanted = np.where(chosen[:, None], quats[0], np.nan)
            spread = context.scene.manient.spread
            still = np.full((1, 3), np.nan)
            correct_frames(
                armature, [frame], wanted[None], still, spread, pins=[{}], touches=[{}], posed=True
            )
        set_pose(rig, quats[0])
        return {"FINISHED"}
