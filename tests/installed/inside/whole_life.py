"""The extension from its installation to its end."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Any

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))

import steps
from steps import Facts
from traces import traces

Places = dict[str, list[float]]
"""Where bones are, by name"""
LOOKED_AT = (1, 12, 25)
"""Scene frames in which exported motion is compared"""


def main() -> None:
    """Stage by stage."""
    facts = Facts()
    asked = facts.asked
    facts.add("surroundings", **steps.surroundings())
    before = traces()

    facts.add("installed", **steps.install(asked["zip"]))
    facts.add("panels", said=steps.panels())
    facts.add("check", report=steps.check_report())
    facts.add("photo", **steps.capture(asked["photo"]))
    facts.add("worker", **steps.worker())
    empty_file()
    first, last = asked["frames"]
    frames = {"use_frames": True, "first_frame": first, "last_frame": last}
    facts.add("video", **steps.capture(asked["video"], **frames))
    facts.add("refit", **refit())
    motion = {frame: places(armature(), frame) for frame in LOOKED_AT}
    facts.add("exported", **{kind: exported(kind, asked["made"]) for kind in ("fbx", "glb")})
    facts.add("loaded", **steps.loaded())
    facts.add("imported", **{kind: imported(kind, asked["made"], motion) for kind in ("fbx", "glb")})

    worker = steps.worker()
    name = steps.module().__name__
    said = steps.attempt(bpy.ops.preferences.addon_disable, module=name)
    time.sleep(0.5)  # the worker is killed while it gives back memory
    alive = steps.alive(worker["pid"]) if worker else None
    facts.add("disabled", said=said, before=before, left=traces(), worker=alive)
    said = steps.attempt(bpy.ops.preferences.addon_enable, module=name)
    empty_file()
    facts.add("enabled again", enabling=said, **steps.capture(asked["photo"]))
    worker = steps.worker()
    said = steps.uninstall()
    time.sleep(0.5)
    alive = steps.alive(worker["pid"]) if worker else None
    facts.add("uninstalled", said=said, enabled=steps.enabled(), left=traces(), worker=alive)
    if bpy.app.version < (4, 3):
        # As a Python module it crashes at its end after any export to glTF, also without our add-on.
        sys.stdout.flush()
        os._exit(0)


def empty_file() -> None:
    """Another file, with nothing in it; preferences stay."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)


def armature() -> bpy.types.Object:
    """The one captured hand, made active."""
    (found,) = steps.hands()
    bpy.context.view_layer.objects.active = found
    return found


def refit() -> dict[str, Any]:
    """Ten frames once more, with a point put elsewhere."""
    hand = armature()
    bpy.context.scene.frame_set(12)
    before = places(hand, 12)
    refiner = steps.module("session.refiner").Refiner(hand)
    place = refiner.keyed_poses([refiner.row_at(12)]).landmarks[0][8] + [30.0, -20.0]
    moved = steps.attempt(
        bpy.ops.manient.move_keypoint, hand=hand.name, frame=12, keypoint=8, x=place[0], y=place[1]
    )
    said = steps.attempt(bpy.ops.manient.refit_range, scope="CUSTOM", first=7, last=17)
    return {"moved": moved, "said": said, "by": farthest(before, places(hand, 12))}


def places(hand: bpy.types.Object, frame: int) -> Places:
    """Where the bones begin, in metres of the world."""
    bpy.context.scene.frame_set(frame)
    seen = hand.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return {bone.name: list(seen.matrix_world @ bone.head) for bone in seen.pose.bones}


def farthest(before: Places, after: Places) -> float:
    """The largest distance between bones of the same name, of which there must be a whole hand."""
    same = before.keys() & after.keys()
    assert len(same) >= 16, (sorted(before), sorted(after))
    return max(sum((a - b) ** 2 for a, b in zip(before[k], after[k], strict=True)) ** 0.5 for k in same)


def exported(kind: str, folder: str) -> dict[str, Any]:
    """Write a file for other programs."""
    path = Path(folder) / f"hand.{kind}"
    said = steps.attempt(bpy.ops.manient.export_hand, filepath=str(path), file_format=kind)
    return {"said": said, "bytes": path.stat().st_size if path.is_file() else 0}


def imported(kind: str, folder: str, motion: dict[int, Places]) -> dict[str, Any]:
    """Read it with Blender's own importer, into an empty file of the same rate."""
    rate = bpy.context.scene.render.fps, bpy.context.scene.render.fps_base
    empty_file()
    bpy.context.scene.render.fps, bpy.context.scene.render.fps_base = rate
    path = str(Path(folder) / f"hand.{kind}")
    if kind == "fbx":
        said = steps.attempt(bpy.ops.import_scene.fbx, filepath=path, anim_offset=0.0)
    else:
        said = steps.attempt(bpy.ops.import_scene.gltf, filepath=path)
    (found,) = [o for o in bpy.data.objects if o.type == "ARMATURE"]
    meshes = [o for o in bpy.data.objects if o.type == "MESH" and o.find_armature() == found]
    return {
        "said": said,
        "off": max(farthest(then, places(found, frame)) for frame, then in motion.items()),
        "moves": farthest(places(found, LOOKED_AT[0]), places(found, LOOKED_AT[-1])),
        "vertices": [len(o.data.vertices) for o in meshes],
    }


main()
