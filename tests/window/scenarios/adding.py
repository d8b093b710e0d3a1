"""Add Hand: a hand laid into a picture and posed with the mouse."""

from __future__ import annotations

from itertools import pairwise

import bpy
import numpy as np

from scenarios.capturing import hands, mesh_of, part
from scenarios.refine import ended, operator, places, state, viewport, warmed

ORDER = (0, 9, 8, 4, 20, 12)
"""Wrist and knuckle, then tips: index, thumb, little and middle finger"""
SHOWN = 120.0
"""seconds that a cold worker may take to show a picture"""


def in_a_drawing(stage, source, truth):
    """Six points pose a hand in a drawing, whose 21 keypoints are at `truth`."""
    yield from stage.open_sidebar()
    yield from begun(stage, source, "right")
    yield from posed(stage, [(k, truth[k]) for k in ORDER])
    line, _ = operator().current.status_line(viewport())
    assert line == "6 points of the right hand placed"
    landmarks = operator().current.refiner.shown_landmarks()
    size = np.ptp(truth, axis=0).max()
    away = np.linalg.norm(landmarks - truth, axis=1)
    assert away[list(ORDER)].max() < 0.02 * size, "as near as the mouse's whole pixels are"
    assert away.mean() < 0.06 * size, "the others lie where the drawing has them"
    assert sorted(state()["pins"]) == sorted(ORDER)
    yield from stage.undo()
    assert sorted(state()["pins"]) == sorted(ORDER[:-1])
    yield from stage.redo()
    yield from ended(stage, "RET")
    assert [armature.manient.side for armature in hands()] == ["right"]


def by_keys(stage, source):
    """S and P turn the hand that is about to be laid; Esc leaves it out; a click lays an upright one."""
    yield from stage.open_sidebar()
    yield from begun(stage, source, "right")
    yield from stage.move_to(in_window((450, 350)))
    yield 0.2
    yield from stage.key("S")
    yield from stage.key("P")
    yield 0.2
    assert (bpy.context.scene.manient.added_side, mode().seen) == ("left", "palm")
    yield from stage.key("ESC")
    yield from stage.until(lambda: mode() is None, 5.0, "the mode to end")
    assert not hands()
    yield from begun(stage, source, "left")
    yield from stage.click(in_window((450, 450)))
    yield from stage.until(lambda: operator().current is not None, 10.0, "Edit Keypoints")
    yield from warmed(stage)
    wrist, knuckle = operator().current.refiner.shown_landmarks()[[0, 9]]
    assert np.linalg.norm(wrist - (450, 450)) < 3
    np.testing.assert_allclose(knuckle - wrist, (0, -0.12 * 700), atol=1.0)
    yield from ended(stage)
    assert len(hands()) == sum(c.manient.is_capture for c in bpy.data.collections) == 1


def posed(stage, points):
    """Drag from wrist to knuckle, then each point to its place; the hand follows each. `points`:
    (keypoint, (x, y) pixels of the picture), the wrist and the knuckle first."""
    (_, wrist), (_, knuckle), *others = points
    path = [in_window(np.add(wrist, np.subtract(knuckle, wrist) * t)) for t in (0.0, 0.3, 0.7, 1.0)]
    yield from stage.drag(path, pause=0.1)
    yield from stage.until(lambda: operator().current is not None, 10.0, "Edit Keypoints")
    yield from warmed(stage)
    yield from stage.screenshot("add-laid")
    shapes = [mesh_of(hands()[0])]
    for keypoint, place in others:
        start, aim = places()[keypoint], in_window(place)
        path = [np.add(start, np.subtract(aim, start) * t) for t in np.linspace(0, 1, 8)]
        yield from stage.drag(path, pause=0.05)
        yield from stage.until(lambda: state()["dragged"] is None, 20.0, f"point {keypoint} to be fitted")
        yield 0.2
        yield from stage.move_to(stage.region())
        yield 0.1
        shapes.append(mesh_of(hands()[0]))
        yield from stage.screenshot(f"add-point-{keypoint}")
    assert min(np.abs(b - a).max() for a, b in pairwise(shapes)) > 0.002


def begun(stage, source, side):
    """Press Add Hand; the picture is shown where it is not yet."""
    bpy.context.scene.manient.source = source
    bpy.context.scene.manient.added_side = side
    yield 0.5
    yield from stage.invoke("manient.add_hand")
    yield from stage.until(lambda: mode() is not None, SHOWN, "the picture")
    yield 0.5


def mode():
    return part("operators.add_hand").MANIENT_OT_add_hand.current


def in_window(place) -> tuple[float, float]:
    """Pixels of the picture -> of the window, in Add Hand and in Edit Keypoints."""
    now = mode() or operator().current
    there = part("operators.modes.view").viewport_at(bpy.context, now.view.address)
    x, y, w = now.matrix(there) @ [*place, 1.0]
    return float(x / w + there.region.x), float(y / w + there.region.y)
