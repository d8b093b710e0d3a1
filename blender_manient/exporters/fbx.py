"""Autodesk FBX."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import bpy
import numpy as np
from bpy_extras.io_utils import axis_conversion

from .exporter import Exporter, HandObjects, Preset, blank

_Y_UP = np.array(axis_conversion(to_forward="-Z", to_up="Y"))
"""Blender's axes to those that its FBX exporter writes by default"""

_PRESETS = {
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


class FbxExporter(Exporter):
    """Autodesk FBX."""

    name = "fbx"
    label = "FBX"
    description = "Autodesk FBX"
    suffix = ".fbx"
    operator = "export_scene.fbx"
    presets = _PRESETS

    def write(self, path: Path, _hands: Sequence[HandObjects], preset: Preset, _final: Path, /) -> None:
        """Write it, and name no folder."""
        keywords = {
            "filepath": str(path),
            "check_existing": False,
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
        bpy.ops.export_scene.fbx(**keywords | preset.keywords)
        # The exporter also names each texture with the folder that the file is in.
        blank(path, Path(os.path.abspath(path.parent)))  # noqa: PTH100  Links stay as they are.
