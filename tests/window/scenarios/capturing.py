"""What the scenarios of capturing share."""

from __future__ import annotations

import importlib
from types import ModuleType

import bpy
import numpy as np
from stage import ADDON


def part(name: str) -> ModuleType:
    """A module of the add-on; looked up late, since the add-on comes and goes."""
    return importlib.import_module(f"{ADDON}.{name}")


def jobs() -> tuple:
    """The add-on's queue."""
    return part("session.jobs").jobs()


def begin(stage, source: str, **settings):
    """Choose a source and press Capture. Returns the job."""
    panel = bpy.context.scene.manient
    panel.source = source
    for name, value in settings.items():
        setattr(panel, name, value)
    before = jobs()
    yield from stage.invoke("manient.capture")
    new = yield from stage.until(
        lambda: [job for job in jobs() if job not in before], 5.0, f"a capture of {source} to begin"
    )
    return new[0]


def looking(stage, job, frames: int = 5):
    """Wait until so many frames have been looked at."""
    there = lambda: job.progress.stage == "detect" and job.progress.done >= frames  # noqa: E731
    yield from stage.until(there, 60.0, f"{frames} frames")


def finish(stage, *waited, timeout: float = 180.0):
    """Wait until jobs are over; their last state was seen by the panel as well."""
    yield from stage.until(
        lambda: all(job.finished for job in waited),
        timeout,
        lambda: f"the captures to end: {[(job.request.name, job.state, job.status()) for job in waited]}",
    )
    yield 0.3


def done(*finished):
    """Fail with the jobs' own words unless all went well."""
    for job in finished:
        assert job.state == "done", f"{job.request.name} is {job.state}: {job.result.message}"


def capture(stage, source: str, **settings):
    """Choose a source, press Capture, wait for the hands, and choose the first. Returns the job."""
    job = yield from begin(stage, source, **settings)
    yield from finish(stage, job)
    done(job)
    bpy.context.view_layer.objects.active = hands()[0]
    return job


def import_take(stage, take: str):
    """Import a take, and choose its first hand. Returns that."""
    with stage.override():
        assert bpy.ops.manient.import_take(filepath=take, matching="KEEP") == {"FINISHED"}
    yield 0.3
    armature = hands()[0]
    armature.select_set(True)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.ed.undo_push(message="Imported")
    return armature


def hands() -> list[bpy.types.Object]:
    """The captured hands of the scene."""
    return part("scene.store").captured_hands(bpy.context.scene)


def summary() -> list[dict]:
    """What the file holds of each captured hand, to compare before and after."""
    found = []
    for armature in hands():
        hand = part("scene.store").hand_of(armature)
        assert hand is not None, f"{armature.name} has lost its take"
        found.append(
            {
                "name": armature.name,
                "side": hand.side,
                "frames": len(hand.take.frame_numbers),
                "detected": int(hand.track.detected.sum()),
                "keys": keys_of(armature),
                "pose": pose_at(armature, bpy.context.scene.frame_current).tolist(),
                "camera": hand.camera.name if hand.camera else None,
                "mesh": len(hand.mesh.data.vertices) if hand.mesh else 0,
            }
        )
    return found


def pose_at(armature: bpy.types.Object, frame: int) -> np.ndarray:
    """(N, 4, 4) of the bones, in a frame that is current from then on; to five digits."""
    bpy.context.scene.frame_set(frame)
    return np.array([bone.matrix_basis for bone in armature.pose.bones]).round(5)


def changed(armature: bpy.types.Object, before: dict[int, np.ndarray]) -> list[int]:
    """The frames whose pose is another one now than `before`, by more than how numbers are rounded."""
    now, found = bpy.context.scene.frame_current, []
    for frame, pose in before.items():
        if np.abs(pose_at(armature, frame) - pose).max() > 3e-5:
            found.append(frame)
    bpy.context.scene.frame_set(now)
    return found


def mesh_of(armature: bpy.types.Object) -> np.ndarray:
    """(V, 3) where the points of the hand's mesh are seen."""
    shown = armature.manient.mesh.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    places = np.empty((len(shown.vertices), 3), dtype=np.float32)
    shown.vertices.foreach_get("co", places.ravel())
    return places


def keys_of(obj) -> int:
    """The number of keys of an object's action."""
    action = obj.animation_data and obj.animation_data.action
    return sum(len(curve.keyframe_points) for curve in action.fcurves) if action else 0


def assert_sentence(text: str) -> None:
    """What an artist can read: one sentence, with a remedy, no program's words."""
    assert 20 < len(text) < 300, text
    assert "\n" not in text
    for word in ("Traceback", "Error(", "Exception", "None"):
        assert word not in text, text
