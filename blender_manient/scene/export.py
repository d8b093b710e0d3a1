"""Writing hands to files of other programs: only their armatures and meshes, over a range of frames.

What else hangs on a hand (rings, gloves, other objects) is never written: it is no part of the hand, and
programs that take the skeleton over would deform it wrongly.

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
import mmap
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PureWindowsPath
from typing import Any

import bpy
import numpy as np
from bpy_extras.io_utils import axis_conversion

from handfit_core.errors import OptionError, OutputError
from handfit_core.files import check_room, shown, written_whole
from handfit_core.take import Take

from ..blender_versions import gltf_left_out, has_operator
from .build import BuiltTake
from .camera import frame_scene
from .clean_rig import Rig, clean_rig
from .object_mode import object_mode
from .own_scene import own_scene, shown_in_pose
from .proof import prove_whole
from .timing import set_timing


@dataclass(frozen=True)
class Stage:
    """Timing and size of what is written."""

    fps: int
    fps_base: float
    first: int
    last: int
    width: int
    height: int
    pixel_aspect: tuple[float, float] = (1.0, 1.0)
    metres_per_unit: float = 1.0
    """of the scene that the hands are in"""
    view_transform: str = "Standard"
    """How colours are shown: the picture behind the hands keeps its own in `Standard`"""

    @classmethod
    def of_scene(cls, scene: bpy.types.Scene, first: int | None = None, last: int | None = None) -> Stage:
        """A scene's own; `first` and `last` replace its frame range."""
        render = scene.render
        return cls(
            render.fps,
            render.fps_base,
            scene.frame_start if first is None else first,
            scene.frame_end if last is None else last,
            render.resolution_x,
            render.resolution_y,
            (render.pixel_aspect_x, render.pixel_aspect_y),
            scene.unit_settings.scale_length,
            scene.view_settings.view_transform,
        )

    @classmethod
    def of_take(cls, take: Take) -> Stage:
        """What a scene gets that is matched to the take; the unit of length and how colours are shown are the
        open scene's."""
        metres_per_unit = _open_scene().unit_settings.scale_length
        view_transform = _open_scene().view_settings.view_transform
        with own_scene("take") as scene:
            scene.unit_settings.scale_length = metres_per_unit
            scene.view_settings.view_transform = view_transform
            set_timing(scene, take)
            frame_scene(scene, take)
            return cls.of_scene(scene)

    def apply(self, scene: bpy.types.Scene) -> None:
        """Give it to a scene, whose unit of length stays."""
        render = scene.render
        render.fps, render.fps_base = self.fps, self.fps_base
        scene.frame_start, scene.frame_end = self.first, self.last
        render.resolution_x, render.resolution_y = self.width, self.height
        render.resolution_percentage = 100
        render.pixel_aspect_x, render.pixel_aspect_y = self.pixel_aspect
        scene.view_settings.view_transform = self.view_transform


@dataclass(frozen=True)
class Preset:
    """What one program wants of one format."""

    keywords: dict[str, Any] = field(default_factory=dict)
    """For Blender's exporter, over those of the format"""
    clean: bool = True
    """Whether the rig is written as `clean_rig` makes it"""
    units: float = 1.0
    """How many units of the file a metre is"""
    turn: np.ndarray | None = None
    """(3, 3) what the data is turned by, so that the objects need not be"""
    root: str = ""
    """What the armature object is called; empty: as in Blender"""


@dataclass(frozen=True)
class Format:
    """One file format that hands can be written in."""

    suffix: str
    operator: str
    """The Blender operator that it needs, as module.name; empty for none"""
    write: Callable[[Path, tuple[Rig, ...], Preset], None]
    """Called with a scene open that holds nothing but the hands, at their frame range and rate"""
    per_hand: bool = False
    """Whether each hand needs a file of its own"""
    presets: dict[str, Preset] = field(default_factory=dict)
    """What differs for UNITY and UNREAL"""


def export_take(built: BuiltTake, take: Take, folder: Path, name: str, fmt: str) -> list[Path]:
    """Write a built take as it was captured: `export_hands` with its own range, rate and size."""
    rigs = tuple(Rig(hand.side, hand.armature, hand.mesh) for hand in built.hands)
    return export_hands(rigs, Stage.of_take(take), folder, name, fmt, whole=(built.collection, built.camera))


def export_hands(
    hands: tuple[Rig, ...],
    stage: Stage,
    folder: Path,
    name: str,
    fmt: str,
    *,
    preset: str = "PLAIN",
    whole: tuple[bpy.types.Collection, bpy.types.Object] | None = None,
) -> list[Path]:
    """Write hands in one format into `folder` and return the files written, each whole or not at all.

    The files are `name.<suffix>`; formats that hold one skeleton (BVH) get one file per hand, with
    `_left` and `_right` where there are two (`_left` and `_left2` for two left hands). Frame numbers
    are kept. `whole`, a collection and its camera, is what .blend files hold. Lengths are in metres
    (Unreal's FBX: centimetres), whatever the scene's unit. The rest of the open Blender file is neither
    written nor changed. Raises OptionError and OutputError.
    """
    chosen = find_format(fmt)
    if reason := why_not(chosen):
        raise OptionError(
            f"this Blender cannot write {fmt}: {reason}, or choose from "
            f"{', '.join(k for k, f in FORMATS.items() if available(f))}"
        )
    if preset not in PRESETS:
        raise OptionError(f"there is no export preset {preset!r}; choose from {', '.join(PRESETS)}")
    # Only hands of scenes in metres are as they should be in the file without more ado.
    wanted = chosen.presets.get(preset, Preset(clean=not np.isclose(stage.metres_per_unit, 1.0)))
    objects = [o for hand in hands for o in (hand.armature, hand.mesh)]
    with contextlib.ExitStack() as stack:
        if whole is None:  # a .blend keeps what is hidden
            stack.enter_context(object_mode())
            stack.enter_context(shown_in_pose(objects))
        return _write_all(chosen, wanted, hands, stage, folder, name, whole)


def _write_all(
    chosen: Format,
    wanted: Preset,
    hands: tuple[Rig, ...],
    stage: Stage,
    folder: Path,
    name: str,
    whole: tuple[bpy.types.Collection, bpy.types.Object] | None,
) -> list[Path]:
    """One file, or one for each hand."""
    if not chosen.per_hand:
        return [_write_one(chosen, wanted, hands, stage, folder / (name + chosen.suffix), whole)]
    files = []
    for hand in hands:
        side = f"_{hand.side}" if len(hands) > 1 else ""
        path = folder / f"{name}{side}{chosen.suffix}"
        for number in range(2, len(hands) + 1):
            if path in files:
                path = folder / f"{name}{side}{number}{chosen.suffix}"
        files.append(_write_one(chosen, wanted, (hand,), stage, path, whole))
    return files


def find_format(fmt: str) -> Format:
    """The format of that name (case and a leading dot do not matter). Raises OptionError."""
    chosen = FORMATS.get(fmt.lower().lstrip("."))
    if chosen is None:
        raise OptionError(f"there is no export format {fmt!r}; choose from {', '.join(FORMATS)}")
    return chosen


def why_not(fmt: Format) -> str:
    """Why this Blender cannot write the format, and what to do, as part of a sentence; empty if it can."""
    if not fmt.operator or has_operator(fmt.operator):
        return ""
    if fmt.operator.startswith("wm."):
        return "missing in this build of Blender; take the one from blender.org"
    return "switched off with its add-on; enable that in Blender's preferences"


def available(fmt: Format) -> bool:
    """Whether this Blender can write the format (some builds lack USD and Alembic)."""
    return not why_not(fmt)


def _write_one(
    fmt: Format,
    preset: Preset,
    hands: tuple[Rig, ...],
    stage: Stage,
    path: Path,
    whole: tuple[bpy.types.Collection, bpy.types.Object] | None,
) -> Path:
    with written_whole(path) as beside:
        try:
            with _only(hands, stage, preset, whole if fmt.suffix == ".blend" else None) as written:
                fmt.write(beside, written, preset)
        except RuntimeError as error:
            # Somewhere in the words, which may be a traceback, is what the system said; but of a disk without
            # any room some exporters say something else.
            for number in errno.errorcode:
                if os.strerror(number) in str(error):
                    raise OSError(number, os.strerror(number)) from error
            check_room(beside, 1 << 16)
            reason = " ".join(str(error).split())
            raise OutputError(f"{shown(path)}: Blender could not write it ({reason})") from error
        prove_whole(path, beside)
    return path


@contextlib.contextmanager
def _only(
    hands: tuple[Rig, ...],
    stage: Stage,
    preset: Preset,
    whole: tuple[bpy.types.Collection, bpy.types.Object] | None,
) -> Iterator[tuple[Rig, ...]]:
    """Open a scene of its own with nothing but the hands, and yield what is in it.

    Exporters write what the open scene holds, at its frame rate and over its range. With `whole` it
    holds the collection with its camera instead of only armatures and meshes.
    """
    name = whole[0].name if whole is not None else "export"
    with own_scene(name) as scene, contextlib.ExitStack() as copies:
        stage.apply(scene)
        if whole is not None:
            scene.collection.children.link(whole[0])
            scene.camera = whole[1]
            scene.unit_settings.scale_length = stage.metres_per_unit
        else:
            copies.enter_context(_files_by_name([hand.armature for hand in hands]))
            for hand in hands:
                scene.collection.objects.link(hand.armature)
                if hand.mesh is not None:
                    scene.collection.objects.link(hand.mesh)
            if preset.clean:
                frames = range(stage.first, stage.last + 1)
                hands = tuple(
                    copies.enter_context(
                        clean_rig(
                            hand,
                            _root_name(preset.root, hands, index),
                            frames,
                            metres_per_unit=stage.metres_per_unit,
                            units=preset.units,
                            turn=preset.turn,
                        )
                    )
                    for index, hand in enumerate(hands)
                )
        scene.frame_set(scene.frame_start)
        yield hands


@contextlib.contextmanager
def _files_by_name(armatures: Sequence[bpy.types.Object]) -> Iterator[None]:
    """What armatures say about their picture and model is without folders meanwhile, which are private."""
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


def _blank(path: Path, folder: Path) -> None:
    """Put ./././ in place of a folder's name in a file, which stays as long as it is."""
    name = os.fsencode(f"{folder}{os.sep}")
    if len(name) < 5:  # so near to the root it tells nothing, and may stand among numbers by chance
        return
    with path.open("rb+") as stream, mmap.mmap(stream.fileno(), 0) as content:
        place = content.find(name)
        while place >= 0:
            content[place : place + len(name)] = (b"./" * len(name))[: len(name) - 1] + b"/"
            place = content.find(name, place + len(name))


def _root_name(root: str, hands: Sequence[Rig], index: int) -> str:
    """`root` for one hand, `left_root` and so on for several."""
    if not root or len(hands) == 1:
        return root
    side = hands[index].side
    before = sum(hand.side == side for hand in hands[:index])
    return f"{side}{before + 1 if before else ''}_{root}"


@contextlib.contextmanager
def _own_settings_left_out() -> Iterator[None]:
    """Keep what the add-on itself notes on objects out of glTF's extras, which up to Blender 4.5 take all
    that add-ons register for custom properties."""
    left_out = gltf_left_out()
    left_out.append("manient")
    try:
        yield
    finally:
        left_out.remove("manient")


def _gltf(path: Path, hands: tuple[Rig, ...], preset: Preset) -> None:
    # The exporter takes all children of what is in the scene, wherever they are, unless they are unselected.
    for obj in (o for hand in hands for o in (hand.armature, hand.mesh) if o is not None):
        obj.select_set(True, view_layer=bpy.context.view_layer)
    # The exporter (4.2 to 5.2) multiplies by fps_base where it should divide; a test reads the times.
    render = _open_scene().render
    render.fps_base = 1.0 / render.fps_base
    keywords = {
        "filepath": str(path),
        "check_existing": False,
        "export_format": "GLB",
        "use_active_scene": True,
        "use_selection": True,
        "export_cameras": False,
        "export_lights": False,
        "export_extras": True,
        "export_apply": False,  # applying modifiers would drop the shape keys
        "export_all_influences": True,  # the default keeps four per vertex, which is another skin
        "export_animations": True,
        # One clip with both hands; the other modes add every action in the file that would fit.
        "export_animation_mode": "SCENE",
        "export_anim_scene_split_object": False,
        "export_frame_range": True,
        "export_force_sampling": True,
        "export_optimize_animation_size": False,
        "export_morph_normal": False,
    }
    with _own_settings_left_out():
        bpy.ops.export_scene.gltf(**keywords | preset.keywords)


def _fbx(path: Path, _hands: tuple[Rig, ...], preset: Preset) -> None:
    keywords = {
        "filepath": str(path),
        "check_existing": False,
        "object_types": {"ARMATURE", "MESH"},
        "use_custom_props": True,
        "add_leaf_bones": False,
        "use_armature_deform_only": False,
        "apply_scale_options": "FBX_SCALE_ALL",  # metres arrive as metres, without a scale of 100 on the rig
        "bake_anim": True,
        "bake_anim_use_all_bones": True,
        "bake_anim_use_nla_strips": False,
        "bake_anim_use_all_actions": False,
        "bake_anim_force_startend_keying": True,
        "bake_anim_step": 1.0,
        "bake_anim_simplify_factor": 0.0,
        "path_mode": "STRIP",  # textures by name: where they lie is private
    }
    bpy.ops.export_scene.fbx(**keywords | preset.keywords)
    # It also names each texture with the folder that the file is in.
    _blank(path, Path(os.path.abspath(path.parent)))  # noqa: PTH100  Links stay as they are.


def _usd(path: Path, _hands: tuple[Rig, ...], _preset: Preset) -> None:
    bpy.ops.wm.usd_export(
        filepath=str(path),
        check_existing=False,
        export_animation=True,
        export_armatures=True,
        export_shapekeys=True,
        export_uvmaps=True,
        export_custom_properties=False,  # USD has no type for the ten betas
        evaluation_mode="RENDER",
    )


def _alembic(path: Path, hands: tuple[Rig, ...], _preset: Preset) -> None:
    scene = _open_scene()
    # Where the disk is full, Alembic ends Blender.
    check_room(path, _alembic_size([hand.mesh for hand in hands if hand.mesh is not None]))
    bpy.ops.wm.alembic_export(
        filepath=str(path),
        check_existing=False,
        start=scene.frame_start,
        end=scene.frame_end,
        as_background_job=False,
        uvs=True,
        evaluation_mode="RENDER",
    )
    _blank(path, Path(bpy.data.filepath).parent)  # the description names the open file


def _alembic_size(meshes: Sequence[bpy.types.Object]) -> int:
    """Bytes that the open scene with these meshes takes at most as Alembic, rather too many than too few."""
    scene = _open_scene()
    frames = scene.frame_end - scene.frame_start + 1
    graph = bpy.context.evaluated_depsgraph_get()
    size = 1 << 16
    for obj in meshes:
        shown = obj.evaluated_get(graph)
        mesh = shown.to_mesh()
        points, corners, faces = len(mesh.vertices), len(mesh.loops), len(mesh.polygons)
        layers, smooth = len(mesh.uv_layers), mesh.normals_domain == "POINT"
        shown.to_mesh_clear()
        finer = 4 ** sum(
            max(0, m.render_levels - (m.levels if m.show_viewport else 0))
            for m in obj.modifiers
            if m.type in {"SUBSURF", "MULTIRES"} and m.show_render
        )
        # Every frame has the points and, of what is not all smooth, the corners' normals; the first also the
        # points before any bone moved them, and what the faces are made of.
        each = 12 * points + (0 if smooth else 12 * corners)
        once = 24 * points + (8 + 12 * layers) * corners + 4 * faces
        size += finer * (frames * each + once) + frames * 1024
    return size + size // 4


def _bvh(path: Path, hands: tuple[Rig, ...], _preset: Preset) -> None:
    armature = hands[0].armature
    scene = _open_scene()
    layer = bpy.context.view_layer
    layer.objects.active = armature
    armature.select_set(True, view_layer=layer)
    bpy.ops.export_anim.bvh(
        filepath=str(path),
        check_existing=False,
        frame_start=scene.frame_start,
        frame_end=scene.frame_end,
        rotate_mode="NATIVE",
        root_transform_only=True,  # only the wrist moves; fingers have rotations alone
    )


def _blend(path: Path, _hands: tuple[Rig, ...], _preset: Preset) -> None:
    try:
        # Picture paths become relative to the file wherever both lie on one drive.
        bpy.data.libraries.write(
            str(path), {_open_scene()}, path_remap="RELATIVE_ALL", fake_user=False, compress=True
        )
    except OSError as error:  # with words only, as operators' errors have
        raise RuntimeError(str(error)) from error


def _open_scene() -> bpy.types.Scene:
    scene = bpy.context.scene
    assert scene is not None
    return scene


_Y_UP = np.array(axis_conversion(to_forward="-Z", to_up="Y"))
"""Blender's axes to those that its FBX exporter writes by default"""

_FBX_PRESETS = {
    # Y up and -Z forward, as the exporter writes by default; FBX_SCALE_ALL: metres with UnitScaleFactor 100.
    "UNITY": Preset({"axis_forward": "-Z", "axis_up": "Y"}, turn=_Y_UP),
    "UNREAL": Preset(
        {
            "axis_forward": "Y",  # Blender's own axes: what the exporter calls forward, FBX calls back
            "axis_up": "Z",
            "global_scale": 0.01,  # with FBX_SCALE_ALL: the data as it is, UnitScaleFactor 1, a centimetre
            "mesh_smooth_type": "FACE",
        },
        units=100.0,
        root="root",
    ),
}
_GLTF_PRESETS = {
    # glTF itself says: metres, Y up.
    "UNITY": Preset({"export_all_influences": False, "export_influence_nb": 4}),
    "UNREAL": Preset(root="root"),
}

PRESETS = ("PLAIN", "UNITY", "UNREAL")
"""Names of the presets"""

FORMATS = {
    "blend": Format(".blend", "", _blend),
    "glb": Format(".glb", "export_scene.gltf", _gltf, presets=_GLTF_PRESETS),
    "fbx": Format(".fbx", "export_scene.fbx", _fbx, presets=_FBX_PRESETS),
    "usd": Format(".usdc", "wm.usd_export", _usd),
    "bvh": Format(".bvh", "export_anim.bvh", _bvh, per_hand=True),
    "abc": Format(".abc", "wm.alembic_export", _alembic),
}
"""Name on the command line -> format"""
