"""The error over time as the time editors draw it: from the take, beside all animation."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from blender_manient.scene.confidence import colors_of, errors_of
from blender_manient.scene.store import hand_of
from blender_manient.session import error_graph
from handfit_core.fit_quality import EXPECTED, IN_PICTURE, relative_errors

from .conftest import FRAMES, UNSEEN

pytestmark = pytest.mark.usefixtures("registered")

POOR = IN_PICTURE.levels[-1]


def test_errors_are_the_takes_own_in_parts_of_the_hand(make_take):
    take = make_take(sides=("right",)).take
    errors = relative_errors(take.hands[0], take.intrinsics)
    assert np.isnan(errors).tolist() == [row == UNSEEN for row in range(len(FRAMES))]
    # Pixels over the length of the middle finger and the palm, as the camera sees it at their mean depth.
    joints = take.hands[0].joints_3d
    finger = joints[:, [0, 9, 10, 11, 12]]
    metres = sum(np.linalg.norm(finger[:, i + 1] - finger[:, i], axis=-1) for i in range(4))
    pixels = metres * take.intrinsics.fx / joints[..., 2].mean(axis=-1)
    np.testing.assert_allclose(errors * pixels, take.hands[0].reprojection_error, rtol=1e-6)


def test_its_colors_are_the_panels_words():
    green, yellow, red = colors_of(np.array([0.0, 1.0, 9.0]), (0.5, 1.0, 2.0))
    for scale in (IN_PICTURE, EXPECTED):
        steps = np.array([0.9 * scale.good_below, scale.fair_below, 2 * scale.fair_below])
        np.testing.assert_allclose(colors_of(steps, scale.levels), [green, yellow, red])


def test_lines_lie_over_their_frames_and_leave_gaps_open():
    frames = np.array([0.0, 10.0, 20.0, 30.0, 40.0])
    errors = np.array([0.0, POOR / 2, np.nan, POOR / 4, 2 * POOR])
    lines, values = error_graph.segments(frames, errors, (-10.0, 90.0), (1000.0, 80.0), 2 * POOR)
    np.testing.assert_allclose(lines, [[[100, 0], [200, 20]], [[400, 10], [500, 80]]])
    np.testing.assert_allclose(values, [[0.0, POOR / 2], [POOR / 4, 2 * POOR]])
    assert len(error_graph.segments(frames, errors, (50.0, 90.0), (1000.0, 80.0), POOR)[0]) == 0


def test_it_is_shown_for_hands_that_were_detected_and_follows_copies(armature):
    scene = bpy.context.scene
    assert error_graph.shown_hands(scene) == []
    armature.manient.show_error = True
    bpy.context.view_layer.objects.active = armature
    bpy.ops.manient.mirror_hand()
    twin = armature.copy()
    scene.collection.objects.link(twin)
    for obj in scene.objects:
        obj.manient.show_error = True
    shown = [hand.armature for hand in error_graph.shown_hands(scene)]
    assert set(shown) == {armature, twin}, "nothing was measured on the mirrored hand"
    assert armature.animation_data.action == twin.animation_data.action


def test_its_words_name_the_error_here_and_the_largest(armature):
    hand = hand_of(armature)
    errors = errors_of(hand)
    assert errors_of(hand) is errors, "not anew in every redraw"
    said = error_graph.label(hand, errors, float(FRAMES[2]))
    here, most = errors.frames[2], np.nanmax(errors.frames)
    assert f"error {100 * here:.1f} % of the hand here, {100 * most:.1f} % of the hand at most" in said
    assert "here" not in error_graph.label(hand, errors, float(FRAMES[UNSEEN]))
    assert "here" not in error_graph.label(hand, errors, 1000.0)


def test_editors_look_for_hands_only_while_one_is_shown(armature, tmp_path):
    """In every redraw they look through the whole scene."""
    assert not error_graph._handles
    bpy.ops.ed.undo_push(message="before")
    armature.manient.show_error = True
    bpy.ops.ed.undo_push(message="shown")
    assert set(error_graph._handles) == set(error_graph._SPACES.values())
    bpy.ops.ed.undo()
    assert not error_graph._handles
    bpy.ops.ed.redo()
    assert error_graph._handles
    path = str(tmp_path / "shown.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert not error_graph._handles
    bpy.ops.wm.open_mainfile(filepath=path)
    assert error_graph._handles
    for obj in bpy.data.objects:
        obj.manient.show_error = False
    assert not error_graph._handles


def test_switching_it_on_changes_no_animation(armature, tmp_path):
    def animation():
        action = armature.animation_data.action
        return action.name, len(bpy.data.actions), sorted(armature.keys())

    before = animation()
    armature.manient.show_error = True
    assert animation() == before
    assert "reprojection_error_px" not in armature
    # It comes with a hand that is appended to another file.
    path, name = str(tmp_path / "hand.blend"), armature.name
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(path) as (_, into):
        into.objects = [name]
    bpy.context.scene.collection.objects.link(into.objects[0])
    (hand,) = error_graph.shown_hands(bpy.context.scene)
    assert hand.armature == into.objects[0]
