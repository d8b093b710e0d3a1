"""Add Hand: a hand laid into a picture and posed with the mouse."""

from __future__ import annotations

from itertools import pairwise

import bpy
import numpy as np

from scenarios.capturing import hands, part
from scenarios.refine import WARM, operator, places, state

SHOWN = 120.0
"""seconds that a cold worker may take to show a picture"""


def posed(stage, source, side, points, frame=None, shot="add"):
    """Drag from wrist to knuckle, then each point to its place. `points`: (keypoint, (x, y) pixels of the
    picture), the wrist and the knuckle first."""
    yield from stage.open_sidebar()
    yield from begun(stage, source, side, frame)
    yield from stage.screenshot(f"{shot}-begun")
    (_, wrist), (_, knuckle), *others = points
    yield from laid(stage, wrist, knuckle, f"{shot}-laid")
    (armature,) = hands()
    shapes = [_mesh(armature)]
    for keypoint, place in others:
        yield from put(stage, keypoint, place)
        shapes.append(_mesh(armature))
        yield from stage.screenshot(f"{shot}-point-{keypoint}")
    line, _ = operator()._mode.status_line(_viewport(operator()._mode.view.address))
    landmarks = operator()._mode.refiner.shown_landmarks().tolist()
    pins = sorted(state()["pins"])
    yield from stage.undo()
    yield 0.3
    undone = sorted(state()["pins"])
    yield from stage.redo()
    yield 0.3
    yield from stage.key("RET")
    yield from stage.until(lambda: not operator().running(), 5.0, "the mode to end")
    yield 0.5
    yield from stage.screenshot(f"{shot}-done")
    return {
        "side": hands()[0].manient.side,
        "landmarks": landmarks,
        "pins": pins,
        "undone": undone,
        "line": line,
        "moved": [float(np.abs(b - a).max()) for a, b in pairwise(shapes)],
    }


def cancelled(stage, source):
    """Esc takes a drag back, and then leaves; a click lays an upright hand, S and P change it before."""
    yield from stage.open_sidebar()
    yield from begun(stage, source, "right")
    yield from stage.move_to(in_window((450, 350)))
    yield 0.2
    yield from stage.key("S")
    yield from stage.key("P")
    yield 0.2
    yield from stage.screenshot("add-keys")
    answer = {"side": bpy.context.scene.manient.added_side, "seen": mode().seen}
    yield from stage.key("ESC")
    yield from stage.until(lambda: mode() is None, 5.0, "the mode to end")
    answer["cancelled"] = len(hands())
    yield from begun(stage, source, "left")
    yield from stage.click(in_window((450, 450)))
    yield from stage.until(operator().running, 10.0, "Edit Keypoints")
    yield from stage.until(lambda: places() and not state()["warming"], WARM, "a warm worker")
    yield from stage.screenshot("add-clicked")
    answer["upright"] = operator()._mode.refiner.shown_landmarks()[[0, 9]].tolist()
    yield from stage.key("ESC")
    yield from stage.until(lambda: not operator().running(), 5.0, "Edit Keypoints to end")
    captures = sum(c.manient.is_capture for c in bpy.data.collections)
    return {**answer, "captures": captures, "hands": len(hands())}


def begun(stage, source, side, frame=None):
    """Press Add Hand; the picture is shown where it is not yet."""
    bpy.context.scene.manient.source = source
    bpy.context.scene.manient.added_side = side
    yield 0.5
    yield from stage.invoke("manient.add_hand")
    yield from stage.until(lambda: mode() is not None, SHOWN, "the picture")
    if frame is not None:
        bpy.context.scene.frame_set(frame)
    yield 0.5


def laid(stage, wrist, knuckle, shot):
    """Drag from the wrist to the knuckle, and wait for Edit Keypoints."""
    path = [in_window(np.add(wrist, np.subtract(knuckle, wrist) * t)) for t in (0.0, 0.3, 0.7, 1.0)]
    yield from stage.drag(path, pause=0.1)
    yield from stage.until(operator().running, 10.0, "Edit Keypoints")
    yield from stage.until(lambda: places() and not state()["warming"], WARM, "a warm worker")
    yield 0.3
    yield from stage.screenshot(shot)


def put(stage, keypoint, place):
    """Drag a point of the hand to a place in the picture."""
    start, aim = places()[keypoint], in_window(place)
    yield from stage.drag(
        [np.add(start, np.subtract(aim, start) * t) for t in np.linspace(0, 1, 8)], pause=0.05
    )
    yield from stage.until(lambda: state()["dragged"] is None, 20.0, f"point {keypoint} to be fitted")
    yield 0.2
    yield from stage.move_to(stage.region())
    yield 0.1


def mode():
    return part("operators.add_hand")._mode


def in_window(place) -> tuple[float, float]:
    """Pixels of the picture -> of the window, in Add Hand and in Edit Keypoints."""
    now = mode() or operator()._mode
    viewport = _viewport(now.view.address)
    x, y, w = now.matrix(viewport) @ [*place, 1.0]
    return float(x / w + viewport.region.x), float(y / w + viewport.region.y)


def _viewport(address):
    return part("operators.modes.view").viewport_at(bpy.context, address)


def _mesh(armature) -> np.ndarray:
    """(V, 3) where the hand's mesh is seen."""
    shown = armature.manient.mesh.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    places = np.empty(3 * len(shown.vertices), dtype=np.float32)
    shown.vertices.foreach_get("co", places)
    return places.reshape(-1, 3)
