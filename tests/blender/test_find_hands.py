"""Find Hands without a window: what is asked for, what of it is chosen, and what the capture is told."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_manient.common import preferences
from blender_manient.operators.capture import new_request
from blender_manient.operators.find_hands import MANIENT_OT_find_hands, chosen_source
from blender_manient.operators.modes.choice import FOUND_AGAIN, Choice, FoundHand
from blender_manient.operators.modes.find_hands import FindMode
from blender_manient.operators.modes.view import MAX_ZOOM, PictureView
from blender_manient.panels.capture import MANIENT_PT_capture
from blender_manient.scene.store import captured_hands
from blender_manient.session import jobs, shared_worker
from handfit_core.capturing.options import CaptureOptions
from handfit_core.common.arrays import pack
from handfit_core.common.errors import OptionError
from handfit_core.detect.detector import Region
from handfit_core.geometry.picture_map import mapped
from tests.capturing import needs_capture
from tests.drawn import drawn
from tests.waiting import wait_for

from .conftest import READY

SAMPLE = Path(__file__).resolve().parents[2] / "samples" / "rendered_hand"
SHAPE = np.random.default_rng(3).uniform(-20.0, 20.0, (21, 2))


def answered(x: float, y: float = 100.0, side: str = "right", certainty: float = 0.9) -> dict:
    """A hand as the worker tells of it."""
    return {"side": side, "certainty": certainty, "keypoints": pack(SHAPE + [x, y])}


@pytest.fixture
def choice() -> Choice:
    """A right hand at 100, a left one at 200 and a right one at 300 pixels."""
    made = Choice()
    made.show([answered(100), answered(200, side="left"), answered(300)], "auto")
    return made


def state(choice: Choice) -> list[tuple[int, str, bool]]:
    """Of each hand its place, its side and whether it is chosen."""
    return [(round(float((h.points - SHAPE)[0, 0])), h.side, h.chosen) for h in choice.hands]


def test_the_surest_of_those_that_are_wanted_are_chosen_at_first():
    choice = Choice()
    choice.show([answered(100 * n) for n in range(12)], "auto")
    assert [hand.chosen for hand in choice.hands] == [True] * 10 + [False] * 2
    choice.show([answered(100), answered(200, side="left")], "left")
    assert state(choice) == [(100, "right", False), (200, "left", True)]


def test_each_step_is_taken_back(choice):
    begun = state(choice)
    choice.toggle(choice.hands[0])
    choice.flip_side(choice.hands[1])
    assert state(choice) == [(100, "right", False), (200, "right", True), (300, "right", True)]
    choice.remove(choice.hands[2])
    choice.toggle_all()
    assert state(choice) == [(100, "right", True), (200, "right", True)]
    choice.toggle_all()
    assert not choice.chosen
    assert [choice.undo() for _ in range(6)] == [True] * 5 + [False]
    assert state(choice) == begun


def test_regions_are_of_the_chosen_hands_and_name_sides_that_were_changed(choice):
    choice.toggle(choice.hands[0])
    choice.flip_side(choice.hands[1])
    low, size = SHAPE.min(axis=0), np.ptp(SHAPE, axis=0)
    turned, other = choice.regions(7)
    np.testing.assert_allclose(
        [turned.x, turned.y, turned.width, turned.height], [*(low + [200, 100]), *size]
    )
    assert (turned.frame, turned.side) == (7, "right")
    assert (other.frame, other.side) == (7, None)
    assert {region.frame for region in choice.regions(None)} == {None}


def test_a_hand_of_a_box_is_found_again_by_the_box_and_replaces_what_was_taken_for_it(choice):
    box = (170.0, 70.0, 60.0, 60.0)
    choice.add(FoundHand.of(answered(202, side="left"), drawn=box))
    assert state(choice) == [(100, "right", True), (300, "right", True), (202, "left", True)]
    assert choice.regions(None)[-1] == Region(*box)


def test_what_a_box_shows_again_stays_and_is_said(choice):
    """The search answers with a hand that is shown where the box has nothing better."""
    before, box = state(choice), (170.0, 70.0, 60.0, 60.0)
    assert "Add Hand" in choice.add(FoundHand.of(answered(200, side="left"), drawn=box))
    assert state(choice) == before
    assert not choice.undo()
    assert "better" in choice.add(FoundHand.of(answered(202, side="left"), drawn=box))
    assert choice.add(FoundHand.of(answered(250, side="left"), drawn=box)) == ""
    assert len(choice.hands) == 4


def test_a_box_of_two_pixels_is_not_searched():
    mode = FindMode.__new__(FindMode)
    mode.picture_view, mode.choice, mode.message = PictureView((640, 480)), Choice(), ""
    mode.search_box(np.array([[10.0, 10.0], [12.0, 12.0]]))
    assert mode.message.startswith("The box is too small")


def test_a_worker_that_dies_while_hands_are_looked_for_is_a_sentence(settings, peer):
    settings.source = str(SAMPLE / "hand.0001.jpg")
    preferences.get().python = peer(f"{READY}sys.stdin.readline(); os._exit(3)")
    mode = FindMode.__new__(FindMode)  # without a window to draw in
    mode.source, mode.choice, mode.message = chosen_source(bpy.context), Choice(), ""
    mode._asked, mode._showing, mode._boxes = {}, None, []
    mode._finding = mode._ask()
    end = time.monotonic() + 60.0
    while mode.busy and time.monotonic() < end:
        mode.tick(bpy.context)
        time.sleep(0.005)
    assert mode.message.startswith("The capturing process ended unexpectedly")
    assert not mode.busy


def test_the_hand_that_is_pointed_at(choice):
    first, second, _ = choice.hands
    assert choice.hand_at(np.array([100.0, 100.0]), 1.0, 14.0) is first
    assert choice.hand_at(second.points[8] + [0.0, 3.0], 1.0, 14.0) is second
    assert choice.hand_at(np.array([500.0, 300.0]), 1.0, 14.0) is None
    # Where the picture is small in the view, the mouse need not be as exact.
    assert choice.hand_at(np.array([100.0, 200.0]), 0.1, 14.0) is first


def test_the_picture_fits_and_is_enlarged_where_the_mouse_is():
    picture_view, free = PictureView((400, 200)), (100.0, 50.0, 300.0, 250.0)

    def zoomed(factor: float, times: int) -> float:
        for _ in range(times):
            picture_view.zoom(factor, place, free)
        return picture_view.scale(free)

    corners, place = np.array([[0.0, 0.0], [400.0, 200.0]]), np.array([330.0, 40.0])
    np.testing.assert_allclose(mapped(picture_view.matrix(free), corners), [[100.0, 200.0], [300.0, 100.0]])
    before = mapped(picture_view.matrix(free), place)
    assert zoomed(1.5, 4) == pytest.approx(0.5 * 1.5**4)
    np.testing.assert_allclose(mapped(picture_view.matrix(free), place), before)
    picture_view.move(np.array([10.0, -20.0]), free)
    np.testing.assert_allclose(mapped(picture_view.matrix(free), place), before + [10.0, -20.0])
    assert zoomed(1.5, 40) == pytest.approx(MAX_ZOOM)
    assert zoomed(1 / 1.5, 60) == pytest.approx(0.5), "no smaller than fits"
    picture_view.move(np.array([9e9, 9e9]), free)
    assert mapped(np.linalg.inv(picture_view.matrix(free)), np.array([200.0, 150.0])).min() >= 0.0


@pytest.fixture
def settings(registered):
    return bpy.context.scene.manient


def test_what_is_asked_for_is_the_frame_that_the_scene_shows(settings):
    settings.source, settings.threshold = str(SAMPLE), 0.25
    asked = {}
    for frame in (1, 7, 24, 99):
        bpy.context.scene.frame_set(frame)
        fields = chosen_source(bpy.context).fields()
        asked[frame] = CaptureOptions.of_message(fields["options"])
        assert (len(fields["input"]), asked[frame].threshold) == (24, 0.25)
    assert [str(options.frames) for options in asked.values()] == ["1-1", "7-7", "24-24", "1-1"]
    settings.use_frames, settings.first_frame, settings.last_frame, settings.frame_step = True, 3, 12, 4
    for frame, expected in ((1, 3), (6, 7), (12, 3), (11, 11)):
        bpy.context.scene.frame_set(frame)
        assert chosen_source(bpy.context).frame == expected, frame
    settings.first_frame, settings.last_frame = 30, 40
    with pytest.raises(OptionError, match="none of the source's frames"):
        chosen_source(bpy.context)
    settings.source = str(SAMPLE / "hand.0001.jpg")
    source = chosen_source(bpy.context)
    assert source.frame is None
    box = CaptureOptions.of_message(source.fields((1.0, 2.0, 30.0, 40.0))["options"])
    assert (box.regions, box.only_regions, box.frames) == ((Region(1.0, 2.0, 30.0, 40.0),), True, None)


def test_chosen_hands_are_captured_whatever_the_panel_says_of_hands(settings):
    settings.source, settings.hands = str(SAMPLE / "hand.0001.jpg"), "left"
    regions = (Region(1.0, 2.0, 30.0, 40.0, side="left"), Region(5.0, 6.0, 30.0, 40.0))
    options = new_request(bpy.context, only_frame=False, regions=regions).options
    assert (options.hands, options.regions, options.only_regions) == ("auto", regions, True)
    options = new_request(bpy.context, only_frame=False).options
    assert (options.hands, options.regions, options.only_regions) == ("left", (), False)


def test_the_panel_offers_it_unless_another_program_has_found_them(settings, tmp_path):
    """Its keypoints belong to one source, and go with it."""
    settings.source = str(SAMPLE / "hand.0001.jpg")
    assert "manient.find_hands" in drawn(MANIENT_PT_capture).said
    assert MANIENT_OT_find_hands.poll_reason(bpy.context) in (None, "")
    settings.keypoints = str(tmp_path / "openpose")
    said = drawn(MANIENT_PT_capture).said
    assert not {"manient.find_hands", "manient.add_hand"} & set(said.split())
    with pytest.raises(OptionError, match=r"either regions.* or keypoints"):
        new_request(bpy.context, only_frame=False, regions=(Region(1.0, 2.0, 30.0, 40.0),))
    settings.source = str(SAMPLE / "hand.0002.jpg")
    assert not settings.keypoints
    jobs.submit(new_request(bpy.context, only_frame=False))
    assert "capture is running" in MANIENT_OT_find_hands.poll_reason(bpy.context)
    jobs.cancel_all()


@needs_capture
def test_what_was_found_and_turned_is_built(settings, tmp_path):
    settings.source = str(shutil.copy(SAMPLE / "hand.0007.jpg", tmp_path / "hand.jpg"))
    source, picture = chosen_source(bpy.context), tmp_path / "shown.jpg"
    worker = shared_worker.worker()
    shown = wait_for(worker, worker.submit("find", **source.fields(picture=picture)), timeout=120)
    assert (shown["width"], shown["height"], shown["hands"]) == (640, 480, [])
    assert picture.is_file()
    found = wait_for(worker, worker.submit("find", **source.fields()), timeout=120)
    choice = Choice()
    choice.show(found["hands"], settings.hands)
    ((_, side, chosen),) = state(choice)
    assert (side, chosen) == ("right", True)
    box = tuple(np.add(choice.hands[0].box, [-20.0, -20.0, 40.0, 40.0]).tolist())
    known = [pack(choice.hands[0].points.astype(np.float32))]
    (again,) = wait_for(worker, worker.submit("find", **source.fields(box), known=known), timeout=120)[
        "hands"
    ]
    assert choice.add(FoundHand.of(again, drawn=box)) == FOUND_AGAIN
    choice.flip_side(choice.hands[0])
    regions = (*choice.regions(source.frame), Region(1.0, 1.0, 2.0, 2.0))
    jobs.submit(new_request(bpy.context, only_frame=False, regions=regions))
    (job,) = jobs.run()
    assert job.state == "done", job.result.message
    assert job.result.offer == "add_hand"
    (armature,) = captured_hands(bpy.context.scene)
    assert armature.manient.side == "left"


@needs_capture
def test_a_crowd_is_not_built_where_somebody_can_be_asked(settings, monkeypatch):
    monkeypatch.setattr(jobs, "CROWD", 0)
    settings.source = str(SAMPLE / "hand.0001.jpg")
    jobs.submit(new_request(bpy.context, only_frame=False, ask_if_many=True))
    (job,) = jobs.run()
    assert (job.state, job.result.hands_to_choose, job.result.message) == (
        "cancelled",
        1,
        "1 hands: choose those to build",
    )
    assert not captured_hands(bpy.context.scene)
    assert bpy.ops.manient.capture() == {"FINISHED"}, "scripts cannot be asked"
    assert len(captured_hands(bpy.context.scene)) == 1
