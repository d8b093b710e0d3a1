"""Keypoints of a capture from two cameras, dragged in the second one's picture."""

from __future__ import annotations

import bpy
import numpy as np

from scenarios.capturing import changed, part, pose_at
from scenarios.refine import INDEX_TIP, dragged, edited, ended, operator, places, warmed


def dragged_in_the_second(stage, armature):
    """V shows the other view. A point that is dragged there moves the hand in both views. Undo, Esc and X do
    as in the first view."""
    bpy.context.scene.camera = part("scene.store").hand_of(armature).camera
    bpy.ops.ed.undo_push(message="Camera")
    before = {frame: pose_at(armature, frame) for frame in (5, 20)}
    yield from edited(stage, armature, frame=20)
    first, fitted = places(), _mode().refiner.shown_landmarks(0)
    yield from stage.key("V")
    yield from stage.until(lambda: _mode().looking == 1, 3.0, "the second view")
    yield from warmed(stage)
    second = places()
    assert np.linalg.norm(np.array(second[INDEX_TIP]) - first[INDEX_TIP]) > 20.0
    # The points lie where the picture has them, in the second clip's own frame.
    row, seen = _mode().shown_row(1), _mode().refiner.track.seen_by[0]
    np.testing.assert_array_equal(_mode().picture_places(), seen.keypoints_2d[row])
    yield from stage.screenshot("second_view")
    x, y = second[INDEX_TIP]
    yield from dragged(stage, [(x - 2 * i, y - 3 * i) for i in range(1, 16)])
    assert changed(armature, before) == [20]
    assert list(_mode().pins()) == [INDEX_TIP]
    # A drag begins at the fitted hand's point, which lies a little beside the detected one.
    np.testing.assert_allclose(places()[INDEX_TIP], (x - 30, y - 45), atol=12.0)
    yield from stage.screenshot("second_view_dragged")
    yield from stage.key("V")
    yield from stage.until(lambda: _mode().looking == 0, 3.0, "the first view")
    yield 0.3
    away = np.linalg.norm(_mode().refiner.shown_landmarks(0) - fitted, axis=1)
    assert away[INDEX_TIP] > 2.0
    assert away[[0, 12, 16, 20]].max() < 0.5
    assert _mode().pins() == {}
    yield from stage.screenshot("first_view_after")
    yield from stage.undo()  # back to the second view
    yield from stage.until(lambda: _mode().looking == 1, 3.0, "the second view again")
    assert changed(bpy.context.object, before) == [20]
    yield from stage.undo()
    assert changed(bpy.context.object, before) == []
    yield from _escaped(stage)
    assert changed(bpy.context.object, before) == []
    yield from stage.redo()
    assert changed(bpy.context.object, before) == [20]
    yield from stage.move_to(places()[INDEX_TIP])
    yield 0.2
    yield from stage.key("X")
    yield from stage.until(lambda: not _mode().pins() and _mode().drag is None, 20.0, "the pin to go")
    assert changed(bpy.context.object, before) == []
    yield from ended(stage)
    assert bpy.context.scene.camera.name == "camera of clip1_b"


def _escaped(stage):
    """A drag that Esc takes back."""
    x, y = places()[INDEX_TIP]
    yield from stage.move_to((x, y))
    yield from stage.hold()
    yield from stage.until(lambda: _mode().drag is not None, 3.0, "the point to be taken")
    yield from stage.move_to((x + 30, y + 10))
    yield 0.5
    yield from stage.key("ESC")
    yield from stage.hold("RELEASE")
    yield 0.3
    assert _mode().drag is None


def _mode():
    return operator()._mode
