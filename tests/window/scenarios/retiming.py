"""A clip in a shot of another rate."""

from __future__ import annotations

import bpy
import numpy as np

from scenarios.capturing import capture, hands, keys_of, part, pose_of
from scenarios.refine import INDEX_TIP, WARM, dragged, operator, places, state

STRIP = 12
"""pixels of the picture: the middle of its bar, from above"""


def in_step(stage, source, rate, first, frames):
    """Captured into a shot of `rate` from frame `first` on; at each of `frames` where the bar in the picture
    lies in the screenshot, and where the hand's points are. Then a point is dragged at the last of them."""
    scene = bpy.context.scene
    scene.render.fps = rate
    scene.frame_start, scene.frame_end = first, first + 60
    scene.frame_set(first)
    yield from stage.open_sidebar()
    scene.manient.source = source
    scene.manient.matching = "KEEP"
    yield 1.5
    yield from stage.screenshot("retiming-before")
    yield from capture(stage, source, matching="KEEP")
    (armature,) = hands()
    bpy.context.view_layer.objects.active = armature
    yield from stage.screenshot("retiming-captured")
    yield from stage.invoke("manient.edit_keypoints")
    yield from stage.until(operator().running, 5.0, "the mode to begin")
    yield from stage.until(lambda: places() and not state()["warming"], WARM, "a warm worker")
    looks = []
    for frame in frames:
        scene.frame_set(frame)
        yield 0.4
        yield from stage.screenshot(f"retiming-{frame}")
        looks.append({"frame": frame, **_look()})
    keys, before = keys_of(armature), [_pose(armature, f) for f in frames]
    scene.frame_set(frames[-1])
    yield 0.4
    x, y = places()[INDEX_TIP]
    yield from dragged(stage, [(x + 4 * i, y - 2 * i) for i in range(12)])
    yield from stage.until(lambda: state()["dragged"] is None, 10.0, "the last fit")
    yield 0.3
    yield from stage.screenshot("retiming-dragged")
    corrected = part("scene.corrections").corrected_frames(armature)
    scene.manient.spread = 0
    after = [_pose(armature, f) for f in frames]
    yield from stage.key("RET")
    yield from stage.until(lambda: not operator().running(), 5.0, "the mode to end")
    corrected_keys = keys_of(armature)
    scene.render.fps = 25
    yield 0.5
    yield from stage.screenshot("retiming-noticed")
    yield from stage.invoke("manient.retime", hand=armature.name)
    yield 0.5
    (armature,) = hands()
    again = part("scene.corrections").corrected_frames(armature)
    scene.frame_set(again[0])
    yield from stage.screenshot("retiming-again")
    yield from stage.undo()
    yield 0.3
    (armature,) = hands()
    return {
        "again": again,
        "undone": keys_of(armature) == corrected_keys,
        "looks": looks,
        "corrected": corrected,
        "changed": [f for f, one, other in zip(frames, before, after, strict=True) if one != other],
        "keys": keys == corrected_keys,
    }


def _look() -> dict:
    """Where both ends of the bar lie in pixels of the screenshot, and the hand's points in the picture."""
    mode = operator()._mode
    refiner = mode.refiner
    viewport = part("operators.modes.view").viewport_at(bpy.context, mode.view.address)
    ends = np.array([[0.0, STRIP], [refiner.take.width, STRIP]])
    matrix = mode.matrix(viewport)
    mapped = part("operators.modes.keypoints").mapped
    window = mapped(matrix, ends) + [viewport.region.x, viewport.region.y]
    window[:, 1] = bpy.context.window.height - window[:, 1]
    row = mode.row()
    return {
        "bar": window.tolist(),
        "hand": refiner.shown_landmarks().tolist(),
        "found": refiner.track.keypoints_2d[row].tolist(),
        "offset": _offset(refiner),
    }


def _offset(refiner) -> int:
    camera = refiner.hand.camera.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return camera.data.background_images[0].image_user.frame_offset


def _pose(armature, frame) -> str:
    bpy.context.scene.frame_set(frame)
    return pose_of(armature)
