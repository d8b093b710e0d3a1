#!/usr/bin/env python3
"""One picture of a captured hand and of characters' hands that do what it does, a column for each pose.

    python scripts/character_sheets.py Rigify=rigify.blend VRM=vrm.blend:Armature -o sheet.webp --side left

Runs where bpy and OpenCV are installed. All hands are shown as long as the captured one, the wrist
neither turned nor moved: first from before the palm, below from 60 degrees nearer to the thumb.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import tempfile
from collections.abc import Mapping, Sequence
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
from handfit_core.hand_model import load_model
from handfit_core.hand_model.axes import points_to_rest
from handfit_core.hand_model.nails import nail_polygons
from handfit_core.hand_model.poses import Pose, ready_poses
from handfit_core.retarget.contacts import Fingertips
from handfit_core.retarget.transfer import SourceHand, TargetHand, target_hand
from handfit_core.skeleton import NUM_BETAS, SIDES, Side
from handfit_core.slices import run_to_completion

POSES: Final = (
    "Relaxed",
    "Spread",
    "Fist",
    "Thumbs Up",
    "Point",
    "Pinch",
    "Letter F",
    "Letter V",
    "Ball Grip",
    "Letter T",
)
"""The ready poses that are shown"""
_CELL: Final = (0.19, 0.245)
"""metres, width and height of what is shown of one hand"""
_MIDDLE: Final = 0.085
"""metres from the wrist to a cell's middle"""
_REACH: Final = 0.23
"""metres from the wrist within which skin belongs to the hand"""
_FOREARM: Final = 0.05
"""metres of forearm that are shown"""
_VIEWS: Final = (0.0, 60.0)
"""degrees from before the palm towards the thumb"""
_COLORS: Final = ((0.6, 0.34, 0.26), (0.25, 0.4, 0.6), (0.5, 0.44, 0.2), (0.25, 0.5, 0.34), (0.45, 0.3, 0.55))
"""of the rows, so that they are told apart"""
_NAIL: Final = np.array([0.9, 0.75, 0.7])
_BACKGROUND: Final = 0.05
_MARGIN: Final = (20, 76)
"""pixels above and to the left of the hands, for what is written there"""
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
    parser.add_argument("--height", type=int, default=150, metavar="PX", help="of a hand (default: 150)")
    parser.add_argument(
        "--poses", nargs="+", choices=list(ready_poses()), default=list(POSES), metavar="POSE"
    )
    parser.add_argument(
        "--thumb-roll", nargs="+", type=float, metavar="DEG", help="a row for each of these, to choose one"
    )
    parser.add_argument("--no-contacts", action="store_true", help="fingertips need not meet")
    args = parser.parse_args(argv)
    if importlib.util.find_spec("bpy") is None:
        print("error: this Python has no bpy: install it", file=sys.stderr)
        return 1
    try:
        wanted = [ready_poses()[name].pose for name in args.poses]
        rows = {"captured": captured(wanted, args.side)}
        for named in args.characters:
            name, where = named.split("=", 1)
            for roll in args.thumb_roll or (None,):
                followed = following(where, wanted, args.side, roll, not args.no_contacts)
                rows[name if roll is None else f"{name} {roll:+.0f}"] = followed
        picture = sheet(rows, args.poses, args.side, args.height)
        with written_whole(args.output) as beside:
            cv2.imwrite(str(beside), picture, [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])
    except HandfitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(f"{args.output}: {args.output.stat().st_size} bytes")
    return 0


def captured(wanted: Sequence[Pose], side: Side) -> list[Skin]:
    """The open hand in each pose."""
    model = load_model(None, side)
    at = -model.shaped().joints[0]
    vertices = [model.posed(None, np.zeros(3), pose.on(side), at).vertices for pose in wanted]
    return [Skin(points_to_rest(v), model.polygons.tolist(), nail_polygons(model)) for v in vertices]


def following(
    where: str, wanted: Sequence[Pose], side: Side, roll: float | None = None, contacts: bool = True
) -> list[Skin]:
    """A character's hand after each pose was applied to it, as large as the captured one. `where`: its
    .blend, and behind a colon its armature, if there are several; `roll`: its thumb's in degrees, instead of
    what its rig usually needs. Raises InputError, HandModelError and OptionError."""
    import bpy

    from blender_manient.rigs import found_hand
    from blender_manient.rigs.character import bones_of
    from blender_manient.scene.onto_character import Motion, TransferOptions, applying

    path, _, named = where.partition(".blend")
    path = Path(f"{path}.blend")
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False)
    there = [o for o in bpy.context.scene.objects if o.type == "ARMATURE" and not o.hide_get()]
    armature = next((o for o in there if o.name == (named[1:] or o.name)), None)
    if armature is None:
        raise InputError(f"{path}: no armature {named[1:]!r} in it that can be seen")
    hand_map = found_hand(armature, side).hand_map
    if roll is not None:
        hand_map = replace(hand_map, thumb_roll=roll)
    model = load_model(None, side)
    source, skins = SourceHand.of(model.shaped(), side), Fingertips.of(model, np.zeros(NUM_BETAS))
    target = target_hand(bones_of(armature), hand_map, source)
    meshes = [o for o in bpy.context.scene.objects if o.type == "MESH" and _moves_with(o, armature)]
    found = []
    for pose in wanted:  # each for itself: from one to the next nothing is smooth
        motion = Motion(source, np.ones(1), pose.turns(side)[None], np.zeros((1, 3)), skins)
        run_to_completion(
            applying(armature, [(hand_map, motion)], TransferOptions(into="ACTION", contacts=contacts))
        )
        bpy.context.scene.frame_set(1)
        found.append(_skin(meshes, armature, target))
    return found


def _moves_with(obj: bpy.types.Object, armature: bpy.types.Object) -> bool:
    deformed = any(m.type == "ARMATURE" and m.object == armature for m in obj.modifiers)
    return not obj.hide_render and (deformed or (obj.parent == armature and obj.parent_type == "BONE"))


def _skin(meshes: Sequence[bpy.types.Object], armature: bpy.types.Object, target: TargetHand) -> Skin:
    """The evaluated skin near the wrist, laid over the captured hand."""
    import bpy

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


def sheet(rows: Mapping[str, Sequence[Skin]], names: Sequence[str], side: Side, height: int) -> np.ndarray:
    """(H, W, 3) uint8 BGR: a column per name and two rows of hands per row, one from each of `_VIEWS`."""
    import bpy

    from blender_manient.scene.render_setup import SUNS, sun

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    fingers = np.array([-1.0 if side == "right" else 1.0, 0.0, 0.0])
    for r, row in enumerate(rows.values()):
        color = np.array(_COLORS[r % len(_COLORS)])
        materials = [_material(color), _material(0.35 * color + 0.65 * _NAIL)]
        for v, turn in enumerate(np.radians(_VIEWS)):
            towards = np.array([0.0, -np.sin(turn), -np.cos(turn)])  # the palm faces -Z, the thumb is at -Y
            shown = np.stack([np.cross(fingers, towards), -towards, fingers])  # the camera looks along +Y
            for column, hand in enumerate(row):
                at = np.array([column * _CELL[0], 0.0, -(len(_VIEWS) * r + v) * _CELL[1] - _MIDDLE])
                scene.collection.objects.link(_object(hand, hand.vertices @ shown.T + at, materials))
    for placed in SUNS:
        scene.collection.objects.link(sun("sun", *placed))
    wide, high = len(names), len(_VIEWS) * len(rows)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.type, camera.data.sensor_fit = "ORTHO", "VERTICAL"
    camera.data.ortho_scale = high * _CELL[1]
    camera.location = (0.5 * (wide - 1) * _CELL[0], -2.0, -0.5 * (high - 1) * _CELL[1])
    camera.rotation_euler = (np.pi / 2, 0.0, 0.0)
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.world = bpy.data.worlds.new("grey")
    scene.world.color = (_BACKGROUND,) * 3
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.max_bounces = _SAMPLES, 2
    scene.cycles.use_denoising = False
    scene.view_settings.view_transform = "Standard"
    width = round(height * _CELL[0] / _CELL[1])
    scene.render.resolution_x, scene.render.resolution_y = wide * width, high * height
    with tempfile.TemporaryDirectory() as folder:
        scene.render.filepath = f"{folder}/sheet.png"
        bpy.ops.render.render(write_still=True)
        picture = cv2.imread(scene.render.filepath)
    above, left = _MARGIN
    picture = cv2.copyMakeBorder(
        picture, above, 0, left, 0, cv2.BORDER_CONSTANT, value=picture[0, 0].tolist()
    )
    for column, name in enumerate(names):
        _write(picture, name, (left + column * width + width // 8, 14))
    for r, name in enumerate(rows):
        _write(picture, name, (4, above + len(_VIEWS) * r * height + height // 2))
    return picture


def _material(color: np.ndarray) -> bpy.types.Material:
    import bpy

    from blender_manient.blender_versions import use_nodes

    material = bpy.data.materials.new("skin")
    shader = use_nodes(material).nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*color, 1.0)
    shader.inputs["Roughness"].default_value = 0.6
    return material


def _object(hand: Skin, vertices: np.ndarray, materials: Sequence[bpy.types.Material]) -> bpy.types.Object:
    import bpy

    mesh = bpy.data.meshes.new("hand")
    mesh.from_pydata(vertices.tolist(), [], hand.polygons)
    for material in materials:
        mesh.materials.append(material)
    mesh.polygons.foreach_set("material_index", hand.nails.astype(np.int32))
    mesh.polygons.foreach_set("use_smooth", np.ones(len(mesh.polygons), dtype=bool))
    return bpy.data.objects.new("hand", mesh)


def _write(picture: np.ndarray, text: str, place: tuple[int, int]) -> None:
    cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.42, (235, 235, 235), 1, cv2.LINE_AA)


if __name__ == "__main__":
    sys.exit(main())
