#!/usr/bin/env python3
"""Render the bundled sample: a short sequence of a hand, made from the open hand with Cycles.

    python scripts/render_sample.py [-o samples/rendered_hand]      (Python with the bpy wheel)

No photo may be bundled, so this stands in for one in the demo and in tests. Beside the pictures it
writes `truth.take.npz`, the pose that was rendered.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from blender_manient.blender_versions import use_nodes
from blender_manient.scene.build import BuiltTake, build_take
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.media.source import Source
from handfit_core.skeleton import JOINTS_BY_FINGER
from handfit_core.take import Take
from scripts.benchmark.kinematics import hand_pose_from_angles, model_of
from scripts.benchmark.shots import ShotHand, rendered_take

WIDTH, HEIGHT = 640, 480
CAMERA = Intrinsics(700.0, 700.0, WIDTH / 2, HEIGHT / 2)
FRAMES = 24
SAMPLES = 16
SIDE = "right"

# Degrees: bend of the three joints, and spread of the first, per finger; thumb, index ... little.
_OPEN = {"bend": ((5, 5, 5),) + ((4, 6, 4),) * 4, "spread": (8, 12, 3, -6, -14)}
_PINCH = {
    "bend": ((22, 22, 38), (48, 52, 30), (22, 26, 14), (14, 18, 10), (10, 14, 8)),
    "spread": (-6, 2, 0, -2, -6),
}
_POINT = {
    "bend": ((18, 38, 40), (6, 8, 4), (78, 88, 50), (80, 90, 52), (80, 84, 48)),
    "spread": (-10, 0, 0, 0, 0),
}
_KEYS = ((0, _OPEN, (0, 0)), (7, _PINCH, (-22, 8)), (15, _POINT, (14, -10)), (23, _OPEN, (0, 12)))
"""Frame, fingers, and turn of the hand about the vertical and about the line of sight, degrees."""


def main() -> int:
    """Run the script; returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "samples" / "rendered_hand")
    args = parser.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    bpy.ops.wm.read_factory_settings(use_empty=True)

    take = truth()
    built = build_take(take, picture=False, wrist="open", render_setup=False)
    furnish(built)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples = SAMPLES
    scene.cycles.use_denoising = True
    scene.cycles.max_bounces = 3
    scene.render.image_settings.file_format = "JPEG"
    scene.render.image_settings.quality = 88
    scene.view_settings.view_transform = "Standard"
    for number, name in zip(take.frame_numbers, take.source.files, strict=True):
        scene.frame_set(int(number))
        scene.render.filepath = str(args.output / name)
        bpy.ops.render.render(write_still=True)
        print(f"{name} ({number}/{FRAMES})", flush=True)
    take.save(args.output / "truth.take.npz")
    return 0


def truth() -> Take:
    """The motion that is rendered: open, pinch, point, open."""
    times = [key[0] for key in _KEYS]
    bends = np.array([key[1]["bend"] for key in _KEYS], dtype=float)
    spreads = np.array([key[1]["spread"] for key in _KEYS], dtype=float)
    turns = np.array([key[2] for key in _KEYS], dtype=float)

    angles, orient, transl = np.zeros((FRAMES, 16, 3)), np.empty((FRAMES, 3)), np.empty((FRAMES, 3))
    for t in range(FRAMES):
        angles[t, JOINTS_BY_FINGER, 2] = np.radians(_between(times, bends, t))
        angles[t, JOINTS_BY_FINGER[:, 0], 1] = np.radians(_between(times, spreads, t))
        orient[t] = _towards_camera(*np.radians(_between(times, turns, t)))
        wrist_at = np.array([-0.01 + 0.02 * math.sin(t / 6), 0.075, 0.42 + 0.03 * math.sin(t / 9)])
        transl[t] = wrist_at - model_of(SIDE).shaped().joints[0]
    hand = ShotHand(SIDE, np.zeros(10), orient, hand_pose_from_angles(angles[:, 1:], SIDE), transl)
    source = Source("sequence", tuple(f"hand.{t + 1:04d}.jpg" for t in range(FRAMES)))
    return rendered_take(source, 24.0, np.arange(1, FRAMES + 1), (WIDTH, HEIGHT), CAMERA, (hand,))


def _between(times: list[int], values: np.ndarray, t: float) -> np.ndarray:
    """Smooth interpolation between keys, with a rest at each."""
    i = min(int(np.searchsorted(times, t, side="right")) - 1, len(times) - 2)
    u = (t - times[i]) / (times[i + 1] - times[i])
    u = u * u * (3 - 2 * u)
    return (1 - u) * values[i] + u * values[i + 1]


def _towards_camera(about_vertical: float, about_sight: float) -> np.ndarray:
    """Root rotation (3,): palm to the camera, fingers up, then turned."""
    facing = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    turn = rotvec_to_rotmat(np.array([0.0, 0.0, about_sight])) @ rotvec_to_rotmat(
        np.array([0.0, about_vertical, 0.0])
    )
    return rotmat_to_rotvec(turn @ facing)


def furnish(built: BuiltTake) -> None:
    """A sleeve over the cut wrist, a wall, and light."""
    hand = built.hands[0]
    wrist = hand.armature.data.bones[0]
    bpy.ops.mesh.primitive_cone_add(
        vertices=48,
        radius1=0.043,
        radius2=0.031,
        depth=0.30,
        location=wrist.head_local,
        end_fill_type="NOTHING",
    )
    sleeve = bpy.context.object
    # The cone's +Z becomes the direction from the elbow to the hand.
    direction = (wrist.tail_local - wrist.head_local).normalized()
    sleeve.rotation_euler = direction.to_track_quat("Z", "Y").to_euler()
    sleeve.location = wrist.head_local - direction * 0.165
    sleeve.vertex_groups.new(name=wrist.name).add(range(len(sleeve.data.vertices)), 1.0, "REPLACE")
    sleeve.modifiers.new("Armature", "ARMATURE").object = hand.armature
    sleeve.parent = hand.armature
    sleeve.data.materials.append(_material("sleeve", (0.05, 0.12, 0.25), 0.9))
    for polygon in sleeve.data.polygons:
        polygon.use_smooth = True

    bpy.ops.mesh.primitive_plane_add(size=6, location=(0, 1.6, 0), rotation=(math.radians(90), 0, 0))
    bpy.context.object.data.materials.append(_material("wall", (0.55, 0.58, 0.55), 1.0))

    for name, location, energy, size in (
        ("key", (-0.6, -0.1, 0.7), 14.0, 0.5),
        ("fill", (0.8, 0.0, 0.1), 4.0, 0.8),
    ):
        light = bpy.data.lights.new(name, "AREA")
        light.energy, light.size = energy, size
        lamp = bpy.data.objects.new(name, light)
        lamp.location = location
        target = np.array([0.0, 0.42, 0.0]) - np.array(location)
        lamp.rotation_euler = Vector(target).to_track_quat("-Z", "Y").to_euler()
        bpy.context.scene.collection.objects.link(lamp)
    world = bpy.data.worlds.new("room")
    bpy.context.scene.world = world
    background = use_nodes(world).nodes["Background"]
    background.inputs["Color"].default_value = (0.5, 0.55, 0.6, 1.0)
    background.inputs["Strength"].default_value = 0.5


def _material(name: str, colour: tuple[float, float, float], roughness: float) -> bpy.types.Material:
    material = bpy.data.materials.new(name)
    shader = use_nodes(material).nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*colour, 1.0)
    shader.inputs["Roughness"].default_value = roughness
    return material


if __name__ == "__main__":
    sys.exit(main())
