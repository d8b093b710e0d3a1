"""glTF 2.0, binary."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy

from ..blender_versions import gltf_left_out
from .exporter import Exporter, HandObjects, Preset

_PRESETS = {
    # glTF itself says: metres, Y up.
    "UNITY": Preset({"export_all_influences": False, "export_influence_nb": 4}),
    "UNREAL": Preset(root="root"),
}


class GltfExporter(Exporter):
    """glTF 2.0, binary."""

    name = "glb"
    label = "glTF"
    description = "glTF 2.0 binary"
    suffix = ".glb"
    operator = "export_scene.gltf"
    presets = _PRESETS

    def write(self, path: Path, hands: Sequence[HandObjects], preset: Preset, _final: Path, /) -> None:
        """Write one clip with all hands."""
        # The exporter takes all children of what is in the scene, wherever they are, but for unselected ones.
        for obj in (o for hand in hands for o in (hand.armature, *hand.meshes)):
            obj.select_set(True, view_layer=bpy.context.view_layer)
        # The exporter (4.2 to 5.2) multiplies by fps_base where it should divide; a test reads the times.
        render = bpy.context.scene.render
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
        with _left_out_and_alone():
            bpy.ops.export_scene.gltf(**keywords | preset.keywords)


class _WindowlessContext:
    """Blender's context, with a window that nobody sees."""

    def __init__(self, context: bpy.types.Context) -> None:
        self._context = context
        self.window = SimpleNamespace()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._context, name)


@contextlib.contextmanager
def _left_out_and_alone() -> Iterator[None]:
    """Keep what the add-on itself notes on objects out of glTF's extras, which up to Blender 4.5 take all
    that add-ons register for custom properties; and the exporter from opening the scene that it writes in the
    artist's window."""
    left_out, context = gltf_left_out(), bpy.context
    left_out.append("manient")
    bpy.context = _WindowlessContext(context)  # type: ignore
    try:
        yield
    finally:
        bpy.context = context
        left_out.remove("manient")
