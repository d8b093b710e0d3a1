"""Hands that are added by hand: to a capture, to a picture in which nothing was looked for, and to a clip."""

from __future__ import annotations

import shutil
from pathlib import Path

import bpy
import numpy as np
import pytest

import blender_manient
from blender_manient.exporters.take import retaken
from blender_manient.scene import corrections
from blender_manient.scene.build import build_take
from blender_manient.scene.store import captured_hands, hand_of
from blender_manient.session import jobs
from blender_manient.session.refiner import Refiner, why_not_refinable
from handfit_core.common.skeleton import SIDES
from handfit_core.take import Take
from tests.capturing import needs_capture

from .conftest import FRAMES, evaluated_vertices

pytestmark = needs_capture
ROOT = Path(__file__).resolve().parents[2]
FRAME = int(FRAMES[0])
WRIST, KNUCKLE = (300.0, 400.0), (310.0, 280.0)


@pytest.fixture(scope="module", autouse=True)
def addon():
    """Registered once: the worker stays warm from test to test."""
    blender_manient.register()
    yield
    blender_manient.unregister()


@pytest.fixture(autouse=True)
def forgotten():
    """Each test begins without another's captures, and without a source."""
    jobs.forget_finished()
    bpy.context.scene.manient.source = ""


@pytest.fixture
def built(make_take):
    """A captured right hand, active, on a frame with it."""
    built = build_take(make_take(sides=("right",)).take)
    bpy.context.view_layer.objects.active = built.hands[0].armature
    bpy.context.scene.frame_set(FRAME)
    return built


def added(side="right", wrist=WRIST, knuckle=KNUCKLE, **more):
    assert bpy.ops.manient.add_hand(side=side, wrist=wrist, knuckle=knuckle, **more) == {"FINISHED"}
    return hand_of(bpy.context.view_layer.objects.active)


def put(hand, keypoint: int, place, frame: int) -> None:
    done = bpy.ops.manient.move_keypoint(
        hand=hand.armature.name, frame=frame, keypoint=keypoint, x=place[0], y=place[1]
    )
    assert done == {"FINISHED"}


def landmarks(armature, frame: int) -> np.ndarray:
    bpy.context.scene.frame_set(frame)
    return Refiner(armature).shown_landmarks()


@pytest.mark.parametrize("side", SIDES)
def test_a_hand_is_added_to_a_capture(built, side):
    hand = added(side)
    assert hand.collection == built.collection
    assert (hand.side, hand.index, len(hand.take.hands)) == (side, 1, 2)
    assert hand.track.added
    assert why_not_refinable(hand.track) is None
    np.testing.assert_allclose(landmarks(hand.armature, FRAME)[[0, 9]], [WRIST, KNUCKLE], atol=0.1)
    assert set(Refiner(hand.armature).pins(0)) == {0, 9}
    assert set(captured_hands(bpy.context.scene)) == {built.hands[0].armature, hand.armature}
    assert hand_of(built.hands[0].armature).track.placed is None


def test_a_picture_is_shown_for_the_hand_alone(tmp_path):
    picture = shutil.copy(ROOT / "samples" / "mona_lisa" / "mona_lisa.jpg", tmp_path)
    bpy.context.scene.manient.source = str(picture)
    hand = added("left")
    assert hand.take.hands == (hand.track,)
    assert hand.take.source.files == (str(picture),)
    (background,) = hand.camera.data.background_images
    assert tuple(background.image.size) == (hand.take.width, hand.take.height)
    assert bpy.context.scene.camera == hand.camera
    # A second one goes into the same picture.
    other = added("right", (150.0, 300.0), (180.0, 220.0))
    assert other.collection == hand.collection
    assert [track.side for track in other.take.hands] == ["left", "right"]


def test_points_pose_it_and_say_whose_they_are(built):
    hand = added("left")
    before = evaluated_vertices(hand.mesh)
    start = landmarks(hand.armature, FRAME)
    places = {8: start[8] + [10.0, 25.0], 20: start[20] + [-5.0, 30.0], 4: start[4] + [8.0, 0.0]}
    for keypoint, place in places.items():
        put(hand, keypoint, place, FRAME)
    after = landmarks(hand.armature, FRAME)
    for keypoint, place in {**places, 0: WRIST, 9: KNUCKLE}.items():
        assert np.linalg.norm(after[keypoint] - place) < 1.0
    assert np.linalg.norm(evaluated_vertices(hand.mesh) - before, axis=1).max() > 0.01

    take = Take.from_bytes(retaken([hand_of(o) for o in (built.hands[0].armature, hand.armature)]).to_bytes())
    captured, kept = take.hands
    assert captured.placed is None
    placed = np.isfinite(kept.placed[..., 0])
    assert list(zip(*np.nonzero(placed), strict=True)) == [(0, k) for k in (0, 4, 8, 9, 20)]

    # Built from that take it has its points again, and goes on being posed by them.
    again = hand_of(build_take(take).hands[1].armature)
    assert again.track.added
    assert set(Refiner(again.armature).pins(0)) == {0, 4, 8, 9, 20}
    np.testing.assert_allclose(landmarks(again.armature, FRAME), after, atol=0.5)


def test_in_a_clip_it_holds_and_gets_further_keys():
    bpy.context.scene.manient.source = str(ROOT / "samples" / "rendered_hand")
    bpy.context.scene.manient.spread = 4
    hand = added("left", (200.0, 300.0), (205.0, 220.0))
    first, last = (int(n) for n in hand.take.frame_numbers[[0, -1]])
    assert last - first > 10
    np.testing.assert_allclose(landmarks(hand.armature, last), landmarks(hand.armature, first), atol=1e-3)
    put(hand, 8, landmarks(hand.armature, first)[8] + [0.0, 20.0], first)
    held = landmarks(hand.armature, first)
    np.testing.assert_allclose(landmarks(hand.armature, last), held, atol=1e-3)
    # The whole hand moves on: wrist and knuckle say where to, and its fingers stay as they were.
    by = np.array([60.0, 10.0])
    for keypoint in (0, 9):
        put(hand, keypoint, held[keypoint] + by, last)
    np.testing.assert_allclose(landmarks(hand.armature, first), held, atol=0.1)
    moved = landmarks(hand.armature, last)
    assert np.linalg.norm(moved[[0, 9]] - held[[0, 9]] - by, axis=1).max() < 1.0
    assert np.linalg.norm(moved - held - by, axis=1).max() < 0.1 * np.ptp(held, axis=0).max()
    between = landmarks(hand.armature, (first + last) // 2)[0]
    assert held[0, 0] < between[0] < moved[0, 0]
    # What is cleared there holds again.
    corrections.clear_corrections(hand.armature, [last])
    np.testing.assert_allclose(landmarks(hand.armature, last), held, atol=0.1)


def test_what_is_missing_is_said(tmp_path):
    for source, said in (("", "Choose a photo"), (str(tmp_path / "gone.jpg"), "not there any more")):
        bpy.context.scene.manient.source = source
        with pytest.raises(RuntimeError, match=said):
            bpy.ops.manient.add_hand(wrist=WRIST, knuckle=KNUCKLE)
    bpy.context.scene.manient.source = str(ROOT / "samples" / "rendered_hand")
    with pytest.raises(RuntimeError, match="drag from its wrist"):
        bpy.ops.manient.add_hand(wrist=WRIST, knuckle=WRIST)
    assert captured_hands(bpy.context.scene) == []
    bpy.context.scene.frame_set(5000)
    with pytest.raises(RuntimeError, match="not in the capture"):
        bpy.ops.manient.add_hand(wrist=WRIST, knuckle=KNUCKLE)
