#!/usr/bin/env python3
"""One picture of a captured hand and of characters' hands that do what it does, a column for each pose.

    python scripts/character_sheets.py Rigify=rigify.blend VRM=vrm.blend:Armature -o sheet.webp --side left

Runs where bpy, SciPy and OpenCV are installed. All hands are shown as long as the captured one, the wrist
neither turned nor moved: first from before the palm, below from 60 degrees nearer to the thumb.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    import bpy

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

import cv2
import numpy as np

from handfit_core.errors import HandfitError, InputError
from handfit_core.files import written_whole
from handfit_core.geometry.rotations import rotmat_to_quat, rotvec_to_rotmat
from handfit_core.hand_model.axes import REST_FROM_MODEL, points_to_rest
from handfit_core.hand_model.nails import nail_polygons
from handfit_core.retarget.transfer import SourceHand, TargetHand, target_hand
from handfit_core.skeleton import SIDES, Side
from scripts.benchmark.closed import CLOSED, closed_pose
from scripts.benchmark.kinematics import RightHand, hand_pose_from_angles, model_of
from scripts.benchmark.poses import random_pose

POSES: Final = {
    "relaxed": ("relaxed", 0),
    "spread": ("open", 4),
    "fist": ("S", 1),
    "thumb up": ("thumb off a fist", 1),
    "point": ("point", 0),
    "pinch": ("pinch", 0),
    "OK": ("F", 0),
    "V": ("V", 0),
    "grip": ("C", 0),
    "thumb tucked": ("thumb in a fist", 0),
}
"""What stands over a column -> the kind of pose of `scripts/benchmark`, and the seed of the one that is drawn"""
_CELL: Final = float(__import__("os").environ.get("CELL","0.24"))
"""metres from one hand to the next"""
_PALM_UP: Final = 0.085
"""metres from the wrist to a cell's middle"""
_REACH: Final = 0.23
"""metres from the wrist within which skin belongs to the hand"""
_FOREARM: Final = 0.06
"""metres of forearm that is shown"""
_TURNED: Final = (0.0, 60.0)
_SKINS: Final = ((0.6, 0.34, 0.26), (0.25, 0.4, 0.6), (0.5, 0.44, 0.2), (0.25, 0.5, 0.34), (0.45, 0.3, 0.55))
_SAMPLES: Final = 24
_QUALITY: Final = 80
"""of WebP, 1 to 100"""


@dataclass(frozen=True, eq=False)
class Skin:
    """What is shown of one hand."""

    vertices: np.ndarray
    """(V, 3) metres in the captured hand's rest space, the wrist at its origin"""
    polygons: list[list[int]]
    nails: np.ndarray
    """(P,) bool per polygon"""


def main(argv: Sequence[str] | None = None) -> int:
    """Write the sheet; returns the exit code."""
    parser = argparse.ArgumentParser(prog="character_sheets.py", description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "characters", nargs="+", metavar="NAME=FILE.blend[:ARMATURE]", help="what stands before a row"
    )
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="SHEET.webp")
    parser.add_argument("--side", choices=SIDES, default="left", help="(default: left)")
    parser.add_argument("--size", type=int, default=150, metavar="PX", help="of a hand (default: 150)")
    parser.add_argument("--poses", nargs="+", choices=list(POSES), default=list(POSES), metavar="POSE")
    parser.add_argument(
        "--thumb-roll", nargs="+", type=float, metavar="DEG", help="a row for each of these instead of the map's"
    )
    args = parser.parse_args(argv)
    if importlib.util.find_spec("bpy") is None:
        print("error: this Python has no bpy: install it", file=sys.stderr)
        return 1
    try:
        picture = sheet(args.characters, args.poses, args.side, args.size, args.thumb_roll)
        with written_whole(args.output) as beside:
            cv2.imwrite(str(beside), picture, [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])
    except HandfitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(f"{args.output}: {args.output.stat().st_size} bytes")
    return 0


def poses(names: Sequence[str], side: Side) -> np.ndarray:
    """(N, 45) axis-angle of the named poses."""
    hand, found = RightHand(np.zeros(10)), []
    for name in names:
        kind, seed = POSES[name]
        drawn = closed_pose if kind in CLOSED else random_pose
        found.append(hand_pose_from_angles(drawn(kind, hand, np.random.default_rng(seed)), side))
    return np.stack(found)


def sheet(
    characters: Sequence[str], names: Sequence[str], side: Side, size: int, rolls: Sequence[float] | None = None
) -> np.ndarray:
    """The whole picture, (H, W, 3) uint8 BGR. Raises InputError and HandModelError."""
    wanted = poses(names, side)
    rows = [("captured", captured(wanted, side))]
    for named in characters:
        name, where = named.split("=", 1)
        path, _, armature = where.partition(".blend")
        for roll in rolls or (None,):
            label = name if roll is None else f"{name} {roll:+.0f}"
            rows.append((label, followed(Path(path + ".blend"), armature.lstrip(":"), wanted, side, roll)))
    picture = rendered([skins for _, skins in rows], side, size)
    for r, (label, _) in enumerate(rows):
        _write(picture, label, (4, 2 * r * size + 14))
    for column, name in enumerate(names):
        _write(picture, name, (column * size + size // 3, 14))
    return picture


def captured(wanted: np.ndarray, side: Side) -> list[Skin]:
    """The open hand in each pose."""
    model = model_of(side)
    vertices = model.posed(None, np.zeros((len(wanted), 3)), wanted, -model.shaped().joints[0]).vertices
    polygons, nails = model.polygons.tolist(), nail_polygons(model)
    return [Skin(points_to_rest(v), polygons, nails) for v in vertices]


def followed(path: Path, named: str, wanted: np.ndarray, side: Side, roll: float | None) -> list[Skin]:
    """A character's hand that does each pose."""
    import bpy

    from blender_manient.rigs.character import bones_of

    if not path.is_file():
        raise InputError(f"{path}: no such .blend")
    bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False)
    there = [o for o in bpy.context.scene.objects if o.type == "ARMATURE" and not o.hide_get()]
    armature = next((o for o in there if o.name == (named or o.name)), None)
    if armature is None:
        raise InputError(f"{path}: no armature {named!r} in it that can be seen")
    sys.path.insert(0, "/work/characters")
    from maps import hand_map
    hand_map = hand_map(armature, side)
    if roll is not None:
        hand_map = replace(hand_map, thumb_roll=roll)
    target = target_hand(bones_of(armature), hand_map, SourceHand.of(model_of(side).shaped(), side))
    fingers = REST_FROM_MODEL @ rotvec_to_rotmat(wanted.reshape(-1, 15, 3)) @ REST_FROM_MODEL.T
    global LAST; LAST = target
    turns = np.concatenate([np.broadcast_to(np.eye(3), (len(wanted), 1, 3, 3)), fingers], axis=1)
    meshes = [o for o in bpy.context.scene.objects if o.type == "MESH" and _moves_with(o, armature)]
    found = []
    for quats in rotmat_to_quat(target.local(turns)):
        for name, quat in zip(target.bones, quats, strict=True):
            armature.pose.bones[name].rotation_mode = "QUATERNION"
            armature.pose.bones[name].rotation_quaternion = quat
        found.append(_skin(meshes, armature, target))
    return found


def _moves_with(obj: bpy.types.Object, armature: bpy.types.Object) -> bool:
    deformed = any(m.type == "ARMATURE" and m.object == armature for m in obj.modifiers)
    return not obj.hide_render and (deformed or (obj.parent == armature and obj.parent_type == "BONE"))


def _skin(meshes: Sequence[bpy.types.Object], armature: bpy.types.Object, target: TargetHand) -> Skin:
    """The evaluated skin near the wrist, laid over the captured hand."""
    import bpy

    bpy.context.view_layer.update()
    depsgraph, vertices, polygons = bpy.context.evaluated_depsgraph_get(), [], []
    nails: list[bool] = []
    for obj in meshes:
        shown = obj.evaluated_get(depsgraph)
        mesh = shown.to_mesh()
        points = np.empty((len(mesh.vertices), 3), dtype=np.float32)
        mesh.vertices.foreach_get("co", points.ravel())
        to_armature = np.array(armature.matrix_world.inverted() @ obj.matrix_world)
        points = points @ to_armature[:3, :3].T + to_armature[:3, 3]
        points = (points - target.wrist) @ target.aligned / target.scale
        fingers = -1.0 if target.hand_map.side == "right" else 1.0
        near = (np.linalg.norm(points, axis=1) < _REACH) & (fingers * points[:, 0] > -_FOREARM)
        first = sum(map(len, vertices))
        shown_polygons = [p for p in mesh.polygons if all(near[v] for v in p.vertices)]
        polygons += [[first + v for v in p.vertices] for p in shown_polygons]
        named = [m is not None and "nail" in m.name.lower() for m in mesh.materials] or [False]
        nails += [named[p.material_index] for p in shown_polygons]
        vertices.append(points)
        shown.to_mesh_clear()
    return Skin(np.concatenate(vertices), polygons, np.array(nails))


def rendered(rows: Sequence[Sequence[Skin]], side: Side, size: int) -> np.ndarray:
    """(H, W, 3) uint8 BGR of hands in cells of `size` pixels, each row from two directions below each other."""
    import bpy

    from blender_manient.blender_versions import use_nodes
    from blender_manient.scene.render_setup import SUNS, sun

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    fingers = np.array([-1.0 if side == "right" else 1.0, 0.0, 0.0])
    palm = np.array([0.0, 0.0, -1.0])
    for r, row in enumerate(rows):
        skin, nail = (bpy.data.materials.new(what) for what in ("skin", "nail"))
        for material, share in ((skin, 1.0), (nail, 0.35)):
            shader = use_nodes(material).nodes["Principled BSDF"]
            color = share * np.array(_SKINS[r % len(_SKINS)]) + (1.0 - share) * np.array([0.9, 0.75, 0.7])
            shader.inputs["Base Color"].default_value = (*color, 1.0)
            shader.inputs["Roughness"].default_value = 0.6
        for v, degrees in enumerate(_TURNED):
            turn = np.radians(degrees)
            towards = np.cos(turn) * palm + np.sin(turn) * np.array([0.0, -1.0, 0.0])
            shown = np.stack([np.cross(fingers, towards), -towards, fingers])  # the camera looks along +Y
            for column, hand in enumerate(row):
                mesh = bpy.data.meshes.new("hand")
                at = np.array([column * _CELL, 0.0, -(2 * r + v) * _CELL - _PALM_UP])
                mesh.from_pydata((hand.vertices @ shown.T + at).tolist(), [], hand.polygons)
                mesh.materials.append(skin)
                mesh.materials.append(nail)
                mesh.polygons.foreach_set("material_index", hand.nails.astype(np.int32))
                mesh.polygons.foreach_set("use_smooth", np.ones(len(mesh.polygons), dtype=bool))
                scene.collection.objects.link(bpy.data.objects.new("hand", mesh))
    for placed in SUNS:
        scene.collection.objects.link(sun("sun", *placed))
    wide, high = len(rows[0]), 2 * len(rows)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.type, camera.data.ortho_scale = "ORTHO", max(wide, high) * _CELL
    camera.location = (0.5 * (wide - 1) * _CELL, -2.0, -0.5 * (high - 1) * _CELL)
    camera.rotation_euler = (np.pi / 2, 0.0, 0.0)
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.world = bpy.data.worlds.new("grey")
    scene.world.color = (0.05, 0.05, 0.05)
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.max_bounces, scene.cycles.use_denoising = _SAMPLES, 2, False
    scene.view_settings.view_transform = "Standard"
    scene.render.resolution_x, scene.render.resolution_y = wide * size, high * size
    scene.render.image_settings.file_format = "PNG"
    with tempfile.TemporaryDirectory() as folder:
        scene.render.filepath = f"{folder}/sheet.png"
        bpy.ops.render.render(write_still=True)
        return cv2.imread(scene.render.filepath)


def _write(picture: np.ndarray, text: str, place: tuple[int, int]) -> None:
    cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.42, (235, 235, 235), 1, cv2.LINE_AA)


if __name__ == "__main__":
    sys.exit(main())
