"""Writing hands and characters to files of other programs: only their armatures and meshes, over a range of
frames. Of a character's armature a file has the bones that deform, with a key on every frame.

What a hand holds is written as a mesh beside it, with a key on every frame. What else it deforms, such as
gloves, is not: programs that take the skeleton over would deform it wrongly.

Presets say what a program expects of a format beyond Blender's habits:

* PLAIN: Blender's objects as they are.
* UNITY: metres, with every object's scale 1 and rotation 0 under Unity's axes (Y up), so that "Convert
  Units" and "Bake Axis Conversion" have nothing to do; in glTF four bones per vertex, as many as its
  default quality uses.
* UNREAL: FBX in centimetres (its importers take a unit for one, whatever the file says) with Z up and
  -Y to the front, which is what it turns files into, smoothing groups (it warns without), and an armature
  object that makes a good root bone: its importer turns the object into the root, unless it is called
  "Armature". The object stands still, so that the root does.
"""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PureWindowsPath
from typing import Any

import bpy
import numpy as np

from handfit_core.common.errors import HandfitError, OptionError, OutputError
from handfit_core.common.files import check_room, shown, written_whole
from handfit_core.take import Take

from ..common.plugins import failure_sentence
from ..rigs.arm import has_arm
from ..rigs.controls import control_bones
from ..scene.build import BuiltTake
from ..scene.camera import frame_scene
from ..scene.characters import CharacterObjects
from ..scene.mesh import IN_RENDERS
from ..scene.own_scene import object_mode, own_scene, shown_in_pose, unseen_scene, with_values
from ..scene.proof import prove_whole
from ..scene.store import is_deformed_by
from ..scene.timing import set_timing
from . import EXPORTERS, PRESETS, find_exporter
from .clean_rig import clean_rig
from .exporter import Exporter, HandObjects, Preset

_RENDER = ("fps", "fps_base", "resolution_x", "resolution_y", "pixel_aspect_x", "pixel_aspect_y")


@dataclass(frozen=True)
class Stage:
    """Timing and size of what is written."""

    render: Mapping[str, Any]
    """a scene's render settings `_RENDER`"""
    first: int
    last: int
    metres_per_unit: float
    """Metres for one unit of length of the scene that the hands are in"""
    view_transform: str
    """How colours are shown: the picture behind the hands keeps its own in `Standard`"""

    @classmethod
    def of_scene(cls, scene: bpy.types.Scene, first: int | None = None, last: int | None = None) -> Stage:
        """Return the stage of a scene as it is; `first` and `last` replace its frame range."""
        return cls(
            {name: getattr(scene.render, name) for name in _RENDER},
            scene.frame_start if first is None else first,
            scene.frame_end if last is None else last,
            scene.unit_settings.scale_length,
            scene.view_settings.view_transform,
        )

    @classmethod
    def of_take(cls, take: Take) -> Stage:
        """Return the stage that a scene gets that is matched to the take; the unit of length and how colours
        are shown are the open scene's."""
        metres_per_unit = bpy.context.scene.unit_settings.scale_length
        view_transform = bpy.context.scene.view_settings.view_transform
        with unseen_scene("take") as scene:
            scene.unit_settings.scale_length = metres_per_unit
            scene.view_settings.view_transform = view_transform
            set_timing(scene, take)
            frame_scene(scene, take)
            return cls.of_scene(scene)

    def apply(self, scene: bpy.types.Scene) -> None:
        """Give it to a scene, whose unit of length stays."""
        for name, value in self.render.items():
            setattr(scene.render, name, value)
        scene.render.resolution_percentage = 100
        scene.frame_start, scene.frame_end = self.first, self.last
        scene.view_settings.view_transform = self.view_transform


def export_take(built: BuiltTake, take: Take, folder: Path, name: str, fmt: str) -> list[Path]:
    """Write a built take as it was captured: `export_hands` with its own range, rate and size."""
    whole = built.collection, built.camera
    return export_hands(built.hands, Stage.of_take(take), folder, name, fmt, whole=whole)


def export_hands(
    hands: Sequence[HandObjects],
    stage: Stage,
    folder: Path,
    name: str,
    fmt: str,
    *,
    preset: str = "PLAIN",
    whole: tuple[bpy.types.Collection, bpy.types.Object] | None = None,
) -> list[Path]:
    """Write hands, or a character, in one format into `folder` and return the files written, each whole or
    not at all.

    The files are `name.<suffix>`, unless the name has another ending that the format keeps; formats that hold
    one skeleton (BVH) get one file per hand, with `_left` and `_right` where there are two (`_left` and
    `_left2` for two left hands). Frame numbers are kept. `whole`, a collection and its camera, is what .blend
    files hold; of a character they hold the whole open file. For takes the hands are `CapturedHand`s. Lengths
    are in metres (Unreal's FBX: centimetres), whatever the scene's unit. The rest of the open Blender file is
    neither written nor changed.
    Raises OptionError and OutputError.
    """
    chosen = find_exporter(fmt)
    if reason := chosen.why_not():
        raise OptionError(
            f"this Blender cannot write {fmt}: {reason}, or choose from "
            f"{', '.join(k for k, e in EXPORTERS.items() if not e.why_not())}"
        )
    presets = [name for name, *_ in PRESETS]
    if preset not in presets:
        raise OptionError(f"there is no export preset {preset!r}; choose from {', '.join(presets)}")
    # Only hands of scenes in metres, without controls and arms, which nothing carries and which hold nothing,
    # are as they should be in the file.
    rigged = any(control_bones(h.armature) or has_arm(h.armature) or _is_carried(h.armature) for h in hands)
    holding = not all(is_deformed_by(mesh, h.armature) for h in hands for mesh in h.meshes)
    plain = np.isclose(stage.metres_per_unit, 1.0) and not (rigged or holding)
    wanted = chosen.presets.get(preset, Preset(clean=not plain))
    if _is_character(hands):
        wanted = replace(wanted, clean=chosen.bakes)
    if _is_whole_scene(chosen, hands):
        wanted = Preset(dict(chosen.of_scene or {}), clean=False)
    job = _Export(chosen, wanted, hands, stage, whole)
    with contextlib.ExitStack() as stack:
        if whole is None and chosen.writes == "hands":  # a .blend keeps what is hidden
            stack.enter_context(object_mode())
            stack.enter_context(shown_in_pose(_objects(hands)))
        return job.write(folder, name)


def _objects(hands: Sequence[HandObjects]) -> list[bpy.types.Object]:
    """Return the armatures and meshes of hands."""
    return [o for hand in hands for o in (hand.armature, *hand.meshes)]


@dataclass(frozen=True)
class _Export:
    """The work of writing hands or a character in one format, with its settings."""

    chosen: Exporter
    preset: Preset
    hands: Sequence[HandObjects]
    stage: Stage
    whole: tuple[bpy.types.Collection, bpy.types.Object] | None

    def write(self, folder: Path, name: str) -> list[Path]:
        """Write one file, or one for each hand; return the files."""
        chosen, hands = self.chosen, self.hands
        if not chosen.per_hand:
            file_name = name if name.lower().endswith(chosen.kept_endings) else name + chosen.suffix
            return [self._write_to(folder / file_name)]
        files = []
        for hand in hands:
            side = f"_{hand.side}" if len(hands) > 1 else ""
            path = folder / f"{name}{side}{chosen.suffix}"
            for number in range(2, len(hands) + 1):
                if path in files:
                    path = folder / f"{name}{side}{number}{chosen.suffix}"
            files.append(replace(self, hands=(hand,))._write_to(path))
        return files

    def _write_to(self, path: Path) -> Path:
        with written_whole(path) as beside:
            try:
                with self._opened() as written:
                    objects = _objects(written)
                    bones = [bone.name for hand in written for bone in hand.armature.data.bones]
                    with bpy.context.temp_override(
                        object=next(iter(objects), None), selected_objects=objects
                    ):
                        self.chosen.write(beside, written, self.preset, path)
                prove_whole(path, beside, self.chosen.is_whole)
                if missing := self.chosen.missing(beside, bones):
                    raise OutputError(
                        f"{shown(path)}: Blender wrote it without {missing}, so what was there is kept; "
                        "choose another format or preset"
                    )
            except (HandfitError, OSError):
                raise
            except RuntimeError as error:
                # Somewhere in the words, which may be a traceback, is what the system said; but of a disk
                # without any room some exporters say something else.
                for number in errno.errorcode:
                    if os.strerror(number) in str(error):
                        raise OSError(number, os.strerror(number)) from error
                check_room(beside, 1 << 16)
                reason = " ".join(str(error).split())
                raise OutputError(f"{shown(path)}: Blender could not write it ({reason})") from error
            except Exception as error:  # in a plug-in
                raise OutputError(f"{shown(path)}: {failure_sentence(type(self.chosen), error)}") from error
        return path

    @contextlib.contextmanager
    def _opened(self) -> Iterator[Sequence[HandObjects]]:
        """Make a scene with what the format writes the context's, and yield the hands in it.

        Blender's exporters write what the context's scene holds, at its frame rate and over its range.
        """
        chosen, preset, hands, stage = self.chosen, self.preset, self.hands, self.stage
        if chosen.writes == "captured" or _is_whole_scene(chosen, hands):
            yield hands
            return
        whole = self.whole if chosen.writes != "hands" else None
        name = whole[0].name if whole is not None else "export"
        with own_scene(name) as scene, contextlib.ExitStack() as copies:
            stage.apply(scene)
            if whole is not None:
                scene.collection.children.link(whole[0])
                scene.camera = whole[1]
                scene.unit_settings.scale_length = stage.metres_per_unit
            else:
                copies.enter_context(_files_by_name([hand.armature for hand in hands]))
                copies.enter_context(_unrounded([mesh for hand in hands for mesh in hand.meshes]))
                for obj in _linked(hands, carriers=not preset.clean):
                    scene.collection.objects.link(obj)
                if not preset.clean:
                    scene.unit_settings.scale_length = stage.metres_per_unit
                else:
                    frames, metres = range(stage.first, stage.last + 1), stage.metres_per_unit
                    names = [_root_name(preset.root, hands, index) for index in range(len(hands))]
                    hands = tuple(
                        copies.enter_context(clean_rig(hand, name, frames, metres, preset, chosen.apart))
                        for hand, name in zip(hands, names, strict=True)
                    )
            scene.frame_set(scene.frame_start)
            yield hands


def _is_carried(armature: bpy.types.Object) -> bool:
    """True if another object moves an armature, as a scene's camera does, which no file of hands holds."""
    return armature.parent is not None or any(not constraint.mute for constraint in armature.constraints)


def _is_character(hands: Sequence[HandObjects]) -> bool:
    return any(hand.side is None for hand in hands)


def _is_whole_scene(chosen: Exporter, hands: Sequence[HandObjects]) -> bool:
    """True if the open scene is written as it is, and not a scene with the hands."""
    imported = any(isinstance(hand, CharacterObjects) and hand.imported for hand in hands)
    return (imported and chosen.of_scene is not None) or (
        chosen.writes == "collection" and _is_character(hands)
    )


def _linked(hands: Sequence[HandObjects], *, carriers: bool) -> dict[bpy.types.Object, None]:
    """Return the objects that the exported scene holds; with `carriers`, also the parents of characters."""
    found = dict.fromkeys(_objects(hands))
    carried = list(found) if carriers and _is_character(hands) else []
    for obj in carried:
        while (obj := obj.parent) is not None:
            found[obj] = None
    return found


def _unrounded(meshes: Iterable[bpy.types.Object]) -> contextlib.AbstractContextManager[None]:
    """Have meshes not be subdivided within: files have the model's own vertices, and its shape keys."""
    rounded = [mesh.modifiers[IN_RENDERS] for mesh in meshes if IN_RENDERS in mesh.modifiers]
    return with_values((each, name, False) for each in rounded for name in ("show_render", "show_viewport"))


@contextlib.contextmanager
def _files_by_name(armatures: Sequence[bpy.types.Object]) -> Iterator[None]:
    """Have the armatures' properties name their picture and model without folders within, which are
    private."""
    paths = [
        (armature, key, armature[key])
        for armature in armatures
        for key in ("source", "model")
        if isinstance(armature.get(key), str)
    ]
    try:
        for armature, key, path in paths:
            armature[key] = PureWindowsPath(path).name  # which knows both kinds of slashes
        yield
    finally:
        for armature, key, path in paths:
            armature[key] = path


def _root_name(root: str, hands: Sequence[HandObjects], index: int) -> str:
    """Return the name of a hand's armature object: `root` for one hand, `left_root` and so on for several;
    for a character that has such a bone, what Unreal leaves out."""
    if not root or len(hands) == 1:
        bone = hands[0].armature.data.bones.get(root) if _is_character(hands) else None
        return "Armature" if bone is not None and bone.use_deform else root
    side = hands[index].side
    before = sum(hand.side == side for hand in hands[:index])
    return f"{side}{before + 1 if before else ''}_{root}"
