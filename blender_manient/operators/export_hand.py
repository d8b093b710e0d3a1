"""Write a captured hand, or all hands of its capture, to a file for other programs."""

from __future__ import annotations

import math
from pathlib import Path

import bpy

from handfit_core.errors import OptionError

from ..exporters import EXPORTERS, PRESETS
from ..exporters.exporter import Exporter
from ..properties import EXPORT_FORMATS
from ..scene.editable import why_not_readable
from ..scene.export import Stage, export_hands
from ..scene.keys import read_pose_keys
from ..scene.store import CapturedHand, captured_hands, hand_of, hung_on
from ..section import sentence, split
from .needs_hand import OnHand, errors_reported, hand_in


def format_buttons(
    layout: bpy.types.UILayout, context: bpy.types.Context, data: bpy.types.bpy_struct, name: str
) -> bool:
    """A button for every format of the property `name` of `data`; those that this Blender cannot write are
    grey, and the reason stands below. Returns whether the chosen one can be written."""
    reasons: dict[str, list[str]] = {}
    column = layout.column(align=True)
    for start in range(0, len(EXPORT_FORMATS), 3):
        row = column.row(align=True)
        for key, label, _ in EXPORT_FORMATS[start : start + 3]:
            reason = EXPORTERS[key].why_not()
            cell = row.row(align=True)
            cell.enabled = not reason
            cell.prop_enum(data, name, key)
            if reason:
                reasons.setdefault(reason, []).append(label)
    for reason, labels in reasons.items():
        sentence(layout, context, f"{', '.join(labels)}: {reason}", "INFO")
    return not EXPORTERS[getattr(data, name)].why_not()


class MANIENT_OT_export_hand(OnHand, bpy.types.Operator):
    bl_idname = "manient.export_hand"
    bl_label = "Export Hands"
    bl_description = "Write the active hand and the others of its capture, as they are now, to a file"
    bl_options = {"REGISTER"}  # noqa: RUF012
    why_not = staticmethod(why_not_readable)
    anywhere = True

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})  # type: ignore
    filter_glob: bpy.props.StringProperty(options={"HIDDEN"})  # type: ignore
    check_existing: bpy.props.BoolProperty(default=True, options={"HIDDEN"})  # type: ignore
    file_format: bpy.props.EnumProperty(name="Format", items=EXPORT_FORMATS)  # type: ignore
    preset: bpy.props.EnumProperty(name="For", items=PRESETS)  # type: ignore
    active_only: bpy.props.BoolProperty(  # type: ignore
        name="Active Hand Only", description="Leave out the other hands of the capture", default=False
    )
    frame_range: bpy.props.EnumProperty(  # type: ignore
        name="Frames",
        items=(
            ("SCENE", "Scene", "The scene's frame range"),
            ("KEYS", "Keys", "From the hands' first key to their last"),
        ),
        default="SCENE",
    )

    def invoke(self, context, event):
        """Ask for the file, with the format of the panel."""
        self._fill_in(context)
        if not self.filepath:
            self.filepath = bpy.path.clean_name(hand_in(context).collection.name)
            if bpy.data.filepath:
                self.filepath = str(Path(bpy.data.filepath).parent / self.filepath)
        self.check(context)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def check(self, _context):
        """Keep the extension that of the format."""
        self.filter_glob = f"*{Path('name' + self._exporter.suffix).suffix}"
        path = self._path()
        if str(path) == self.filepath:
            return False
        self.filepath = str(path)
        return True

    def draw(self, context):
        layout = self.layout
        format_buttons(layout, context, self, "file_format")
        split(layout)
        if self._exporter.presets:
            layout.prop(self, "preset")
        if self._exporter.writes == "hands":
            layout.prop(self, "frame_range")
        layout.prop(self, "active_only")

    @errors_reported
    def execute(self, context):
        """Write the file or files."""
        self._fill_in(context)
        if not self.filepath:
            raise OptionError("choose a file to export to")
        hands = self._hands(context)
        path = self._path()
        files = export_hands(
            hands,
            self._stage(context.scene, hands),
            path.parent,
            path.name.removesuffix(self._exporter.suffix),
            self.file_format,
            preset=self.preset if self._exporter.presets else "PLAIN",
        )
        wrote = f"Wrote {', '.join(f.name for f in files)} to {path.parent}"
        others = [o.name for hand in hands for o in hung_on(hand)] if self._exporter.writes == "hands" else []
        if others:
            wrote += f" without {', '.join(others)}: only hands are exported, not what hangs on them"
        self.report({"INFO"}, wrote)
        return {"FINISHED"}

    def _fill_in(self, context) -> None:
        """What the caller left open is as the panel says."""
        settings = context.scene.manient
        if not self.properties.is_property_set("file_format"):
            self.file_format = settings.export_format
        if not self.properties.is_property_set("preset"):
            self.preset = settings.export_preset

    @property
    def _exporter(self) -> Exporter:
        return EXPORTERS[self.file_format]

    def _path(self) -> Path:
        """The file with the right extension instead of another format's."""
        path = Path(bpy.path.abspath(self.filepath))
        wanted, name = self._exporter, path.name
        for e in EXPORTERS.values():
            for ending in (e.suffix, *e.kept_endings, *e.other_endings):
                if name.lower().endswith(ending):
                    if ending in wanted.kept_endings:
                        return path
                    return path.with_name(name[: -len(ending)] + wanted.suffix)
        return path.with_name(name + wanted.suffix)

    def _hands(self, context) -> list[CapturedHand]:
        active = hand_in(context)
        if self.active_only:
            return [active]
        found = [hand_of(armature) for armature in captured_hands(context.scene)]
        own = {active.index: active}
        for hand in found:
            if hand is not None and hand.collection == active.collection:
                own.setdefault(hand.index, hand)  # copies of a hand are left out
        return [own[index] for index in sorted(own)]

    def _stage(self, scene, hands: list[CapturedHand]) -> Stage:
        if self.frame_range == "SCENE" or self._exporter.writes != "hands":
            return Stage.of_scene(scene)
        frames = [f for hand in hands for f in read_pose_keys(hand.rig).frames.tolist()]
        if not frames:
            raise OptionError("the hands have no keys; export the scene's frame range instead")
        return Stage.of_scene(scene, math.floor(min(frames)), math.ceil(max(frames)))
