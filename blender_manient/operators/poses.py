"""Poses on the selected hand: put there from the library, and saved for it."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

import bpy
import numpy as np

from handfit_core.common.errors import HandfitError, OptionError
from handfit_core.hand_model.poses import Pose

from ..common.blender_versions import channels, new_slot, property_group
from ..scene.controls import rotations_now
from ..scene.keys import PoseKeys, write_pose_keys
from ..scene.poses import (
    PROPERTY,
    PosableHand,
    forget_previews,
    keep_pose,
    kept_pose,
    posable_hands,
    pose_named,
    posed_by,
    why_not_posable,
)
from ..scene.spans import SCOPES, RequestedFrames, suggested_range
from ..scene.store import CapturedHand
from ..session.properties import BLEND
from .base import ManientOperator, show_frame_again


class _PoseOperator(ManientOperator):
    """The base of operators that put a pose on the active captured hand or character."""

    blend: bpy.props.FloatProperty(**BLEND)
    scope: bpy.props.EnumProperty(**SCOPES)
    first: bpy.props.IntProperty(name="First", description="First scene frame", default=1)
    last: bpy.props.IntProperty(name="Last", description="Last scene frame", default=250)

    @classmethod
    def poll_reason(cls, context):
        return why_not_posable(context)

    def _put(
        self, context: bpy.types.Context, pose_of: Callable[[PosableHand], Pose | None], name: str
    ) -> str | None:
        hands = posable_hands(context)
        asked = RequestedFrames(self.scope, self.first, self.last, context.scene.manient.spread)
        # All of them, before one is changed.
        poses = [hand.towards(context, pose_of(hand), self.blend, asked) for hand in hands]
        for hand, posed in zip(hands, poses, strict=True):
            hand.put(context, posed)
        spans = [posed.span for posed in poses if posed.span is not None]
        if not spans:
            return None
        show_frame_again(context)
        first, last = min(span.first for span in spans), max(span.last for span in spans)
        return f"{name}: frames {first:g} to {last:g}"


class MANIENT_OT_apply_pose(_PoseOperator, bpy.types.Operator):
    """Put a pose on the fingers: those with selected bones, else all; the wrist stays. On a captured hand
    this fades out over Spread, and Clear takes it back; bones that are animated get keys, others one on the
    current frame with Auto Keying. A character's bones get keys."""

    bl_label = "Apply Pose"

    source: bpy.props.EnumProperty(
        name="Source",
        items=(
            ("LIBRARY", "Library", "The chosen pose"),
            ("OWN", "This Hand", "The hand's own pose in the current frame"),
            ("OTHER", "Mirrored", "The pose of the other side's hand in the current frame, mirrored"),
            ("REST", "Rest", "The rest pose"),
        ),
        default="LIBRARY",
        options={"SKIP_SAVE"},
    )
    pose: bpy.props.StringProperty(
        name="Pose", description="A ready pose, or a pose asset of this file", options={"SKIP_SAVE"}
    )

    @classmethod
    def description(cls, _context, properties):
        """Return the tooltip: which pose is put, and on which frames."""
        kind = properties.bl_rna.properties
        source, scope = (
            kind[name].enum_items[getattr(properties, name)].description for name in ("source", "scope")
        )
        return f"{cls.bl_description}.\n{source}.\n{scope}"

    def run(self, context):
        name = self.pose or context.scene.manient.pose
        if self.source == "LIBRARY":
            pose = pose_named(name)
            return self._put(context, lambda _: pose, name)
        of_hand: dict[str, tuple[str, Callable[[PosableHand], Pose | None]]] = {
            "OWN": ("This pose", lambda hand: hand.read()),
            "OTHER": ("Mirrored", lambda hand: hand.opposite(context).read()),
            "REST": ("Rest", lambda _: None),
        }
        name, pose_of = of_hand[self.source]
        return self._put(context, pose_of, name)


class MANIENT_OT_apply_pose_asset(_PoseOperator, bpy.types.Operator):
    """Put this pose, which Hand Capture saved, on the selected captured hand or character, whatever its bones
    are called; the other side's is mirrored."""

    bl_label = "Apply to Hand"

    @classmethod
    def poll_reason(cls, context):
        asset = getattr(context, "asset", None)
        if asset is None or not property_group(asset.metadata, PROPERTY):
            return "Choose a pose asset that Save Pose Asset made"
        return super().poll_reason(context)

    def run(self, context):
        pose = kept_pose(context.asset.metadata)
        return self._put(context, lambda _: pose, context.asset.name)


class MANIENT_OT_save_pose_asset(ManientOperator, bpy.types.Operator):
    """Keep the fingers' pose of the current frame in the pose library of this file: for every captured hand
    and every character, left or right."""

    bl_label = "Save Pose Asset"

    asset_name: bpy.props.StringProperty(name="Name", description="Name of the asset", default="Hand Pose")
    wrist: bpy.props.BoolProperty(
        name="Wrist Rotation",
        description="Keep how a captured hand's wrist is turned too, for Blender's own way of applying "
        "poses; its place is never kept",
    )

    @classmethod
    def poll_reason(cls, context):
        return why_not_posable(context, reading=True)

    def invoke(self, context, event):
        return context.window_manager.invoke_props_dialog(self)

    def run(self, context):
        hands = posable_hands(context)
        if len(hands) > 1:
            raise OptionError(
                "this character has two hands: select a bone of the one whose pose is to be kept"
            )
        rig, pose = hands[0].rig, hands[0].read()
        name = self.asset_name.strip() or "Hand Pose"
        action = bpy.data.actions.new(name)
        slot = new_slot(action, rig.armature.name)
        chosen = np.ones((1, len(rig.bones)), dtype=bool)
        if rig.armature.manient.is_hand:
            chosen[0, 0] = self.wrist
        keys = PoseKeys(
            np.array([1.0]), rotations_now(rig)[None], np.zeros((1, 3)), chosen, np.zeros(1, dtype=bool)
        )
        write_pose_keys(rig, keys, holder=channels(action, slot, make=True))
        action.asset_mark()
        action.asset_data.description = f"Pose of a {pose.side} hand"
        for tag in ("hand", pose.side):
            action.asset_data.tags.new(tag, skip_if_exists=True)
        keep_pose(action, pose)
        return f"Saved {action.name} with {chosen.sum()} bones"


def _in_menu(menu, context) -> None:
    if MANIENT_OT_apply_pose_asset.poll(context):
        menu.layout.operator(MANIENT_OT_apply_pose_asset.bl_idname)
        menu.layout.separator()


def _scope_chosen(settings: bpy.types.PropertyGroup) -> None:
    """Suggest a range when Range is chosen."""
    if settings.pose_scope == "RANGE":
        with contextlib.suppress(HandfitError):
            owner = posed_by(bpy.context)
            hand = owner if isinstance(owner, CapturedHand) else None
            settings.pose_first, settings.pose_last = suggested_range(settings.id_data, hand)


LISTENERS = {"pose_scope": _scope_chosen}
MENUS = {("ASSETBROWSER_MT_context_menu", "prepend"): _in_menu}


def unregister() -> None:
    """Forget the pictures of poses."""
    forget_previews()
