"""Writing a built take to files of other programs: only its armatures and meshes, over its frames."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import bpy

from handfit_core.errors import OptionError, OutputError
from handfit_core.files import written_whole
from handfit_core.take import Take

from .build import BuiltHand, BuiltTake, set_timing
from .camera import frame_scene
from .own_scene import own_scene


@dataclass(frozen=True)
class Format:
    """One file format that a take can be written in."""

    suffix: str
    operator: str
    """The Blender operator that it needs, as module.name; empty for none"""
    write: Callable[[Path, tuple[BuiltHand, ...]], None]
    """Called with a scene open that holds nothing but the take, at its frame range and rate"""
    per_hand: bool = False
    """Whether each hand needs a file of its own"""


def export_take(built: BuiltTake, take: Take, folder: Path, name: str, fmt: str) -> list[Path]:
    """Write one format into `folder` and return the files written, each whole or not at all.

    The files are `name.<suffix>`; formats that hold one skeleton (BVH) get one file per hand, with
    `_left` and `_right` where there are two (`_left` and `_left2` for two left hands). Frame numbers
    are kept. The rest of the open Blender file is neither written nor changed. Raises OptionError and
    OutputError.
    """
    chosen = find_format(fmt)
    if not available(chosen):
        raise OptionError(
            f"this Blender cannot write {fmt}: it has no {chosen.operator}; choose from "
            f"{', '.join(k for k, f in FORMATS.items() if available(f))}"
        )
    if not chosen.per_hand:
        return [_write_one(chosen, built, take, folder / (name + chosen.suffix))]
    files = []
    for hand in built.hands:
        side = f"_{hand.side}" if len(built.hands) > 1 else ""
        path = folder / f"{name}{side}{chosen.suffix}"
        for number in range(2, len(built.hands) + 1):
            if path in files:
                path = folder / f"{name}{side}{number}{chosen.suffix}"
        only = BuiltTake(built.collection, built.camera, (hand,), built.warnings)
        files.append(_write_one(chosen, only, take, path))
    return files


def find_format(fmt: str) -> Format:
    """The format of that name (case and a leading dot do not matter). Raises OptionError."""
    chosen = FORMATS.get(fmt.lower().lstrip("."))
    if chosen is None:
        raise OptionError(f"there is no export format {fmt!r}; choose from {', '.join(FORMATS)}")
    return chosen


def available(fmt: Format) -> bool:
    """Whether this Blender can write the format (some builds lack USD and Alembic)."""
    if not fmt.operator:
        return True
    module, operator = fmt.operator.split(".")
    return operator in dir(getattr(bpy.ops, module))


def _write_one(fmt: Format, built: BuiltTake, take: Take, path: Path) -> Path:
    with written_whole(path) as beside:
        try:
            with _only(built, take, whole=fmt.suffix == ".blend"):
                fmt.write(beside, built.hands)
        except RuntimeError as error:
            reason = " ".join(str(error).split())
            raise OutputError(f"{path}: Blender could not write it ({reason})") from error
        if beside.stat().st_size == 0:
            raise OutputError(f"{path}: Blender wrote nothing; see its console for the reason")
    return path


@contextlib.contextmanager
def _only(built: BuiltTake, take: Take, *, whole: bool) -> Iterator[bpy.types.Scene]:
    """Open a scene of its own with nothing but the take: its objects, frame range and frame rate.

    Exporters write what the open scene holds, at its frame rate and over its range. `whole` links
    the collection with the camera instead of only armatures and meshes.
    """
    with own_scene(built.collection.name) as scene:
        set_timing(scene, take)
        frame_scene(scene, take)
        if whole:
            scene.collection.children.link(built.collection)
            scene.camera = built.camera
        else:
            for hand in built.hands:
                scene.collection.objects.link(hand.armature)
                scene.collection.objects.link(hand.mesh)
        scene.frame_set(scene.frame_start)
        yield scene


def _gltf(path: Path, _hands: tuple[BuiltHand, ...]) -> None:
    # The exporter (4.2 to 5.2) multiplies by fps_base where it should divide; a test reads the times.
    render = _open_scene().render
    render.fps_base = 1.0 / render.fps_base
    bpy.ops.export_scene.gltf(
        filepath=str(path),
        check_existing=False,
        export_format="GLB",
        use_active_scene=True,
        export_cameras=False,
        export_lights=False,
        export_extras=True,
        export_apply=False,  # applying modifiers would drop the shape keys
        export_all_influences=True,  # the default keeps four per vertex, which is another skin
        export_animations=True,
        # One clip with both hands; the other modes add every action in the file that would fit.
        export_animation_mode="SCENE",
        export_anim_scene_split_object=False,
        export_frame_range=True,
        export_force_sampling=True,
        export_optimize_animation_size=False,
        export_morph_normal=False,
    )


def _fbx(path: Path, _hands: tuple[BuiltHand, ...]) -> None:
    bpy.ops.export_scene.fbx(
        filepath=str(path),
        check_existing=False,
        object_types={"ARMATURE", "MESH"},
        use_custom_props=True,
        add_leaf_bones=False,
        use_armature_deform_only=False,
        apply_scale_options="FBX_SCALE_ALL",  # metres arrive as metres, without a scale of 100 on the rig
        bake_anim=True,
        bake_anim_use_all_bones=True,
        bake_anim_use_nla_strips=False,
        bake_anim_use_all_actions=False,
        bake_anim_force_startend_keying=True,
        bake_anim_step=1.0,
        bake_anim_simplify_factor=0.0,
    )


def _usd(path: Path, _hands: tuple[BuiltHand, ...]) -> None:
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


def _alembic(path: Path, _hands: tuple[BuiltHand, ...]) -> None:
    scene = _open_scene()
    bpy.ops.wm.alembic_export(
        filepath=str(path),
        check_existing=False,
        start=scene.frame_start,
        end=scene.frame_end,
        as_background_job=False,
        uvs=True,
        evaluation_mode="RENDER",
    )


def _bvh(path: Path, hands: tuple[BuiltHand, ...]) -> None:
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


def _blend(path: Path, _hands: tuple[BuiltHand, ...]) -> None:
    # Picture paths become relative to the file wherever both lie on one drive.
    bpy.data.libraries.write(
        str(path), {_open_scene()}, path_remap="RELATIVE_ALL", fake_user=False, compress=True
    )


def _open_scene() -> bpy.types.Scene:
    scene = bpy.context.scene
    assert scene is not None
    return scene


FORMATS = {
    "blend": Format(".blend", "", _blend),
    "glb": Format(".glb", "export_scene.gltf", _gltf),
    "fbx": Format(".fbx", "export_scene.fbx", _fbx),
    "usd": Format(".usdc", "wm.usd_export", _usd),
    "bvh": Format(".bvh", "export_anim.bvh", _bvh, per_hand=True),
    "abc": Format(".abc", "wm.alembic_export", _alembic),
}
"""Name on the command line -> format"""
