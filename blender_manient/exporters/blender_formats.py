"""The formats that Blender's own operators write, with the arguments that each of these gets."""

from __future__ import annotations

import contextlib
import json
import mmap
import os
import re
import struct
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, BinaryIO, ClassVar

import bpy
import numpy as np
from bpy_extras.io_utils import axis_conversion

from handfit_core.common.errors import OptionError
from handfit_core.common.files import check_room

from ..common.blender_versions import gltf_left_out, usd_stage, with_textures
from ..rigs.arm import has_arm
from ..scene.own_scene import with_values
from ..scene.timing import nearest_rate
from .exporter import APART, Exporter, HandObjects, Preset, blank


class BlenderFormat:
    """The part of an exporter that calls `operator`, a Blender operator, to write the file."""

    operator: ClassVar[str]
    arguments: ClassVar[Mapping[str, Any]] = {}
    reading: ClassVar[Mapping[str, Mapping[str, Any]]] = {}
    """Arguments of Blender's importers of such files, by the operator"""

    def write(self, path: Path, hands: Sequence[HandObjects], preset: Preset, _final: Path, /) -> None:
        """Write the file with the arguments of the format and of the preset."""
        with self.around(path, hands) as more:
            arguments = {**self.arguments, **preset.keywords, **more}
            _operator(self.operator)(filepath=str(path), check_existing=False, **arguments)

    def read(self, path: Path, operator: str, /) -> set[str]:
        """Import a file into the open scene."""
        return _operator(operator)(filepath=str(path), **self.reading.get(operator, {}))

    @contextlib.contextmanager
    def around(self, _path: Path, _hands: Sequence[HandObjects], /) -> Iterator[dict[str, Any]]:
        """Prepare the context's scene and clean up behind the operator; yields the arguments that the scene
        decides."""
        yield {}


def _operator(name: str) -> Any:
    module, _, operator = name.partition(".")
    return getattr(getattr(bpy.ops, module), operator)


_NODE = b"\0\x01Model"
"""The bytes that stand behind the name of each of an FBX file's nodes that are models"""
_SMALL = 0.1
"""The scale of an armature below which its file was in centimetres"""


class FbxExporter(BlenderFormat, Exporter):
    """Autodesk FBX. Names no folder."""

    name = "fbx"
    label = "FBX"
    description = "Autodesk FBX"
    suffix = ".fbx"
    operator = "export_scene.fbx"
    arguments: ClassVar = {
        "object_types": {"ARMATURE", "MESH"},
        "use_custom_props": True,
        "add_leaf_bones": False,
        "use_armature_deform_only": False,
        # Metres arrive as metres, without a scale of 100 on the rig.
        "apply_scale_options": "FBX_SCALE_ALL",
        "bake_anim": True,
        "bake_anim_use_all_bones": True,
        "bake_anim_use_nla_strips": False,
        "bake_anim_use_all_actions": False,
        "bake_anim_force_startend_keying": True,
        "bake_anim_step": 1.0,
        "bake_anim_simplify_factor": 0.0,
        "path_mode": "STRIP",  # textures by name: where they lie is private
    }
    apart = APART
    reads: ClassVar = {".fbx": ("import_scene.fbx", "wm.fbx_import")}
    # Frames as they are written.
    reading: ClassVar = {name: {"anim_offset": 0.0} for name in ("import_scene.fbx", "wm.fbx_import")}
    of_scene: ClassVar = {
        "object_types": {"ARMATURE", "MESH", "EMPTY", "CAMERA", "LIGHT", "OTHER"},
        "path_mode": "COPY",
        "embed_textures": True,
    }
    presets: ClassVar = {
        # Y up and -Z forward, as the exporter writes by default; FBX_SCALE_ALL: metres with UnitScaleFactor
        # 100.
        "UNITY": Preset(
            {"axis_forward": "-Z", "axis_up": "Y"}, turn=np.array(axis_conversion(to_forward="-Z", to_up="Y"))
        ),
        "UNREAL": Preset(
            {
                "axis_forward": "Y",  # Blender's own axes: what the exporter calls forward, FBX calls back
                "axis_up": "Z",
                "global_scale": 0.01,  # with FBX_SCALE_ALL: UnitScaleFactor 1, a centimetre
                "mesh_smooth_type": "FACE",
            },
            units=100.0,
            root="root",
        ),
    }

    def missing(self, path: Path, bones: Sequence[str], /) -> str:
        """Return what is missing of the bones' motion, by the names and curves, which stand in the file as
        they are."""
        with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
            named, at = {bone.encode() for bone in bones}, content.find(_NODE)
            sizes, there = {len(name) for name in named}, set[bytes]()
            while at >= 0:  # once over the file, however many bones there are
                there |= {content[max(at - size, 0) : at] for size in sizes}
                at = content.find(_NODE, at + 1)
            gone = [bone for bone in bones if bone.encode() not in there]
            return _missing(gone, moves=content.find(b"AnimCurve") >= 0)

    @contextlib.contextmanager
    def around(self, path: Path, hands: Sequence[HandObjects], /) -> Iterator[dict[str, Any]]:
        """Turn what was imported from centimetres into centimetres again. The exporter also names each
        texture with the folder that the file is in."""
        small = all(hand.armature.matrix_world.median_scale < _SMALL for hand in hands)
        yield {"apply_scale_options": "FBX_SCALE_NONE"} if small else {}
        blank(path, Path(os.path.abspath(path.parent)))  # noqa: PTH100  Links stay as they are.
        blank(path, Path(f"{path.stem}.fbm"))  # which it makes up for embedded textures


class GltfExporter(BlenderFormat, Exporter):
    """glTF 2.0, binary, with one clip of all hands: metres and Y up, as glTF itself says."""

    name = "glb"
    label = "glTF"
    description = "glTF 2.0 binary"
    suffix = ".glb"
    operator = "export_scene.gltf"
    arguments: ClassVar = {
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
    reads: ClassVar = {
        ".glb": ("import_scene.gltf",),
        ".gltf": ("import_scene.gltf",),
        ".vrm": ("import_scene.vrm", "import_scene.gltf"),  # the first is an add-on's of its own
    }
    # Bones keep their axes.
    reading: ClassVar = {"import_scene.gltf": {"bone_heuristic": "BLENDER", "disable_bone_shape": True}}
    of_scene: ClassVar = {"use_selection": False, "export_cameras": True, "export_lights": True}
    presets: ClassVar = {
        "UNITY": Preset({"export_all_influences": False, "export_influence_nb": 4}),
        "UNREAL": Preset(root="root"),
    }

    @contextlib.contextmanager
    def around(self, _path: Path, hands: Sequence[HandObjects], /) -> Iterator[dict[str, Any]]:
        """Select what is written, mend the rate, keep the artist's window from showing the scene, and the
        add-on's notes on objects out of the extras, which up to Blender 4.5 have what is registered."""
        # The exporter takes all children of what is in the scene, wherever they are, but for unselected ones.
        for obj in (o for hand in hands for o in (hand.armature, *hand.meshes)):
            obj.select_set(True, view_layer=bpy.context.view_layer)
        context, left_out = bpy.context, gltf_left_out()
        left_out.append("manient")
        bpy.context = _WindowlessContext(context)  # type: ignore
        try:
            with _rate_turned(context.scene):
                yield {}
        finally:
            bpy.context = context
            left_out.remove("manient")

    def missing(self, path: Path, bones: Sequence[str], /) -> str:
        """Return what is missing of the bones' motion, by the file's first chunk, which lists all nodes and
        animations."""
        with path.open("rb") as stream:
            (size,) = struct.unpack("<12xI4x", stream.read(20))
            content = json.loads(stream.read(size))
        there = {node.get("name") for node in content.get("nodes", ()) if "skins" in content}
        return _missing([bone for bone in bones if bone not in there], moves="animations" in content)

    def read(self, path: Path, operator: str, /) -> set[str]:
        """Import a file, which has no frames, at the open scene's rate."""
        with _rate_turned(bpy.context.scene):
            return super().read(path, operator)


def _missing(bones: Sequence[str], *, moves: bool) -> str:
    """Return what `Exporter.missing` says where these bones, or all motion, are not there."""
    return f"the bone {bones[0]!r} and {len(bones) - 1} others" if bones else "" if moves else "any motion"


def _rate_turned(scene: bpy.types.Scene) -> contextlib.AbstractContextManager[None]:
    """Invert the scene's `fps_base` within, since Blender's glTF importer and exporter (4.2 to 5.2) multiply
    by what they should divide by."""
    return with_values([(scene.render, "fps_base", 1.0 / scene.render.fps_base)])


class _WindowlessContext:
    """Blender's context, with a window that nobody sees."""

    def __init__(self, context: bpy.types.Context) -> None:
        self._context = context
        self.window = SimpleNamespace()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._context, name)


class UsdExporter(BlenderFormat, Exporter):
    """Universal Scene Description, as Blender renders it."""

    name = "usd"
    label = "USD"
    description = "Universal Scene Description"
    suffix = ".usdc"
    other_endings = (".usd",)
    operator = "wm.usd_export"
    reads: ClassVar = dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), ("wm.usd_import",))
    of_scene: ClassVar = with_textures()
    arguments: ClassVar = {
        "export_animation": True,
        "export_armatures": True,
        "export_shapekeys": True,
        "export_uvmaps": True,
        "export_custom_properties": False,  # USD has no type for the ten betas
        "evaluation_mode": "RENDER",
    }

    def read(self, path: Path, operator: str, /) -> set[str]:
        """Import a file into the open scene, which gets its rate: Blender's importer leaves that alone."""
        done, render = super().read(path, operator), bpy.context.scene.render
        if "FINISHED" in done and (stage := usd_stage(str(path))) and (rate := stage.GetTimeCodesPerSecond()):
            render.fps, render.fps_base = nearest_rate(rate)
        return done

    def missing(self, path: Path, bones: Sequence[str], /) -> str:
        """Return what is missing of the bones' motion, by the skeletons' names of joints, with an underscore
        for all that is no letter or digit."""
        if (stage := usd_stage(str(path))) is None:
            return ""
        # A single frame has no samples over time.
        there = set[str]()
        moves = stage.HasAuthoredTimeCodeRange() and stage.GetStartTimeCode() == stage.GetEndTimeCode()
        for prim in stage.Traverse():
            if prim.GetTypeName() == "Skeleton":
                there |= {joint.rpartition("/")[2] for joint in prim.GetAttribute("joints").Get()}
            elif prim.GetTypeName() == "SkelAnimation":
                moves = moves or prim.GetAttribute("rotations").GetNumTimeSamples() > 0
        named = [bone for bone in bones if bone.isascii() and not bone[0].isdigit()]
        return _missing([bone for bone in named if re.sub(r"\W", "_", bone) not in there], moves=moves)

    def is_whole(self, stream: BinaryIO, size: int, /) -> bool:
        """True if the table of the sections, which ends the file, is where the header, written last, says."""
        magic, contents = struct.unpack("<8s8xq", stream.read(24))
        if magic != b"PXR-USDC" or not 24 <= contents < size:
            return False
        stream.seek(contents)
        (count,) = struct.unpack("<Q", stream.read(8))
        if count == 0 or contents + 8 + 32 * count != size:
            return False
        starts, lengths = np.frombuffer(stream.read(), dtype="<i8").reshape(count, 4)[:, 2:].T
        return bool(starts[0] >= 24 and (starts + lengths == [*starts[1:], contents]).all())


class BvhExporter(BlenderFormat, Exporter):
    """Biovision motion capture: a skeleton per file."""

    name = "bvh"
    label = "BVH"
    description = "Biovision motion capture, a file per hand"
    suffix = ".bvh"
    operator = "export_anim.bvh"
    per_hand = True
    arguments: ClassVar = {"rotate_mode": "NATIVE"}

    @contextlib.contextmanager
    def around(self, _path: Path, hands: Sequence[HandObjects], /) -> Iterator[dict[str, Any]]:
        """Have only a hand's wrist move, unless it hangs on an arm; fingers have rotations alone."""
        scene, is_hand = bpy.context.scene, hands[0].side is not None and not has_arm(hands[0].armature)
        yield {
            "frame_start": scene.frame_start,
            "frame_end": scene.frame_end,
            "root_transform_only": is_hand,
        }


class AlembicExporter(BlenderFormat, Exporter):
    """Alembic: the baked mesh, where there is room for it."""

    name = "abc"
    label = "Alembic"
    description = "Baked mesh cache"
    suffix = ".abc"
    bakes = False
    operator = "wm.alembic_export"
    arguments: ClassVar = {"as_background_job": False, "uvs": True, "evaluation_mode": "RENDER"}

    @contextlib.contextmanager
    def around(self, path: Path, hands: Sequence[HandObjects], /) -> Iterator[dict[str, Any]]:
        """Check that the disk has room, since Alembic ends Blender where it is full, and have its description
        not name the open file."""
        meshes = [mesh for hand in hands for mesh in hand.meshes]
        if not meshes:
            raise OptionError("Alembic needs a mesh to hold, and there is none: choose another format")
        check_room(path, _alembic_size(meshes))
        yield {"start": bpy.context.scene.frame_start, "end": bpy.context.scene.frame_end}
        blank(path, Path(bpy.data.filepath).parent)

    def is_whole(self, stream: BinaryIO, size: int, /) -> bool:
        """True if Ogawa's second field says that the file was finished, and the root, which it points to,
        ends it."""
        magic, finished, root = struct.unpack("<5sB2xQ", stream.read(16))
        if magic != b"Ogawa" or finished != 0xFF or not 16 <= root < size:
            return False
        stream.seek(root)
        (children,) = struct.unpack("<Q", stream.read(8))
        return root + 8 * (1 + children) == size


def _alembic_size(meshes: Sequence[bpy.types.Object]) -> int:
    """Return how many bytes the context's scene with these meshes takes as Alembic at most, rather too
    many."""
    frames = bpy.context.scene.frame_end - bpy.context.scene.frame_start + 1
    graph, size = bpy.context.evaluated_depsgraph_get(), 1 << 16
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
