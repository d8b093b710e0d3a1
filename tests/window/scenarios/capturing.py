"""What the scenarios of capturing share."""

from __future__ import annotations

import hashlib
import importlib
from pathlib import Path
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


def press_capture(stage, source: str):
    """Choose a source and click the panel's own button with the mouse. Returns the job."""
    bpy.context.scene.manient.source = source
    yield 1.0
    place = yield from stage.find_button("bpy.ops.manient.capture(")
    assert place is not None, "the sidebar has no button Capture"
    yield from stage.click(place)
    return (yield from stage.until(lambda: next(iter(jobs()), None), 5.0, "the capture to begin"))


def finish(stage, *waited, timeout: float = 90.0):
    """Wait until jobs are over; their last state was seen by the panel as well."""
    yield from stage.until(
        lambda: all(job.finished for job in waited),
        timeout,
        lambda: f"the captures to end: {[(job.name, job.state, job.status()) for job in waited]}",
    )
    yield 0.3


def done(job):
    """Fail with the job's own words unless it went well."""
    assert job.state == "done", f"{job.name} is {job.state}: {job.message}"


def capture(stage, source: str, **settings):
    """Choose a source, press Capture, wait for the hands. Returns the job."""
    job = yield from begin(stage, source, **settings)
    yield from finish(stage, job)
    done(job)
    return job


def hands() -> list[bpy.types.Object]:
    """The captured hands of the scene."""
    return part("scene.store").captured_hands(bpy.context.scene)


def summary() -> list[dict]:
    """What the file holds of each captured hand, to compare before and after."""
    found = []
    for armature in hands():
        hand = part("scene.store").hand_of(armature)
        assert hand is not None, f"{armature.name} has lost its take"
        bpy.context.scene.frame_set(bpy.context.scene.frame_current)
        found.append(
            {
                "name": armature.name,
                "side": hand.side,
                "frames": len(hand.take.frame_numbers),
                "detected": int(hand.track.detected.sum()),
                "keys": keys_of(armature),
                "pose": pose_of(armature),
                "camera": hand.camera.name if hand.camera else None,
                "mesh": len(hand.mesh.data.vertices) if hand.mesh else 0,
            }
        )
    return found


def pose_of(armature: bpy.types.Object) -> str:
    """A digest of the pose at the current frame."""
    values = [round(v, 5) for bone in armature.pose.bones for row in bone.matrix_basis for v in row]
    return hashlib.sha256(repr(values).encode()).hexdigest()[:12]


def pixels_of(path: Path) -> np.ndarray:
    """(H, W, 4) a file's own values 0..1, the lowest row first, as regions count."""
    image = bpy.data.images.load(str(path), check_existing=False)
    image.colorspace_settings.name = "Non-Color"
    width, height = image.size
    pixels = np.empty(width * height * 4, dtype=np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(height, width, 4)


def keys_of(obj) -> int:
    """The number of keys of an object's action."""
    action = obj.animation_data and obj.animation_data.action
    return sum(len(curve.keyframe_points) for curve in action.fcurves) if action else 0
