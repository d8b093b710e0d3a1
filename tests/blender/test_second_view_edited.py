"""Keypoints of a take of two views, corrected in the second one's picture."""

from __future__ import annotations

import time
from dataclasses import replace
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from blender_manient.exporters.take import retaken
from blender_manient.operators.modes.keypoints import KeypointMode
from blender_manient.panels.result import MANIENT_PT_result
from blender_manient.scene import corrections
from blender_manient.scene.build import build_take
from blender_manient.scene.store import hand_of
from blender_manient.session.refiner import Refiner
from handfit_core.take import Take
from handfit_core.take.fit_quality import view_errors
from tests.drawn import drawn
from tests.takes import of_two_views

from .test_retiming import shown_offset
from .test_two_views import movie, second_of

pytestmark = pytest.mark.usefixtures("registered")

FRAME, TIP = 20, 8
AWAY = np.array([14.0, 10.0])
"""pixels"""


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    folder = tmp_path_factory.mktemp("clips")
    return tuple(movie(folder / name, (640, 480), rate) for name, rate in (("a.avi", 30.0), ("b.avi", 25.0)))


@pytest.fixture
def take(clips) -> Take:
    return of_two_views(clips)


@pytest.fixture
def armature(take):
    built = build_take(take)
    bpy.context.view_layer.objects.active = built.hands[0].armature
    bpy.context.scene.manient.spread = 4
    bpy.context.scene.frame_set(FRAME)
    return built.hands[0].armature


def mode_of(armature, looking: int) -> KeypointMode:
    """The mode's state as it is once it has begun, but for what it draws."""
    mode = KeypointMode.__new__(KeypointMode)
    mode.refiner, mode.address, mode.looking = Refiner(armature), 0, looking
    mode.drag, mode.message, mode.done, mode.undone = None, "", 0, 0
    mode._warming, mode._solved_in = 0, 0.0
    mode.view = SimpleNamespace(shows=lambda _: False)
    mode._frame, mode._places = bpy.context.scene.frame_current_final, mode.picture_places()
    return mode


@pytest.mark.parametrize("rate", [30, 24, 25])
def test_the_picture_that_is_shown_is_the_one_that_is_edited(take, rate):
    scene = bpy.context.scene
    scene.render.fps, scene.render.fps_base = rate, 1.0
    scene.frame_set(100)
    built = build_take(take, match_scene=rate == 30)
    refiner, numbers = Refiner(built.hands[0].armature), take.cameras.views[0].frame_numbers
    first = round(float(refiner.scene_frames()[0]))
    for frame in range(first + 6, first + 24):
        row = refiner.row_of_view(frame)
        assert row is not None
        assert numbers[row] == shown_offset(second_of(built), frame)
        mode = mode_of(built.hands[0].armature, 1)
        np.testing.assert_array_equal(mode.picture_places(), take.hands[0].seen_by[0].keypoints_2d[row])
        moved = mode.picture_places() - refiner.shown_landmarks(1)
        drift = refiner.drift(refiner.row_at(frame), row)
        palm = [0, 5, 9, 13, 17]  # whose points lie where the detector has them
        assert np.abs((moved - drift)[palm]).mean() < 3.0
        assert np.abs(drift).max() < 9.0
    assert refiner.row_of_view(first) is None, "it has not begun"
    scene.frame_set(first)
    assert np.isnan(mode_of(built.hands[0].armature, 1).picture_places()).all()


def moved_to(armature, place, **options) -> None:
    args = {"hand": armature.name, "frame": FRAME, "keypoint": TIP, "second": True}
    assert bpy.ops.manient.move_keypoint(**args, x=place[0], y=place[1], **options) == {"FINISHED"}


def test_a_point_of_the_second_view_moves_the_hand_in_both(armature, take, tmp_path):
    mode, before = mode_of(armature, 1), Refiner(armature).shown_landmarks(0)
    place = mode.picture_places()[TIP] + AWAY
    moved_to(armature, place)
    mode = mode_of(armature, 1)
    np.testing.assert_allclose(mode.pins()[TIP], place, atol=1e-2)
    assert mode.pins(0) == {}
    there = mode.refiner.shown_landmarks(1) + mode._drift(mode.row(), 1)
    assert np.linalg.norm(there[TIP] - place) < 1.0
    moved = np.linalg.norm(mode.refiner.shown_landmarks(0) - before, axis=1)
    assert moved[TIP] > 2.0
    assert moved[[0, 12, 16, 20]].max() < 0.5
    again = retaken([hand_of(armature)])
    pins = again.hands[0].placed_second
    np.testing.assert_allclose(pins[FRAME - 1, TIP], place - mode._drift(mode.row(), 1)[TIP], atol=1e-2)
    assert np.isfinite(pins).sum() == 2
    assert again.hands[0].placed is None
    kept = Take.load(again.save(tmp_path / "again.take.npz"))
    other = build_take(kept).hands[0].armature
    assert set(Refiner(other).pins(FRAME - 1, 1)) == {TIP}
    bpy.context.scene.frame_set(FRAME)
    moved_to(armature, place, remove=True)
    assert corrections.corrections_of(armature).corrected == []
    np.testing.assert_allclose(Refiner(armature).shown_landmarks(0), before, atol=1e-3)


def test_a_range_keeps_what_both_views_say(armature):
    place = mode_of(armature, 1).picture_places()[TIP] + AWAY
    moved_to(armature, place)
    bpy.ops.manient.refit_range(scope="CUSTOM", first=FRAME - 5, last=FRAME + 5)
    mode = mode_of(armature, 1)
    assert TIP in mode.pins()
    bpy.context.scene.frame_set(FRAME)
    there = mode.refiner.shown_landmarks(1) + mode._drift(mode.row(), 1)
    assert np.linalg.norm(there[TIP] - place) < 2.0


def test_a_drag_in_the_second_view(armature):
    """The hand follows a dragged point, goes back when the drag is cancelled, and is kept on release."""
    mode = mode_of(armature, 1)
    before, place = mode.refiner.shown_landmarks(0), mode.picture_places()[TIP] + AWAY

    def dragged() -> None:
        mode.drag = mode._new_drag(TIP, mode.row())
        mode.drag.place, mode.drag.moved = place, True
        until(lambda: not (mode.drag.waiting or mode.drag.needs_request))

    def until(there) -> None:
        deadline = time.monotonic() + 120.0
        while not there() and time.monotonic() < deadline:
            mode.tick(bpy.context)
            time.sleep(0.005)
        assert there()

    dragged()
    assert np.linalg.norm(mode.refiner.shown_landmarks(0) - before, axis=1)[TIP] > 2.0
    mode.cancel_drag(bpy.context)
    np.testing.assert_allclose(mode.refiner.shown_landmarks(0), before, atol=1e-3)
    dragged()
    mode.release()
    until(lambda: mode.drag is None)
    assert mode.done == 1
    np.testing.assert_allclose(mode.pins()[TIP], place, atol=1e-2)
    assert mode.unpin(TIP)
    until(lambda: mode.drag is None)
    assert mode.pins() == {}
    np.testing.assert_allclose(mode.refiner.shown_landmarks(0), before, atol=1e-3)


def test_the_panel_has_an_error_for_each_view(armature, take):
    errors = view_errors(take, take.hands[0])
    assert errors[0] == 0.5
    assert errors[1] < 0.5
    assert f"Error by view: 0.5 px, {errors[1]:.1f} px" in drawn(MANIENT_PT_result).rows
    seen = replace(take.hands[0].seen_by[0], keypoints_2d=take.hands[0].seen_by[0].keypoints_2d + [3.0, 4.0])
    wrong = replace(take.hands[0], seen_by=(seen,))
    assert view_errors(take, wrong)[1] == pytest.approx(5.0, abs=0.5)
    assert np.isnan(view_errors(take, replace(wrong, seen_by=(None,)))[1])
