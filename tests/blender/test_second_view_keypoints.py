"""Keypoints of a take of two views, shown over the second one's picture."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from blender_manient.operators.modes.keypoints import KeypointMode
from blender_manient.panels.result import MANIENT_PT_result
from blender_manient.scene.build import build_take
from blender_manient.session.refiner import Refiner
from handfit_core.edit import from_message
from handfit_core.take import Take
from handfit_core.take.fit_quality import view_errors
from tests.drawn import drawn
from tests.takes import of_two_views, seen_as

from .test_retiming import shown_offset
from .test_two_views import movie, second_of

pytestmark = pytest.mark.usefixtures("registered")

FRAME, TIP = 20, 8


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
    bpy.context.scene.frame_set(FRAME)
    return built.hands[0].armature


def mode_of(armature, looking: int) -> KeypointMode:
    """The mode's state as it is once it has begun, but for what it draws."""
    mode = KeypointMode.__new__(KeypointMode)
    mode.refiner, mode.address, mode.looking = Refiner(armature), 0, looking
    mode.drag, mode.message, mode.done, mode.undone = None, "", 0, 0
    mode._warming, mode._solved_in = 0, 0.0
    mode.view = SimpleNamespace(shows=lambda _: True)
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
        drift = refiner.motion_until(refiner.row_at(frame), row)
        palm = [0, 5, 9, 13, 17]  # whose points lie where the detector has them
        assert np.abs((moved - drift)[palm]).mean() < 3.0
        assert np.abs(drift).max() < 9.0
    assert refiner.row_of_view(first) is None, "it has not begun"
    scene.frame_set(first)
    assert np.isnan(mode_of(built.hands[0].armature, 1).picture_places()).all()


def test_points_are_dragged_in_the_first_view_alone(armature):
    mode = mode_of(armature, 1)
    assert np.isfinite(mode.picture_places()).all()
    viewport = SimpleNamespace(region=SimpleNamespace(x=0, y=0))
    mode.region_places = lambda _: mode.picture_places()
    x, y = mode.picture_places()[TIP]
    assert mode.handle_at(viewport, x, y) is None
    assert mode.status_line(viewport) == ("V: points are dragged in the other view", False)
    mode.looking = 0
    x, y = mode.picture_places()[TIP]
    assert mode.handle_at(viewport, x, y) == TIP


def test_a_range_has_what_both_views_saw(armature):
    refiner = Refiner(armature)
    for mode, wanted in (("range", True), ("each", False)):
        fields = refiner.request([19], [{}], refiner.start_poses([19]), mode)()
        assert (from_message(fields["hand"]).second is not None) == wanted


def test_the_panel_has_an_error_for_each_view(armature, take):
    errors = view_errors(take, take.hands[0])
    assert errors[0] == 0.5
    assert errors[1] < 0.5
    assert f"Error by view: 0.5 px, {errors[1]:.1f} px" in drawn(MANIENT_PT_result).rows
    seen = seen_as(take.hands[0].seen_by[0], keypoints_2d=take.hands[0].seen_by[0].keypoints_2d + [3.0, 4.0])
    wrong = replace(take.hands[0], seen_by=(seen,))
    assert view_errors(take, wrong)[1] == pytest.approx(5.0, abs=0.5)
    assert np.isnan(view_errors(take, replace(wrong, seen_by=(None,)))[1])
