"""Live: hands follow a clip that plays as a camera would, without keys; what is recorded becomes takes."""

from __future__ import annotations

import time
from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_manient.common.blender_versions import assign_action
from blender_manient.operators import live as operators
from blender_manient.panels.live import MANIENT_PT_live
from blender_manient.scene.characters import keep_map
from blender_manient.scene.store import captured_hands, hand_of
from blender_manient.session import jobs, live
from blender_manient.session.live_takes import takes
from handfit_core.common.errors import HandfitError
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.lens import Lens
from handfit_core.media.lenses import MeasuredLens, save_lens
from tests.capturing import needs_capture
from tests.conftest import ROOT
from tests.drawn import drawn
from tests.waiting import alive

from .characters import build_armature, hand_specs, joint_name, map_of
from .conftest import action_curves

pytestmark = [pytest.mark.usefixtures("registered"), needs_capture]


LENS = Lens(Intrinsics(700.0, 700.0, 330.0, 176.0), (-0.1, 0.0, 0.0, 0.0, 0.0), 640, 360)


@pytest.fixture
def settings(samples, tmp_path):
    """The panel's settings, with a clip that shows a right hand as the camera."""
    settings = bpy.context.scene.manient.live
    settings.source = f"file:{samples / 'videos' / 'gestures_long.mp4'}"
    settings.countdown, settings.folder = 0, str(tmp_path / "live")
    settings.left.use = False
    yield settings
    if live.running() is not None:
        live.running().abandon()


@pytest.fixture
def character():
    """A character with a right hand."""
    armature = build_armature(hand_specs("right", np.random.default_rng(3), bend=0.4), "Character")
    keep_map(armature, map_of("right"))
    return armature


def until(session, condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, (session.message, session.error)
        session.step()
        time.sleep(0.005)


def seen(session):
    until(session, lambda: session.hand_states.get("right") == "seen" or session.over)
    assert not session.over, session.error


def ended(session):
    session.stop()
    until(session, lambda: session.over)
    assert not alive(session.worker)


def content():
    """Names of what is in the file, and every pose bone's channels."""
    poses = {
        (o.name, b.name): [
            tuple(getattr(b, kind))
            for kind in ("rotation_quaternion", "rotation_euler", "rotation_axis_angle", "location")
        ]
        for o in bpy.data.objects
        if o.pose is not None
        for b in o.pose.bones
    }
    blocks = (bpy.data.objects, bpy.data.collections, bpy.data.meshes, bpy.data.materials, bpy.data.actions)
    return [sorted(b.name for b in kind) for kind in blocks], poses


def record(session, seconds=1.2, *, by_stop=False):
    """Record so many seconds of what is shown; returns the take, which waits to be captured."""
    session.toggle_recording()
    until(session, lambda: session._recording is not None and session._recording.seconds >= seconds)
    session.stop() if by_stop else session.toggle_recording()
    until(session, lambda: session.recorded)
    (take,) = session.recorded
    operators.queue_recorded(bpy.context, session)
    return take


@pytest.mark.parametrize("onto", ["open hand", "character"])
def test_hands_follow_without_keys_and_nothing_stays(settings, character, onto):
    if onto == "character":
        settings.right.character = character
    bpy.context.view_layer.update()
    before = content()
    session = operators.start(bpy.context)
    seen(session)
    shown = content()
    assert shown[1] != before[1]
    assert bpy.data.actions[:] == []
    bpy.context.scene.frame_set(5)
    assert content()[1] == shown[1]
    ended(session)
    assert content() == before


@pytest.mark.parametrize(
    "onto", ["open hand", pytest.param("character", marks=pytest.mark.slow), "moved character"]
)
def test_a_recording_is_a_preview_then_a_take(settings, character, onto):
    """Takes its time: a worker starts, records and captures."""
    before = bpy.data.actions.new("body")
    if onto != "open hand":
        settings.right.character = character
        assign_action(character, before)
    character.manient.character.wrist = "PLACED" if onto == "moved character" else "FINGERS"
    bpy.context.scene.frame_set(11)
    session = operators.start(bpy.context)
    seen(session)
    take = record(session, by_stop=onto == "open hand")
    assert not take.trouble
    (preview,) = set(bpy.data.actions) - {before}
    ended(session)
    if onto != "open hand":  # what the artist keys meanwhile on other frames stays
        for curve in action_curves(preview):
            curve.keyframe_points.insert(500, 0.5)
    (job,) = jobs.run()
    assert job.state == "done", job.result.message
    hand = hand_of(captured_hands(bpy.context.scene)[0])
    assert hand.side == "right"
    keyed = min(
        key.co[0]
        for curve in action_curves(hand.armature.animation_data.action)
        for key in curve.keyframe_points
    )
    assert keyed == 11
    assert take.path.exists()
    assert take.take_path.exists()
    own = {before.name, hand.armature.animation_data.action.name}
    if onto != "open hand":
        assert character.animation_data.action == preview
        bones = {c.data_path.split('"')[1] for c in action_curves(preview)}
        first = 0 if onto == "moved character" else 1
        assert bones == {joint_name(j, "right") for j in range(first, 16)}
        own |= {preview.name}
        assert {c.keyframe_points[-1].co[0] for c in action_curves(preview)} == {500.0}
    assert {a.name for a in bpy.data.actions} == own
    take.throw_away()
    assert not take.path.exists()
    assert not take.take_path.exists()
    assert bpy.data.actions[:] == [before]
    if onto != "open hand":
        assert character.animation_data.action == before
        assert not character.animation_data.nla_tracks
    assert takes == []


def test_a_moved_hand_is_keyed_as_it_was_shown(settings, character):
    settings.right.character = character
    character.manient.character.wrist = "PLACED"
    hand = character.pose.bones[joint_name(0, "right")]
    session = operators.start(bpy.context)
    seen(session)
    start = hand.matrix_basis.copy()
    assert np.allclose(start, np.eye(4), atol=1e-5)  # it begins where the character's hand is
    session.toggle_recording()
    until(session, lambda: session._recording is not None and len(session._recording.poses) > 20)
    last = hand.matrix_basis.copy()
    took = session._recording.poses[-1][0] - session._recording.poses[0][0]
    session.stop()
    until(session, lambda: session.over)
    assert (last.to_translation() - start.to_translation()).length > 1e-3
    bpy.context.scene.frame_set(1 + round(took * 24.0))
    assert np.abs(np.array(hand.matrix_basis) - np.array(last)).max() < 0.05


@pytest.mark.slow
def test_takes_of_the_run_are_hidden_while_hands_follow(settings):
    session = operators.start(bpy.context)
    seen(session)
    take = record(session)
    (preview,) = take.collections
    until(session, lambda: preview.hide_viewport)
    assert "hidden" in drawn(MANIENT_PT_live).said
    preview.hide_viewport = False  # the artist looks at it
    count = session._sequence
    until(session, lambda: session._sequence > count + 3)
    assert not preview.hide_viewport
    (job,) = jobs.run()
    assert job.state == "done", job.result.message
    until(session, lambda: take.collections[0].hide_viewport)
    ended(session)
    assert not take.collections[0].hide_viewport


@pytest.mark.slow
def test_the_measured_lens_counts_live_and_in_the_take(settings, tmp_path, monkeypatch):
    monkeypatch.setenv("HANDFIT_DATA", str(tmp_path / "data"))
    save_lens("webcam", MeasuredLens(LENS, 0.2, 1.0, 20))
    bpy.context.scene.manient.camera, bpy.context.scene.manient.measured_lens = "LENS", "webcam"
    session = operators.start(bpy.context)
    assert session.options.lens == LENS
    seen(session)
    record(session, 0.5, by_stop=True)
    until(session, lambda: session.over)
    (job,) = jobs.run()
    assert job.state == "done", job.result.message
    seen_by = hand_of(captured_hands(bpy.context.scene)[0]).take.intrinsics
    assert seen_by == LENS.scaled(1280, 720).intrinsics


def test_a_snapshot_keys_one_pose(settings, character):
    settings.right.character = character
    bpy.context.scene.frame_set(7)
    session = operators.start(bpy.context)
    seen(session)
    session.snapshot()
    frames = {k.co[0] for c in action_curves(character.animation_data.action) for k in c.keyframe_points}
    assert frames == {7.0}
    ended(session)


@pytest.mark.parametrize(
    ("source", "word"),
    [
        ("99", "camera 99"),
        ("file:/nowhere.mp4", "nowhere"),
        ("http://192.0.2.1/video", "Allow Online Access"),
        ("no such camera", "no live source"),
    ],
)
def test_a_source_that_cannot_be_opened_is_a_sentence(settings, source, word, monkeypatch):
    settings.source = source
    session = operators.start(bpy.context)
    until(session, lambda: session.over)
    assert isinstance(session.error, HandfitError)
    assert word in str(session.error)
    assert not alive(session.worker)


def test_an_address_that_does_not_answer_is_a_sentence_until_stop(settings):
    settings.source = "http://127.0.0.1:9/video"
    session = operators.start(bpy.context)
    until(session, lambda: "does not answer" in session.message)
    assert session.message in drawn(MANIENT_PT_live).said
    ended(session)


def test_the_panel_tells_how_it_goes(settings):
    assert "manient.live" in drawn(MANIENT_PT_live).rows
    session = operators.start(bpy.context)
    seen(session)
    page = drawn(MANIENT_PT_live)
    assert "source" in page.grey
    assert not {"countdown", "play", "folder"} & set(page.grey)
    assert "manient.live_stop" in page.rows
    assert {"Record", "manient.live_snapshot"} <= set(page.rows) - set(page.grey)
    assert "fps" in page.said
    assert "Right: seen" in page.said
    session.toggle_recording()
    assert "Stop Recording" in drawn(MANIENT_PT_live).rows
    session.toggle_recording()
    ended(session)
    settings.left.use = settings.right.use = False
    with pytest.raises(HandfitError, match="which hand"):
        operators.start(bpy.context)


def test_a_file_that_is_saved_meanwhile_holds_no_live_hand(settings, tmp_path):
    session = operators.start(bpy.context)
    seen(session)
    path = str(tmp_path / "saved.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    seen(session)
    bpy.ops.wm.open_mainfile(filepath=path)
    assert session.over
    assert not alive(session.worker)
    assert not bpy.data.objects


def test_a_file_begins_again_at_its_end(settings):
    settings.source = f"file:{ROOT / 'samples' / 'rendered_hand' / 'hand.%04d.jpg'}"  # 24 pictures
    session = operators.start(bpy.context)
    until(session, lambda: session._sequence > 30 or session.over)
    assert not session.over
    ended(session)


@pytest.mark.slow
def test_a_killed_worker_keeps_what_was_recorded(settings):
    session = operators.start(bpy.context)
    seen(session)
    session.toggle_recording()
    until(session, lambda: session._recording is not None and len(session._recording.poses) > 10)
    session.worker._child.kill()
    until(session, lambda: session.over)
    assert session.error is not None
    (take,) = takes
    assert Path(take.path).stat().st_size > 0
    operators.queue_recorded(bpy.context, session)
    (job,) = jobs.run()
    assert job.state == "done", job.result.message
