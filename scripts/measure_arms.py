#!/usr/bin/env python3
"""Measure captured arms: render a person who gestures for four cameras, capture each picture sequence with
arms, and compare with where the arms are.

    python scripts/measure_arms.py OUT --clips 3 --frames 60

The last clip is of a person who holds still. It needs anny, torch and a bpy wheel beside what captures need
(`nox -s arms`). Pictures that are there are kept.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from scripts.needed import need

for package in ("anny", "bpy", "mediapipe"):
    need(package, "nox -s arms")

import bpy
from mathutils import Matrix, Vector

from handfit_core import capture
from handfit_core.common.errors import HandfitError
from handfit_core.geometry.camera import Intrinsics
from handfit_core.media.source import DEFAULT_FPS
from handfit_core.take import HandTrack, Take
from scripts.benchmark.body import CLOTH, EYE, SKIN, Body, moving_body
from scripts.benchmark.materials import TINT, skin, surface
from scripts.benchmark.tint import skin_tone

WIDTH, HEIGHT, FOCAL = 800, 600, 720.0
"""pixels"""
CAMERAS: Final = (0.0, 35.0, -35.0, 60.0)
"""degrees about the person, from before it towards its left"""
TARGET, DISTANCE = np.array([0.0, -0.15, 0.35]), 1.35
"""metres: the point that cameras look at, and how far they are from it"""
HAND_LENGTH: Final = 0.19
"""metres by which distances are given in lengths of the hand"""


def main() -> int:
    """Run the script; returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("output", type=Path, help="folder for pictures")
    parser.add_argument(
        "--clips", type=int, default=3, help="people, the last of whom holds still (default 3)"
    )
    parser.add_argument("--frames", type=int, default=60, help="pictures of each (default 60)")
    parser.add_argument("--seed", type=int, default=0, help="another seed, other people (default 0)")
    args = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for clip in range(args.clips):
        still = clip == args.clips - 1
        body = moving_body(args.seed + clip, args.frames, DEFAULT_FPS, still=still)
        for number, degrees in enumerate(CAMERAS):
            folder = args.output / f"clip{clip}" / f"camera{number}"
            pose = render(body, degrees, folder, args.seed + clip)
            truth = {side: (arm - pose[:3, 3]) @ pose[:3, :3] for side, arm in body.arms.items()}
            try:
                take = capture(
                    str(folder / "%04d.jpg"), arms=True, hands="both",
                    intrinsics=Intrinsics(FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2),
                )  # fmt: skip
            except HandfitError as error:
                print(f"{folder}: {error}")
                continue
            for track in take.hands:
                rows.append(errors(track, truth[track.side], take, still=still))
                print(f"{folder.relative_to(args.output)} {track.side}: {_line(rows[-1])}", flush=True)
    print(table(rows))
    return 0


def render(body: Body, degrees: float, folder: Path, seed: int) -> np.ndarray:
    """Write the pictures that one camera takes; returns (4, 4) the camera frame's axes in Blender's world."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene, rng = bpy.context.scene, np.random.default_rng((seed, 1))
    mesh = bpy.data.meshes.new("body")
    mesh.from_pydata(body.vertices[0].tolist(), [], body.faces.tolist())
    mesh.polygons.foreach_set("use_smooth", np.ones(len(body.faces), dtype=bool))
    mesh.color_attributes.new(TINT, "FLOAT_COLOR", "POINT").data.foreach_set(
        "color", np.ones(4 * len(body.material))
    )
    materials = {
        SKIN: skin(skin_tone(rng), rng),
        CLOTH: surface("cloth", rng, (5.0, 30.0)),
        EYE: bpy.data.materials.new("eye"),
    }
    for number in sorted(materials):
        mesh.materials.append(materials[number])
    mesh.polygons.foreach_set("material_index", body.material[body.faces].max(axis=1))
    scene.collection.objects.link(bpy.data.objects.new("body", mesh))
    wall = surface("wall", rng, (0.7, 10.0))
    for where, turn in (((0.0, 2.2, 0.0), 0.0), ((3.5, 0.0, 0.0), 90.0), ((-3.5, 0.0, 0.0), 90.0)):
        bpy.ops.mesh.primitive_plane_add(size=12, location=where, rotation=np.radians([90.0, 0.0, turn]))
        bpy.context.object.data.materials.append(wall)
    for where, power in (((-1.5, -2.5, 2.0), 120.0), ((2.0, -2.0, 1.5), 60.0), ((0.0, -3.0, 0.5), 40.0)):
        lamp = bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "AREA"))
        lamp.data.energy, lamp.location = power, where
        lamp.rotation_euler = (Vector(TARGET) - Vector(where)).to_track_quat("-Z", "Y").to_euler()
        scene.collection.objects.link(lamp)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(camera)
    scene.camera, camera.data.lens = camera, camera.data.sensor_width * FOCAL / WIDTH
    around = np.radians(degrees)
    camera.location = TARGET + DISTANCE * np.array([np.sin(around), -np.cos(around), 0.03])
    camera.rotation_euler = (Vector(TARGET) - camera.location).to_track_quat("-Z", "Y").to_euler()
    world = bpy.data.worlds.new("sky")
    scene.world, world.color = world, (0.2, 0.2, 0.2)
    settings, cycles = scene.render, scene.cycles
    settings.engine, settings.resolution_x, settings.resolution_y = "CYCLES", WIDTH, HEIGHT
    settings.image_settings.file_format, settings.use_persistent_data = "JPEG", True
    cycles.device, cycles.samples, cycles.use_denoising, cycles.max_bounces = "CPU", 3, True, 2
    cycles.denoising_quality = cycles.denoising_prefilter = "FAST"
    for frame, vertices in enumerate(body.vertices):
        path = folder / f"{frame + 1:04d}.jpg"
        if not path.is_file():
            mesh.vertices.foreach_set("co", vertices.ravel())
            mesh.update()
            cycles.seed, settings.filepath = frame, str(path)
            bpy.ops.render.render(write_still=True)
    bpy.context.view_layer.update()
    # Blender's cameras look along their -Z, with +Y up.
    return np.array(camera.matrix_world @ Matrix.Diagonal((1.0, -1.0, -1.0, 1.0)))


def errors(track: HandTrack, truth: np.ndarray, take: Take, *, still: bool) -> dict[str, Any]:
    """What is measured of one hand's arm, by names with units; arrays have a value a frame with an arm.
    `truth`: (T, 3, 3) shoulder, elbow and wrist, camera frame."""
    arm, seen = track.arm, int(track.present.sum())
    if arm is None:
        return {"still": still, "hand": seen, "arm": 0, "why": track.no_arm}
    at = np.flatnonzero(arm.present)
    found = np.stack([arm.shoulder, arm.elbow, arm.wrist], axis=1)[at]
    true = truth[at]
    reach, true_reach = (each[:, 2] - each[:, 0] for each in (found, true))
    with_hand = np.flatnonzero(arm.present & track.present)
    joints = track.joints_3d[with_hand]
    size = FOCAL * HAND_LENGTH / joints[:, 0, 2]
    off = take.intrinsics.project(arm.wrist[with_hand]) - take.intrinsics.project(joints[:, 0])
    tremble = np.linalg.norm(reach - np.median(reach, axis=0), axis=1)
    return {
        "still": still,
        "hand": seen,
        "arm": len(with_hand),
        "upper arm, degrees": _between(found[:, 1] - found[:, 0], true[:, 1] - true[:, 0]),
        "forearm, degrees": _between(found[:, 2] - found[:, 1], true[:, 2] - true[:, 1]),
        "swivel, degrees": _swivel(found, true),
        "wrist off the hand's, hand lengths": np.linalg.norm(off, axis=1) / size,
        "wrist from shoulder, mm": 1000.0 * np.linalg.norm(reach - true_reach, axis=1),
        **({"noise of a still wrist about the shoulder, mm": 1000.0 * tremble} if still else {}),
    }


def _between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    cosine = (first * second).sum(axis=1) / np.linalg.norm(first, axis=1) / np.linalg.norm(second, axis=1)
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _swivel(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """(T,) degrees by which the elbow is turned about the way from shoulder to wrist."""
    sides = []
    for arm in (found, true):
        along = arm[:, 2] - arm[:, 0]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        across = np.cross(along, arm[:, 1] - arm[:, 0])
        sides.append((along, across))
    (along, across), (true_along, true_across) = sides
    # The plane of the true arm, brought to the found one's axis by the shortest turn.
    axis = np.cross(true_along, along)
    cosine = (true_along * along).sum(axis=1, keepdims=True)
    turned = true_across * cosine + np.cross(axis, true_across)
    turned += axis * (axis * true_across).sum(axis=1, keepdims=True) / (1.0 + cosine)
    return _between(across, turned)


def _line(row: dict[str, Any]) -> str:
    values = [f"{name} {np.median(v):.3g}" for name, v in row.items() if isinstance(v, np.ndarray)]
    return f"{row['arm']} of {row['hand']} frames; {'; '.join(values) or row['why']}"


def table(rows: list[dict[str, Any]]) -> str:
    """Medians and 95th percentiles over all frames."""
    lines = [f"{'':<50} {'median':>8} {'95 %':>8} {'frames':>8}"]
    names = dict.fromkeys(name for row in rows for name, v in row.items() if isinstance(v, np.ndarray))
    for name in names:
        values = np.concatenate([row[name] for row in rows if name in row])
        middle, high = np.percentile(values, [50, 95])
        lines.append(f"{name:<50} {middle:>8.3g} {high:>8.3g} {len(values):>8}")
    seen, arms = (sum(row[of] for row in rows) for of in ("hand", "arm"))
    return "\n".join([*lines, f"\n{arms} of {seen} frames with a hand have an arm."])


if __name__ == "__main__":
    sys.exit(main())
