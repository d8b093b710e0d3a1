"""Keypoints corrected with the mouse, and ranges of frames fitted again from the panel."""

from __future__ import annotations

import statistics
import time

import bpy
import numpy as np

from scenarios.capturing import capture, changed, hands, import_take, keys_of, part, pose_at
from scenarios.panels import opened_by_default

INDEX_TIP = 8
KEYED = "index_proximal.R"
"""The bone that is keyed by hand"""
WARM = 60.0
"""seconds that the worker may take to load what refits need"""
LATENCY = 2.4
"""redraws"""


def keypoint_dragged(stage, source, steps=20):
    """The index finger's tip dragged aside, undone and redone; the picture shows through the hand meanwhile;
    saved and opened again."""
    yield from stage.open_sidebar()
    yield from capture(stage, source)
    picture = [["BACK", 1.0]]
    assert _alphas() == picture
    (armature,) = hands()
    before = {frame: pose_at(armature, frame) for frame in (1, 20, 28, 30, 32, 40, 60)}
    keys = keys_of(armature)
    yield from edited(stage, armature, frame=30)
    assert _alphas() == [*picture, ["FRONT", 0.5]]
    start = places()[INDEX_TIP]
    yield from dragged(stage, [(start[0] + 70 * i / steps, start[1] - 25 * i / steps) for i in range(steps)])
    pins = state()["pins"]
    assert len(pins) == 1
    # Spread is six frames: the neighbours follow, the rest stays, and no key comes or goes.
    follow = [28, 30, 32]
    assert changed(armature, before) == follow
    yield from stage.key("H")
    yield 0.2
    assert _alphas() == picture
    yield from stage.undo()
    (armature,) = hands()
    assert changed(armature, before) == []
    yield from stage.redo()
    (armature,) = hands()
    assert changed(armature, before) == follow
    yield from ended(stage, "RET")
    assert _alphas() == picture
    assert keys_of(armature) == keys
    after = {frame: pose_at(armature, frame) for frame in before}
    yield from stage.reopen(f"{source}.blend")
    (armature,) = hands()
    assert changed(armature, after) == []
    yield from edited(stage, armature, frame=30)
    assert list(state()["pins"]) == list(pins)
    yield from ended(stage)


def follows_the_mouse(stage, source, steps=60):
    """With a warm worker a movement of the mouse is followed by the hand within a few redraws. Of up to three
    drags the quietest counts, since machines are shared and noisy."""
    yield from capture(stage, source)
    yield from edited(stage, hands()[0], frame=30)
    mode, found = part("operators.modes.keypoints"), []
    while len(found) < 3:
        mode.latencies.clear()
        x, y = places()[INDEX_TIP]
        angles = np.linspace(0, 4 * np.pi, steps)
        yield from dragged(stage, [(x + 40 * np.sin(a), y - 25 + 25 * np.cos(a)) for a in angles])
        assert len(mode.latencies) > 30
        redraw = yield from stage.redraw()
        found.append(1000 * statistics.median(mode.latencies) / redraw)
        if found[-1] < LATENCY:
            return (yield from ended(stage))
    raise AssertionError(f"mouse to hand: {found} redraws")


def looked_at(stage, take):
    """Small hands are looked at closely: half of the view is the hand, the wheel zooms about a fingertip, and
    the view is as before in the end; edited again, the hand has its own view again."""
    armature = yield from import_take(stage, take)
    yield from stage.open_sidebar()
    before = _camera_view(stage)
    yield from edited(stage, armature, frame=1)
    handles, free = _handles_and_free()
    assert abs((np.ptp(free, axis=0) / np.ptp(handles, axis=0)).min() - 2.0) < 0.04
    np.testing.assert_allclose(handles.mean(axis=0), free.mean(axis=0), atol=2.0)
    zoom = _camera_view(stage)[1]
    yield from stage.move_to(places()[INDEX_TIP])
    for _ in range(13):
        yield from stage.key("WHEELUPMOUSE")
    yield 0.2
    np.testing.assert_allclose(places()[INDEX_TIP], stage.mouse, atol=2.0)
    assert _camera_view(stage)[1] > zoom
    bpy.context.scene.frame_set(26)  # where the hand is elsewhere: the view follows
    yield from stage.until(lambda: _is_free(places()[INDEX_TIP]), 5.0, "the fingertip")
    yield from stage.key("HOME")
    yield 0.2
    handles, free = _handles_and_free()
    assert (handles >= free[0]).all()
    assert (handles <= free[1]).all()
    own = _camera_view(stage)
    yield from ended(stage)
    assert _camera_view(stage) == before
    yield from edited(stage, armature, frame=26)
    assert _camera_view(stage) == own
    yield from ended(stage)


def put_elsewhere(stage, source):
    """A hand that was moved, turned and scaled is edited where it was captured and goes back exactly; clicks
    and boxes that hit no point choose nothing behind. Beside a correction the points are hollow."""
    yield from stage.open_sidebar()
    yield from capture(stage, source)
    (armature,) = hands()
    bpy.context.scene.frame_set(30)
    armature.location, armature.rotation_euler, armature.scale = (0.3, 0.2, 0.1), (0.5, 1.0, 0.3), (2, 2, 2)
    bpy.ops.mesh.primitive_plane_add(size=4, location=(0, 2, 0), rotation=(np.pi / 2, 0, 0))
    behind = bpy.context.object
    behind.select_set(False)
    armature.select_set(True)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.ed.undo_push(message="Elsewhere")
    yield 0.3
    place = armature.matrix_world.copy()
    yield from stage.screenshot("elsewhere-before")
    yield from edited(stage, armature, frame=30)
    yield from stage.screenshot("elsewhere-edited")
    captured = armature.matrix_world.copy()
    assert np.abs(np.array(captured) - np.eye(4)).max() < 1e-5
    selected = lambda: (list(bpy.context.selected_objects), bpy.context.object)  # noqa: E731
    before = selected()
    assert behind not in before[0]
    free = viewport().free() + [viewport().region.x, viewport().region.y]
    corner, middle = free[0] + 20, free.mean(axis=0) + [0, 0.45 * np.ptp(free[:, 1])]
    for button in ("LEFTMOUSE", "RIGHTMOUSE"):
        yield from stage.move_to(corner)
        yield from stage.key(button)
        yield 0.2
        assert selected() == before
    yield from stage.click(corner)
    yield from stage.click(corner)
    yield from stage.drag([tuple(corner + t * (middle - corner)) for t in np.linspace(0, 1, 8)])
    yield 0.2
    assert selected() == before
    assert operator().current is not None
    start = places()[INDEX_TIP]
    yield from dragged(stage, [(start[0] + 7 * i, start[1] - 2 * i) for i in range(8)])
    yield from stage.key("RIGHT_ARROW")
    yield 0.3
    assert operator().current.shows_detections(0)
    yield from stage.screenshot("elsewhere-hollow")
    yield from stage.undo()
    yield from stage.redo()
    (armature,) = hands()
    assert np.abs(np.array(armature.matrix_world) - np.eye(4)).max() < 1e-5
    yield from ended(stage)
    bpy.context.view_layer.update()
    assert armature.matrix_world == place
    assert not armature.constraints
    yield from stage.undo()
    (armature,) = hands()
    assert armature.matrix_world == place
    assert not armature.constraints


def smoothed(stage, source):
    """The panel's slider turned up by Ctrl and the wheel, undone by one step, and turned farther; what was
    keyed by hand stays."""
    with opened_by_default("MANIENT_PT_refine"):
        yield from stage.open_sidebar()
        yield from capture(stage, source)
        before = _keyed_by_hand(30)
        slider = yield from stage.find_button(".manient_smoothing", along=0.3)
        strengths = [1.0]
        for notches in (3, 6):
            yield from stage.move_to(slider)
            for _ in range(notches):
                yield from stage.key("WHEELUPMOUSE", ctrl=True)
                yield 0.05
            yield from refitted(stage)
            (armature,) = hands()
            strengths.append(armature.manient.smoothing)
            assert len(changed(armature, before)) > len(before) / 2
            keyed = armature.pose.bones.find(KEYED)
            np.testing.assert_allclose(pose_at(armature, 30)[keyed], before[30][keyed], atol=3e-5)
            yield from stage.undo()
            (armature,) = hands()
            assert armature.manient.smoothing == 1.0
            assert changed(armature, before) == []
    assert strengths == sorted(set(strengths))
    assert strengths[-1] <= 3.0


def range_refitted(stage, source):
    """Re-fit Range asks first, and changes nothing before; the wheel widens its range in the dialog."""
    yield from stage.open_sidebar()
    yield from capture(stage, source)
    before = _keyed_by_hand(32, 45)
    bpy.context.scene.frame_set(30)
    (armature,) = hands()
    yield from stage.invoke("manient.refit_range")
    yield 0.5
    refit = part("operators.refit_range")
    said = refit.replaced(bpy.context, *refit.suggested_range(bpy.context))[0]
    # Half a second around frame 30, at 25 frames per second, and one of the two keys set by hand.
    assert said == "Fits 25 frames again. Replaces 1 key set by hand, on 1 frame"
    yield from stage.key("ESC")
    yield 0.3
    assert changed(armature, before) == []
    yield from stage.invoke("manient.refit_range")
    yield 0.5
    # The dialog opens with its field Last under the mouse. A wheel's press and its release are a step each.
    for _ in range(3):
        yield from stage.key("WHEELUPMOUSE", ctrl=True)
        yield 0.1
    yield from stage.key("RET")
    yield from refitted(stage)
    assert {32, 45} <= set(changed(armature, before)) <= set(range(18, 49))
    yield from stage.undo()
    assert changed(hands()[0], before) == []


def _keyed_by_hand(*frames: int) -> dict[int, np.ndarray]:
    """Key a bone otherwise in these frames; all poses of the clip then."""
    (armature,) = hands()
    bone = armature.pose.bones[KEYED]
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        bone.rotation_quaternion = (0.8, 0.1, 0.5, 0.3)
        bone.keyframe_insert("rotation_quaternion", frame=frame)
    bpy.ops.ed.undo_push(message="By hand")
    return {frame: pose_at(armature, frame) for frame in range(1, 61)}


def refitted(stage):
    """Wait for a fit that was asked for."""
    fits = part("operators.refit_range").RangeFitOperator
    yield from stage.until(fits.fitting, 10.0, "the fit to begin")
    yield from stage.until(lambda: not fits.fitting(), WARM, "the fit")
    yield 0.3


def edited(stage, armature, frame):
    """Edit Keypoints of a hand, with a warm worker."""
    bpy.context.view_layer.objects.active = armature
    bpy.context.scene.frame_set(frame)
    yield from stage.invoke("manient.edit_keypoints")
    yield from warmed(stage)


def warmed(stage):
    """Wait until a point can be dragged."""
    yield from stage.until(lambda: places() and not state()["warming"], WARM, "a warm worker")
    yield 0.3


def ended(stage, key="ESC"):
    """Leave Edit Keypoints."""
    yield from stage.key(key)
    yield from stage.until(lambda: operator().current is None, 5.0, "the mode to end")


def dragged(stage, path):
    """Drag the index finger's tip along a path, each step once the hand has followed the one before."""
    (armature, *_) = hands()
    yield from stage.move_to(places()[INDEX_TIP])
    yield 0.1
    yield from stage.hold()
    yield from stage.until(lambda: state()["dragged"] == INDEX_TIP, 3.0, "the point to be taken")
    for point in path:
        pose, sent = _pose_now(armature), time.perf_counter()
        yield from stage.move_to(point)
        while _pose_now(armature) == pose and time.perf_counter() - sent < 2.0:
            yield 0.0
    yield from stage.hold("RELEASE")
    yield from stage.until(lambda: state()["dragged"] is None, 20.0, "the last fit")
    yield 0.3


def operator():
    return part("operators.edit_keypoints").MANIENT_OT_edit_keypoints


def viewport():
    return part("operators.modes.view").viewport_at(bpy.context, operator().current.view.address)


def places() -> dict[int, tuple[float, float]]:
    """Keypoint -> (x, y) of its handle in window pixels, as events have them; empty while none are shown."""
    there = viewport() if operator().current else None
    if there is None:
        return {}
    found = operator().current.region_places(there) + np.array([there.region.x, there.region.y])
    return {k: (float(x), float(y)) for k, (x, y) in enumerate(found) if np.isfinite([x, y]).all()}


def state() -> dict:
    """What is dragged and pinned, and whether the worker is not ready yet."""
    mode = operator().current
    if mode is None:
        return {"dragged": None, "pins": {}, "warming": False}
    row = mode.row()
    return {
        "dragged": mode.drag.keypoint if mode.drag is not None else None,
        "pins": {} if row is None else dict(mode.refiner.pins(row)),
        "warming": bool(mode._warming),
    }


def _pose_now(armature) -> tuple:
    return tuple(v for bone in armature.pose.bones for v in bone.rotation_quaternion)


def _camera_view(stage) -> list:
    view = stage.area().spaces[0].region_3d
    return [view.view_perspective, view.view_camera_zoom, *view.view_camera_offset]


def _handles_and_free() -> tuple[np.ndarray, np.ndarray]:
    """The corners of the box around all handles, and of what is free for them."""
    handles, there = np.array(list(places().values())), viewport()
    return np.stack([handles.min(axis=0), handles.max(axis=0)]), there.free() + [
        there.region.x,
        there.region.y,
    ]


def _is_free(place) -> bool:
    low, high = _handles_and_free()[1]
    return bool((place >= low).all() and (place <= high).all())


def _alphas() -> list:
    """Depth and alpha of each background image of the capture camera."""
    backgrounds = bpy.context.scene.camera.data.background_images
    return [[b.display_depth, round(b.alpha, 3)] for b in backgrounds]
