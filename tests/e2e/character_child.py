"""A character's file made, and results looked at, in processes of their own.

character_child.py make CHARACTER.blend
character_child.py look RESULT FPS FRAME...
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import bpy
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from handfit_core.geometry.rotations import rotvec_to_rotmat  # noqa: E402
from handfit_core.skeleton import FINGER_JOINTS, SIDES, Side  # noqa: E402
from tests.blender.characters import BoneSpec, build_armature, hand_specs  # noqa: E402

_FINGERS = {"thumb": "Thumb", "index": "Index", "middle": "Middle", "ring": "Ring", "little": "Pinky"}


def bone_names(side: Side) -> dict[int, str]:
    """The bone of each of MANO's joints, as Mixamo calls it."""
    hand = f"mixamorig:{side.capitalize()}Hand"
    joints = {j: (finger, i) for finger in _FINGERS for i, j in enumerate(FINGER_JOINTS[finger], start=1)}
    return {0: hand} | {j: f"{hand}{_FINGERS[finger]}{i}" for j, (finger, i) in sorted(joints.items())}


def make(path: str) -> None:
    """A character with two bent hands, in centimetres, that hangs on an empty and nods; with a skin, an eye
    on a bone, a cage that no render shows, and a prop that is none of its own."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    rng = np.random.default_rng(11)
    specs = [BoneSpec("mixamorig:Hips", "", (0, 0, 100), (0, 0, 110))]
    for side in SIDES:
        turn = rotvec_to_rotmat(rng.normal(size=3))
        x = 60.0 if side == "left" else -60.0
        arm = f"mixamorig:{side.capitalize()}ForeArm"
        specs.append(BoneSpec(arm, "mixamorig:Hips", (x / 2, 0, 140), (x, 0, 140)))
        specs += hand_specs(
            side,
            rng,
            bend=0.5,
            stretch=0.2,
            names=bone_names(side),
            parent=arm,
            place=np.array([x, 0.0, 140.0]),
            turn=turn,
            scale=100.0,
        )
    armature = build_armature(specs, "Hero")
    armature.scale = (0.01, 0.01, 0.01)
    skin = _tetrahedra("Skin", armature, [bone.name for bone in armature.data.bones])
    cage = _tetrahedra("Cage", armature, ["mixamorig:Hips"])
    cage.hide_render = True
    eye = bpy.data.objects.new("Eye", skin.data.copy())
    eye.parent, eye.parent_type, eye.parent_bone = armature, "BONE", "mixamorig:Hips"
    prop = bpy.data.objects.new("Prop", skin.data.copy())
    place = bpy.data.objects.new("Place", None)
    place.location = (0.3, 0.2, 0.1)
    armature.parent = place
    eye.data.name, prop.data.name = "Eye", "Prop"
    for obj in (eye, prop, place):
        bpy.context.collection.objects.link(obj)
    hips = armature.pose.bones["mixamorig:Hips"]
    hips.rotation_mode = "XYZ"
    for frame, angle in ((1, 0.0), (10, 0.5)):
        hips.rotation_euler.x = angle
        hips.keyframe_insert("rotation_euler", frame=frame)
    bpy.data.texts.new("kept.txt").use_fake_user = True
    bpy.ops.wm.save_as_mainfile(filepath=path)


def _tetrahedra(name: str, armature: bpy.types.Object, bones: list[str]) -> bpy.types.Object:
    """A mesh that an armature deforms: a tetrahedron at each of these bones."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    points = np.concatenate([np.array(armature.data.bones[bone].head_local) + corners for bone in bones])
    faces = [(4 * b + i, 4 * b + j, 4 * b + k) for b in range(len(bones)) for i, j, k in
             ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))]  # fmt: skip
    data = bpy.data.meshes.new(name)
    data.from_pydata(points.tolist(), [], faces)
    mesh = bpy.data.objects.new(name, data)
    for number, bone in enumerate(bones):
        mesh.vertex_groups.new(name=bone).add(range(4 * number, 4 * number + 4), 1.0, "REPLACE")
    mesh.modifiers.new("Armature", "ARMATURE").object = armature
    mesh.parent = armature
    bpy.context.collection.objects.link(mesh)
    return mesh


def look(path: str, fps: str, *frames: str) -> None:
    """Print where bones begin and the skin's points are, in metres of the world, and what else is there."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps = int(fps)  # glTF holds seconds
    ending = Path(path).suffix
    if ending == ".blend":
        bpy.ops.wm.open_mainfile(filepath=path)
    elif ending == ".fbx":
        bpy.ops.import_scene.fbx(filepath=path, anim_offset=0.0)
    elif ending == ".glb":
        bpy.ops.import_scene.gltf(filepath=path)
    elif ending == ".bvh":
        bpy.ops.import_anim.bvh(filepath=path, axis_forward="Y", axis_up="Z", frame_start=int(frames[0]))
    elif ending == ".abc":
        bpy.ops.wm.alembic_import(filepath=path)
    else:
        bpy.ops.wm.usd_import(filepath=path)
    scene = bpy.context.scene
    armature = next((o for o in scene.objects if o.type == "ARMATURE"), None)
    skin = next((o for o in scene.objects if o.type == "MESH" and o.name.startswith("Skin")), None)
    shown = {}
    for frame in map(int, frames):
        scene.frame_set(frame)
        graph = bpy.context.evaluated_depsgraph_get()
        heads, points = {}, []
        if armature is not None:
            posed = armature.evaluated_get(graph)
            heads = {bone.name: list(posed.matrix_world @ bone.head) for bone in posed.pose.bones}
        if skin is not None:
            deformed = skin.evaluated_get(graph)
            points = [list(deformed.matrix_world @ v.co) for v in deformed.to_mesh().vertices]
        shown[frame] = {"heads": heads, "points": points}
    data = armature.animation_data if armature is not None else None
    found = {
        "range": [scene.frame_start, scene.frame_end, scene.render.fps / scene.render.fps_base],
        "objects": sorted(o.name for o in scene.objects),
        "texts": [text.name for text in bpy.data.texts],
        "armatures": len(bpy.data.armatures),
        "tracks": [track.name for track in data.nla_tracks] if data is not None else [],
        "shown": shown,
    }
    print("FOUND", json.dumps(found))


if __name__ == "__main__":
    given = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    {"make": make, "look": look}[given[0]](*given[1:])
