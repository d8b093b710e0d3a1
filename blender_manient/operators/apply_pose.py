"""Put a pose of the library on the selected hand."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

import bpy

from handfit_core.errors import HandfitError
from handfit_core.hand_model.poses import Pose

from ..blender_versions import property_group
from ..properties import BLEND
from ..scene.poses import (
    PROPERTY,
    PosableHand,
    forget_previews,
    kept_pose,
    posable_hands,
    pose_named,
    posed_by,
    why_not_posable,
)
from ..scene.spans import SCOPES, RequestedFrames, suggested_range
from ..scene.store import CapturedHand
from .mixins import PollMixin, errors_reported


class _PoseOperator(PollMixin):
    """The base of operators that put a pose on the active captured hand or character."""

    report: Any
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    blend: bpy.props.FloatProperty(**BLEND)  # type: ignore
    scope: bpy.props.EnumProperty(**SCOPES)  # type: ignore
    first: bpy.props.IntProperty(name="First", description="First scene frame", default=1)  # type: ignore
    last: bpy.props.IntProperty(name="Last", description="Last scene frame", default=250)  # type: ignore

    @classmethod
    def lacks(cls, context):
        return why_not_posable(context)

    def _put(
        self, context: bpy.types.Context, pose_of: Callable[[PosableHand], Pose | None], name: str
    ) -> set[str]:
        hands = posable_hands(context)
        asked = RequestedFrames(self.scope, self.first, self.last, context.scene.manient.spread)
        # All of them, before one is changed.
        poses = [hand.towards(context, pose_of(hand), self.blend, asked) for hand in hands]
        for hand, posed in zip(hands, poses, strict=True):
            hand.put(context, posed)
        spans = [posed.span for posed in poses if posed.span is not None]
        if spans:
            scene = context.scene
            scene.frame_set(scene.frame_current, subframe=scene.frame_subframe)
            first, last = min(span.first for span in spans), max(span.last for span in spans)
            self.report({"INFO"}, f"{name}: frames {first:g} to {last:g}")
        return {"FINISHED"}


class MANIENT_OT_apply_pose(_PoseOperator, bpy.types.Operator):
    bl_idname = "manient.apply_pose"
    bl_label = "Apply Pose"
    bl_description = (
        "Put a pose on the fingers: those with selected bones, else all; the wrist stays. On a captured hand "
        "this fades out over Spread, and Clear takes it back; bones that are animated get keys, others one "
        "on the current frame with Auto Keying. A character's bones get keys"
    )

    source: bpy.props.EnumProperty(  # type: ignore
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
    pose: bpy.props.StringProperty(  # type: ignore
        name="Pose", description="A ready pose, or a pose asset of this file", options={"SKIP_SAVE"}
    )

    @classmethod
    def description(cls, _context, properties):
        """The tooltip: what is put, and on which frames."""
        kind = properties.bl_rna.properties
        source, scope = (
            kind[name].enum_items[getattr(properties, name)].description for name in ("source", "scope")
        )
        return f"{cls.bl_description}.\n{source}.\n{scope}"

    @errors_reported
    def execute(self, context):
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
    bl_idname = "manient.apply_pose_asset"
    bl_label = "Apply to Hand"
    bl_description = (
        "Put this pose, which Hand Capture saved, on the selected captured hand or character, whatever its "
        "bones are called; the other side's is mirrored"
    )

    @classmethod
    def lacks(cls, context):
        asset = getattr(context, "asset", None)
        if asset is None or not property_group(asset.metadata, PROPERTY):
            return "Choose a pose asset that Save Pose Asset made"
        return super().lacks(context)

    @errors_reported
    def execute(self, context):
        pose = kept_pose(context.asset.metadata)
        return self._put(context, lambda _: pose, context.asset.name)


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


def register() -> None:
    """Add it to the asset browser's menu."""
    bpy.types.ASSETBROWSER_MT_context_menu.prepend(_in_menu)


def unregister() -> None:
    """Take it away, and the pictures."""
    bpy.types.ASSETBROWSER_MT_context_menu.remove(_in_menu)
    forget_previews()
