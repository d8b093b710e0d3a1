"""Captured hands, or a character, written to a file for other programs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy

from handfit_core.common.errors import OptionError

from ..common.section import note, split
from ..exporters import EXPORTERS, PRESETS
from ..exporters.export_hands import Stage, export_hands
from ..exporters.exporter import Exporter, HandObjects
from ..scene.characters import CharacterObjects, active_character, why_not_written
from ..scene.editable import why_not_readable
from ..scene.keys import read_pose_keys
from ..scene.store import CapturedHand, attached_objects, captured_hands, hand_of
from ..session.properties import EXPORT_FORMATS, has_surface
from .base import NO_CHARACTER, HandOperator, ManientOperator, polled_character, polled_hand

_OF_HANDS = "holds captured hands, no characters"


def _why_no_format(exporter: Exporter, *, character: bool) -> str:
    """Return why a format cannot be written of a hand or a character, as part of a sentence; empty if it
    can."""
    return _OF_HANDS if character and exporter.writes == "captured" else exporter.why_not()


def format_buttons(
    layout: bpy.types.UILayout,
    data: bpy.types.bpy_struct,
    name: str,
    *,
    character: bool = False,
) -> bool:
    """Draw a button for every format of the property `name` of `data`; those that cannot be written are grey,
    and the reason stands below. Return whether the chosen one can be written."""
    reasons: dict[str, list[str]] = {}
    column = layout.column(align=True)
    for start in range(0, len(EXPORT_FORMATS), 3):
        row = column.row(align=True)
        for key, label, _ in EXPORT_FORMATS[start : start + 3]:
            reason = _why_no_format(EXPORTERS[key], character=character)
            cell = row.row(align=True)
            cell.enabled = not reason
            cell.prop_enum(data, name, key)
            if reason:
                reasons.setdefault(reason, []).append(label)
    for reason, labels in reasons.items():
        note(layout, f"{', '.join(labels)}: {reason}", "INFO")
    return not _why_no_format(EXPORTERS[getattr(data, name)], character=character)


class _ExportOperator(ManientOperator):
    """The base of operators that ask for a file and write hands, or a character, to it."""

    bl_options = {"REGISTER"}

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})
    filter_glob: bpy.props.StringProperty(options={"HIDDEN"})
    check_existing: bpy.props.BoolProperty(default=True, options={"HIDDEN"})
    preset: bpy.props.EnumProperty(name="For", items=PRESETS)
    frame_range: bpy.props.EnumProperty(
        name="Frames",
        items=(
            ("SCENE", "Scene", "The scene's frame range"),
            ("KEYS", "Keys", "From the first key to the last"),
        ),
        default="SCENE",
    )
    file_format: Any
    character: bool
    """True if the operator writes characters, and not captured hands"""

    def _title(self, context: bpy.types.Context) -> str:
        """Return the file's name where nobody gives one."""
        raise NotImplementedError

    def _chosen(self, context: bpy.types.Context) -> Sequence[HandObjects]:
        """Return the hands, or the character, that are written. Raises HandfitError."""
        raise NotImplementedError

    def _keyed(self, chosen: Sequence[HandObjects]) -> list[float]:
        """Return the scene frames on which they have keys."""
        raise NotImplementedError

    def invoke(self, context, _event):
        """Ask for the file, with the format of the panel."""
        self._fill_in(context)
        if not self.filepath:
            self.filepath = bpy.path.clean_name(self._title(context))
            if bpy.data.filepath:
                self.filepath = str(Path(bpy.data.filepath).parent / self.filepath)
        self.check(context)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def check(self, _context):
        """Keep the file's extension that of the format."""
        self.filter_glob = f"*{Path('name' + self._exporter.suffix).suffix}"
        path = self._path()
        if str(path) == self.filepath:
            return False
        self.filepath = str(path)
        return True

    def draw(self, context):
        layout = self.layout
        format_buttons(layout, self, "file_format", character=self.character)
        split(layout)
        if self._exporter.presets:
            layout.prop(self, "preset")
        if self._exporter.writes == "hands":
            layout.prop(self, "frame_range")
        self._draw_own(layout)

    def run(self, context):
        self._fill_in(context)
        if not self.filepath:
            raise OptionError("choose a file to export to")
        if self.character and self._exporter.writes == "captured":
            raise OptionError(f"{self._exporter.label} {_OF_HANDS}: choose another format")
        chosen, path = self._chosen(context), self._path()
        files = export_hands(
            chosen,
            self._stage(context.scene, chosen),
            path.parent,
            path.name.removesuffix(self._exporter.suffix),
            self.file_format,
            preset=self.preset if self._exporter.presets else "PLAIN",
        )
        more = self._left_out(chosen) + self._cut_off(context.scene, chosen)
        return f"Wrote {', '.join(f.name for f in files)} to {path.parent}{more}"

    def _left_out(self, _chosen: Sequence[HandObjects]) -> str:
        """Return a sentence for the report about objects that are not in the file; empty without any."""
        return ""

    def _cut_off(self, scene: bpy.types.Scene, chosen: Sequence[HandObjects]) -> str:
        """Return a sentence for the report about keys before or after the frames in the file; empty without
        any."""
        if self.frame_range != "SCENE" or self._exporter.writes != "hands":
            return ""
        frames, last = self._keyed(chosen), scene.frame_end
        if not frames or (scene.frame_start <= min(frames) and max(frames) <= last):
            return ""
        return (
            f"; of keys on {min(frames):.0f} to {max(frames):.0f} it has the scene's frames, "
            f"{scene.frame_start} to {last}: choose Keys for all"
        )

    def _draw_own(self, layout: bpy.types.UILayout) -> None:
        """Draw the properties that only this operator has."""

    def _fill_in(self, context) -> None:
        """Set the properties that the caller did not set, as the panel has them."""
        settings = context.scene.manient
        for name, value in (("file_format", settings.export_format), ("preset", settings.export_preset)):
            if not self.properties.is_property_set(name):
                setattr(self, name, value)

    @property
    def _exporter(self) -> Exporter:
        return EXPORTERS[self.file_format]

    def _path(self) -> Path:
        """Return the path of the file, with the right extension instead of another format's."""
        path = Path(bpy.path.abspath(self.filepath))
        wanted, name = self._exporter, path.name
        for e in EXPORTERS.values():
            for ending in (e.suffix, *e.kept_endings, *e.other_endings):
                if name.lower().endswith(ending):
                    if ending in wanted.kept_endings:
                        return path
                    return path.with_name(name[: -len(ending)] + wanted.suffix)
        return path.with_name(name + wanted.suffix)

    def _stage(self, scene, chosen: Sequence[HandObjects]) -> Stage:
        if self.frame_range == "SCENE" or self._exporter.writes != "hands":
            return Stage.of_scene(scene)
        frames = self._keyed(chosen)
        if not frames:
            who = "the character has" if self.character else "the hands have"
            raise OptionError(f"{who} no keys; export the scene's frame range instead")
        return Stage.of_scene(scene, math.floor(min(frames)), math.ceil(max(frames)))


class MANIENT_OT_export_hand(_ExportOperator, HandOperator, bpy.types.Operator):
    """Write the active hand and the others of its capture, as they are now, to a file."""

    bl_label = "Export Hands"
    why_not = staticmethod(why_not_readable)
    anywhere = True
    character = False

    file_format: bpy.props.EnumProperty(name="Format", items=EXPORT_FORMATS)
    active_only: bpy.props.BoolProperty(
        name="Active Hand Only", description="Leave out the other hands of the capture", default=False
    )
    held: bpy.props.BoolProperty(
        name="Held Objects",
        description="Write what hangs on the hands as it is, by Grip, a parent or a Child Of constraint",
        default=True,
    )

    def _title(self, context):
        return polled_hand(context).collection.name

    def _draw_own(self, layout):
        layout.prop(self, "active_only")
        if self._exporter.writes == "hands":
            layout.prop(self, "held")

    def _left_out(self, chosen):
        written = [o for hand in chosen for o in hand.held]
        others = dict.fromkeys(o.name for hand in chosen for o in attached_objects(hand) if o not in written)
        if not others or self._exporter.writes != "hands":
            return ""
        return (
            f" without {', '.join(others)}: of what hangs on hands only objects that they hold are exported"
        )

    def _chosen(self, context) -> list[CapturedHand]:
        active = polled_hand(context)
        own = {active.index: active}
        for hand in map(hand_of, () if self.active_only else captured_hands(context.scene)):
            if hand is not None and hand.collection == active.collection:
                own.setdefault(hand.index, hand)  # copies of a hand are left out
        wanted = self.held and self._exporter.writes == "hands"
        holders = {o: index for index, hand in own.items() if wanted for o in _held(hand)}
        held = {index: tuple(o for o in holders if holders[o] == index) for index in own}
        return [replace(own[index], held=held[index]) for index in sorted(own)]

    def _keyed(self, chosen: Any) -> list[float]:
        return [f for hand in chosen for f in read_pose_keys(hand.rig).frames.tolist()]


def _held(hand: CapturedHand) -> Iterator[bpy.types.Object]:
    """Yield the objects that hang on a hand, or on what hangs on it, and that renders show, but for those
    that an armature deforms."""
    for held in attached_objects(hand):
        for o in (held, *held.children_recursive):
            if has_surface(o) and not o.hide_render and all(m.type != "ARMATURE" for m in o.modifiers):
                yield o


class MANIENT_OT_export_character(_ExportOperator, bpy.types.Operator):
    """Write the active character, as it moves now, to a file: the bones that deform it, without its controls,
    or for avatars what its fingers and wrists do."""

    bl_label = "Export Character"
    character = True

    file_format: bpy.props.EnumProperty(name="Format", items=EXPORT_FORMATS, default="vrma")
    meshes: bpy.props.BoolProperty(
        name="Meshes",
        description="Write what the character deforms or carries and renders show",
        default=True,
    )

    @classmethod
    def poll_reason(cls, context):
        armature = active_character(context)
        if armature is None:
            return NO_CHARACTER
        return why_not_written(armature, context.scene)

    def _fill_in(self, context):
        # Scripts that name none want VRM, as they always did.
        if self.properties.is_property_set("file_format"):
            super()._fill_in(context)

    def _title(self, context):
        return polled_character(context).name

    def _draw_own(self, layout):
        if self._exporter.bakes:
            layout.prop(self, "meshes")

    def _chosen(self, context):
        character = CharacterObjects.of(polled_character(context))
        return [character if self.meshes else CharacterObjects(character.armature, ())]

    def _keyed(self, chosen):
        animation = chosen[0].armature.animation_data
        if animation is None:
            return []
        strips = [strip for track in animation.nla_tracks for strip in track.strips]
        frames = [frame for strip in strips for frame in (strip.frame_start, strip.frame_end)]
        return [*frames, *(animation.action.frame_range if animation.action is not None else ())]
