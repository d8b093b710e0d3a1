"""Keypoints corrected with the mouse."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import bpy
import numpy as np
from stage import ADDON

from scenarios import redraws
from scenarios.capturing import capture, hands, keys_of, part, pose_of
from scenarios.panels import opened_by_default
from scenarios.traces import workers

INDEX_TIP = 8
WARM = 60.0
"""seconds that the worker may take to load what refits need"""


def keypoint_dragged(stage, source, steps=20):
    """The index finger's tip dragged aside; undo and redo; saved and opened again."""
    yield from stage.open_sidebar()
    yield from _edited(stage, source)
    (armature,) = hands()
    before = {frame: _pose_at(armature, frame) for frame in (1, 20, 28, 30, 32, 40, 60)}
    keys = keys_of(armature)
    bpy.context.scene.frame_set(30)
    yield 0.3
    yield from stage.screenshot("keypoints")

    start = places()[INDEX_TIP]
    path = [(start[0] + 70 * i / steps, start[1] - 25 * i / steps) for i in range(steps + 1)]
    yield from dragged(stage, path)
    yield from stage.until(lambda: state()["dragged"] is None, 10.0, "the last fit")
    yield 0.3
    yield from stage.move_to(stage.region())
    yield from stage.screenshot("keypoints-dragged")
    pins = state()["pins"]
    after = {frame: _pose_at(armature, frame) for frame in before}
    bpy.context.scene.frame_set(30)
    yield 0.3

    yield from stage.undo()
    yield 0.3
    (armature,) = hands()
    undone = _pose_at(armature, 30)
    yield from stage.redo()
    yield 0.3
    (armature,) = hands()
    redone = _pose_at(armature, 30)

    yield from stage.key("RET")
    yield from stage.until(lambda: not operator().running(), 5.0, "the mode to end")
    path = str(Path(source).with_name("refined.blend"))
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    yield 0.5
    (armature,) = hands()
    reloaded = _pose_at(armature, 30)
    bpy.context.scene.frame_set(30)
    yield from stage.open_sidebar()
    yield from stage.invoke("manient.edit_keypoints")
    yield from stage.until(lambda: state().get("pins"), WARM, "the pins of the saved file")
    pins_reloaded = state()["pins"]
    yield from stage.key("ESC")
    yield from stage.until(lambda: not operator().running(), 5.0, "the mode to end")
    return {
        "pins": len(pins),
        "pins_reloaded": len(pins_reloaded),
        "keys_then": keys,
        "keys_now": keys_of(armature),
        "changed": [frame for frame in before if before[frame] != after[frame]],
        "undone": undone == before[30],
        "redone": redone == after[30],
        "reloaded": reloaded == after[30],
    }


def live_latency(stage, source, steps=60):
    """Mouse to hand with a warm worker: each movement waits for the hand that follows it."""
    yield from _edited(stage, source)
    bpy.context.scene.frame_set(30)
    yield 0.3
    start = places()[INDEX_TIP]
    angles = np.linspace(0, 4 * np.pi, steps)
    path = [start, *((start[0] + 40 * np.sin(a), start[1] - 25 + 25 * np.cos(a)) for a in angles)]
    waits = yield from dragged(stage, path)
    yield from stage.key("RET")
    yield from stage.until(lambda: not operator().running(), 5.0, "the mode to end")
    return {
        "waits_ms": waits,
        "latencies_ms": [1000 * s for s in part("operators.modes.keypoints").latencies],
        "redraw_ms": (yield from redraws.timed(stage)),
    }


def see_through(stage, source, shadings=("SOLID",)):
    """How the picture shows through the hand while its points are edited, and what is left of that."""
    yield from stage.open_sidebar()
    yield from capture(stage, source)
    (armature,) = hands()
    bpy.context.view_layer.objects.active = armature
    found = {"before": _alphas()}
    yield from stage.invoke("manient.edit_keypoints")
    yield from stage.until(lambda: places() and not state()["warming"], WARM, "a warm worker")
    yield from stage.screenshot("see-through")
    found["begun"] = _alphas()
    start = places()[INDEX_TIP]
    yield from stage.drag([start, (start[0] + 20, start[1]), (start[0] + 40, start[1])], pause=0.1)
    yield from stage.until(lambda: state()["dragged"] is None, WARM, "the drag's fit")
    found["dragged"] = _alphas()
    yield from stage.move_to(stage.region())
    yield from stage.key("H")
    yield 0.2
    yield from stage.screenshot("see-through-off")
    found["solid"] = _alphas()
    yield from stage.key("H")
    yield 0.2
    bpy.context.preferences.addons[ADDON].preferences.hand_opacity = 0.25
    yield 0.2
    found["slider"] = _alphas()
    for shading in shadings:
        stage.area().spaces[0].shading.type = shading
        yield 2.0
        yield from stage.screenshot(f"see-through-{shading.lower()}")
    stage.area().spaces[0].shading.type = "SOLID"
    yield from stage.undo()
    yield 0.3
    found["undone"] = _alphas()
    found["drags"] = state()["done"]
    yield from stage.key("RET")
    yield from stage.until(lambda: not operator().running(), 5.0, "the mode to end")
    found["ended"] = _alphas()
    yield from stage.invoke("manient.edit_keypoints")
    yield from stage.until(lambda: operator().running() and places(), 5.0, "the mode to begin")
    found["again"] = _alphas()
    operator()._mode.ended = "as an undo from elsewhere ends it"
    yield from stage.move_to(stage.region(), dx=9)
    yield from stage.until(lambda: not operator().running(), 5.0, "the mode to end")
    found["abandoned"] = _alphas()
    bpy.context.preferences.addons[ADDON].preferences.property_unset("hand_opacity")
    return found


def looked_at(stage, take, blend, far=26, notches=13):
    """What Edit Keypoints shows of two small hands: at first, zoomed in about a fingertip, on a frame on
    which the hand is elsewhere, of the other hand, after a rename and an undo, by its keys, and in the file
    opened again. Places in pixels of the window."""
    with stage.override():
        bpy.ops.manient.import_take(filepath=str(take))
    yield from stage.open_sidebar()
    bpy.context.scene.frame_set(1)
    first, second = hands()
    before = _camera_view(stage)
    found = {"begun": (yield from _looking(stage, first, "look-begun"))}

    tip = places()[INDEX_TIP]
    yield from stage.move_to(tip)
    for _ in range(notches):
        yield from stage.key("WHEELUPMOUSE")
    yield 0.2
    yield from stage.screenshot("look-zoomed")
    found["tip"], found["zoomed"] = [stage.mouse, places()[INDEX_TIP]], _looked(stage)
    bpy.context.scene.frame_set(far)
    yield from stage.until(lambda: _in_sight(stage, INDEX_TIP), 5.0, "the fingertip")
    yield from stage.screenshot("look-followed")
    found["followed"] = _looked(stage)
    yield from _ended(stage)
    found["left"] = _camera_view(stage) == before

    found["other"] = yield from _looking(stage, second, "look-other")
    yield from _ended(stage)
    first.name = "Another name"
    bpy.ops.ed.undo_push(message="Renamed")
    bpy.ops.mesh.primitive_cube_add()
    bpy.ops.ed.undo_push(message="Cube")
    yield from stage.undo()
    found["again"] = yield from _looking(stage, bpy.data.objects["Another name"], "look-again")
    yield from stage.key("HOME", shift=True)
    yield 0.2
    yield from stage.screenshot("look-picture")
    found["picture"] = _looked(stage)
    yield from stage.key("HOME")
    yield 0.2
    found["home"] = _looked(stage)
    yield from _ended(stage)
    bpy.context.scene.frame_set(1)
    found["elsewhere"] = yield from _looking(stage, bpy.data.objects["Another name"], "look-elsewhere")
    yield from _ended(stage)

    bpy.ops.wm.save_as_mainfile(filepath=blend)
    bpy.ops.wm.open_mainfile(filepath=blend)
    yield 0.5
    found["opened"] = yield from _looking(stage, bpy.data.objects["Another name"], "look-opened")
    yield from _ended(stage)
    return found


def _looking(stage, armature, shot):
    """Begin Edit Keypoints of a hand; what is seen then."""
    for other in bpy.context.selected_objects:
        other.select_set(False)
    bpy.context.view_layer.objects.active = armature
    yield from stage.invoke("manient.edit_keypoints")
    yield from stage.until(lambda: places() and not state()["warming"], WARM, "a warm worker")
    yield 0.2
    yield from stage.screenshot(shot)
    return _looked(stage)


def _ended(stage):
    yield from stage.key("ESC")
    yield from stage.until(lambda: not operator().running(), 5.0, "the mode to end")


def _camera_view(stage) -> list:
    view = stage.area().spaces[0].region_3d
    return [view.view_perspective, view.view_camera_zoom, *view.view_camera_offset]


def _looked(stage) -> dict:
    """The handles, what is free for them, and the zoom."""
    mode, handles = operator()._mode, np.array(list(places().values()))
    viewport = part("operators.modes.view").viewport_at(bpy.context, mode.view.address)
    free = viewport.free() + [viewport.region.x, viewport.region.y]
    corners = [(0, 0), (mode.refiner.take.width, mode.refiner.take.height)]
    picture = part("operators.modes.keypoints").mapped(mode.matrix(viewport), np.array(corners))
    picture += [viewport.region.x, viewport.region.y]
    return {
        "handles": [*handles.min(axis=0), *handles.max(axis=0)],
        "picture": [*picture.min(axis=0), *picture.max(axis=0)],
        "free": free.ravel().tolist(),
        "zoom": viewport.view.view_camera_zoom,
    }


def _in_sight(stage, keypoint) -> bool:
    low, high = np.reshape(_looked(stage)["free"], (2, 2))
    return bool(((places()[keypoint] >= low) & (places()[keypoint] <= high)).all())


def _alphas() -> list:
    """Depth and alpha of each background image of the capture camera."""
    backgrounds = bpy.context.scene.camera.data.background_images
    return [[b.display_depth, round(b.alpha, 3)] for b in backgrounds]


def worker_killed(stage, source):
    """The worker dies between two drags."""
    yield from _edited(stage, source)
    bpy.context.scene.frame_set(30)
    yield 0.3
    ((worker, _),) = workers()
    os.kill(worker, signal.SIGKILL)
    yield 0.3
    start = places()[INDEX_TIP]
    yield from stage.drag([start, (start[0] + 20, start[1]), (start[0] + 40, start[1])], pause=0.1)
    yield from stage.until(lambda: state().get("message") or state()["dragged"] is None, WARM, "an answer")
    yield from stage.screenshot("keypoints-worker-killed")
    message = state().get("message", "")
    yield 1.0
    before = _pose_at(hands()[0], 30)
    start = places()[INDEX_TIP]
    yield from stage.drag([start, (start[0] + 20, start[1]), (start[0] + 50, start[1])], pause=0.1)
    yield from stage.until(lambda: state()["dragged"] is None, WARM, "the second drag's fit")
    after = _pose_at(hands()[0], 30)
    yield from stage.key("RET")
    return {"message": message, "followed": before != after}


def smoothed(stage, source):
    """The panel's slider turned up by Ctrl and the wheel, undone by one step, and turned farther."""
    with opened_by_default("MANIENT_PT_refine"):
        yield from stage.open_sidebar()
        yield from capture(stage, source)
        (armature,) = hands()
        bpy.context.view_layer.objects.active = armature
        bpy.context.scene.frame_set(30)
        bone = armature.pose.bones["index_proximal.R"]
        bone.rotation_quaternion = (0.8, 0.1, 0.5, 0.3)
        bone.keyframe_insert("rotation_quaternion", frame=30)
        bpy.ops.ed.undo_push(message="By hand")
        before = {frame: _values_at(armature, frame) for frame in range(1, 61)}
        own = _index_at(armature)
        yield 0.3
        yield from stage.screenshot("smooth-before")
        slider = yield from stage.find_button(".manient_smoothing", along=0.3)
        assert slider is not None, "no slider"
        found = {"strength": [], "changed": [], "kept": []}
        for notches in (3, 6):
            yield from stage.move_to(slider)
            for _ in range(notches):
                yield from stage.key("WHEELUPMOUSE", ctrl=True)
                yield 0.05
            yield from stage.until(lambda: refit().RangeFitOperator.fitting(), 10.0, "the fit to begin")
            yield from stage.screenshot("smooth-running")
            yield from stage.until(lambda: not refit().RangeFitOperator.fitting(), WARM, "the fit")
            yield 0.3
            yield from stage.screenshot("smooth-done")
            (armature,) = hands()
            found["strength"].append(armature.manient.smoothing)
            found["changed"].append(len(_changed(armature, before)))
            found["kept"].append(_index_at(armature) == own)
            yield from stage.undo()
            yield 0.3
            (armature,) = hands()
            found["strength"].append(armature.manient.smoothing)
            found["changed"].append(len(_changed(armature, before)))
    return found


def range_refitted(stage, source):
    """Re-fit Range by its button's click: the dialog, another last frame, and what was changed."""
    yield from stage.open_sidebar()
    yield from capture(stage, source)
    (armature,) = hands()
    bpy.context.view_layer.objects.active = armature
    bpy.context.scene.frame_set(30)
    bone = armature.pose.bones["index_proximal.R"]
    for frame in (32, 45):
        bpy.context.scene.frame_set(frame)
        bone.rotation_quaternion = (0.8, 0.1, 0.5, 0.3)
        bone.keyframe_insert("rotation_quaternion", frame=frame)
    bpy.context.scene.frame_set(30)
    bpy.ops.ed.undo_push(message="By hand")
    before = {frame: _values_at(armature, frame) for frame in range(1, 61)}
    bpy.context.scene.frame_set(30)
    yield from stage.invoke("manient.refit_range")
    yield 0.5
    yield from stage.screenshot("refit-range-asks")
    unchanged = _changed(armature, before)
    bpy.context.scene.frame_set(30)
    said = refit().replaced(bpy.context, *refit().suggested_range(bpy.context))[0]
    yield from stage.key("ESC")
    yield 0.3
    cancelled = _changed(armature, before)
    bpy.context.scene.frame_set(30)

    yield from stage.invoke("manient.refit_range")
    yield 0.5
    # The dialog opens with its field Last under the mouse.
    for _ in range(3):
        yield from stage.key("WHEELUPMOUSE", ctrl=True)
        yield 0.1
    yield from stage.screenshot("refit-range-wider")
    yield from stage.key("RET")
    yield from stage.until(lambda: refit().RangeFitOperator.fitting(), 10.0, "the fit to begin")
    yield from stage.until(lambda: not refit().RangeFitOperator.fitting(), WARM, "the fit")
    yield 0.3
    changed = _changed(armature, before)
    yield from stage.screenshot("refit-range-done")
    yield from stage.undo()
    yield 0.3
    (armature,) = hands()
    return {
        "said": said,
        "unchanged": unchanged + cancelled,
        "changed": changed,
        "undone": _changed(armature, before),
    }


def touched(stage, source):
    """Touch by its button's click, with the points and frames that its dialog suggests, and undone."""
    yield from stage.open_sidebar()
    yield from capture(stage, source)
    (armature,) = hands()
    bpy.context.view_layer.objects.active = armature
    bpy.context.scene.frame_set(30)
    bpy.ops.ed.undo_push(message="Captured")
    before = {frame: _values_at(armature, frame) for frame in range(1, 61)}
    bpy.context.scene.frame_set(30)
    first, last = part("operators.touch").touching_range(bpy.context, 4, 8)
    yield from stage.invoke("manient.touch")
    yield 0.5
    yield from stage.screenshot("touch-asks")
    yield from stage.key("RET")
    yield from stage.until(lambda: refit().RangeFitOperator.fitting(), 10.0, "the fit to begin")
    yield from stage.until(lambda: not refit().RangeFitOperator.fitting(), WARM, "the fit")
    yield 0.3
    yield from stage.screenshot("touch-done")
    refiner = part("session.refiner").Refiner(armature)
    rows = [refiner.row_at(frame) for frame in range(first, last + 1)]
    gaps = refiner.gaps(refiner.keyed_poses(rows), (8, 4))
    changed, spread = _changed(armature, before), bpy.context.scene.manient.spread
    yield from stage.undo()
    yield 0.3
    (armature,) = hands()
    return {
        "range": [first, last],
        "spread": spread,
        "apart": float(abs(gaps).max()),
        "changed": changed,
        "undone": _changed(armature, before),
    }


def _changed(armature, before) -> list[int]:
    """The frames whose pose is another one now, by more than how single precision rounds."""
    now = {frame: _values_at(armature, frame) for frame in before}
    return [f for f in before if max(abs(a - b) for a, b in zip(before[f], now[f], strict=True)) > 1e-5]


def _index_at(armature, frame=30) -> list[float]:
    bpy.context.scene.frame_set(frame)
    return [round(v, 6) for row in armature.pose.bones["index_proximal.R"].matrix_basis for v in row]


def _values_at(armature, frame) -> tuple[float, ...]:
    bpy.context.scene.frame_set(frame)
    return tuple(v for bone in armature.pose.bones for row in bone.matrix_basis for v in row)


def refit():
    return part("operators.refit_range")


def _edited(stage, source):
    """Captured, seen through the camera, and in Edit Keypoints with a warm worker."""
    yield from capture(stage, source)
    (armature,) = hands()
    bpy.context.view_layer.objects.active = armature
    yield from stage.look_through_camera()
    yield from stage.invoke("manient.edit_keypoints")
    yield from stage.until(operator().running, 5.0, "the mode to begin")
    yield from stage.until(lambda: places() and not state()["warming"], WARM, "a warm worker")


def dragged(stage, path):
    """Drag along a path; milliseconds from each movement until the hand had followed."""
    (armature,) = hands()
    yield from stage.move_to(path[0])
    yield 0.1
    x, y = stage.mouse
    stage.window.event_simulate(type="LEFTMOUSE", value="PRESS", x=x, y=y)
    yield from stage.until(lambda: state()["dragged"] == INDEX_TIP, 3.0, "the point to be taken")
    waits = []
    for point in path[1:]:
        pose, sent = _pose_now(armature), time.perf_counter()
        yield from stage.move_to(point)
        while _pose_now(armature) == pose and time.perf_counter() - sent < 2.0:
            yield 0.0
        waits.append(1000 * (time.perf_counter() - sent))
    x, y = stage.mouse
    stage.window.event_simulate(type="LEFTMOUSE", value="RELEASE", x=x, y=y)
    yield 0.1
    return waits


def operator():
    return part("operators.edit_keypoints")


def places() -> dict[int, tuple[float, float]]:
    """Keypoint -> (x, y) of its handle in window pixels, as events have them; empty while none are shown."""
    mode = operator()._mode
    viewport = part("operators.modes.view").viewport_at(bpy.context, mode.view.address) if mode else None
    if viewport is None:
        return {}
    found = mode.region_places(viewport) + np.array([viewport.region.x, viewport.region.y])
    return {k: (float(x), float(y)) for k, (x, y) in enumerate(found) if np.isfinite([x, y]).all()}


def state() -> dict:
    """What is dragged and pinned, what the line says, and how many drags there were."""
    mode = operator()._mode
    row = mode.row() if mode else None
    return (
        {}
        if mode is None
        else {
            "dragged": mode.drag.keypoint if mode.drag is not None else None,
            "pins": {} if row is None else dict(mode.refiner.pins(row)),
            "message": mode.message,
            "warming": bool(mode._warming),
            "done": mode.done,
        }
    )


def _pose_at(armature, frame) -> str:
    bpy.context.scene.frame_set(frame)
    return pose_of(armature)


def _pose_now(armature) -> tuple:
    return tuple(v for bone in armature.pose.bones for v in bone.rotation_quaternion)
