"""Nothing moves under the mouse: rows are kept for what arrives, and buttons swap places slowly."""

from __future__ import annotations

import shutil
import textwrap
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest

from blender_manient.operators import add_hand
from blender_manient.operators.base import ModalState
from blender_manient.operators.capture import new_job
from blender_manient.operators.modes import find_hands as find_mode
from blender_manient.operators.modes.find_hands import row_of
from blender_manient.operators.refit_range import MANIENT_OT_refit_range
from blender_manient.panels import steady
from blender_manient.panels.capture import MANIENT_PT_capture
from blender_manient.panels.refine import MANIENT_PT_refine
from blender_manient.panels.source import MANIENT_PT_source
from blender_manient.scene.build import build_take
from blender_manient.session import jobs, source_info
from tests.drawn import drawn
from tests.takes import correctable

SAMPLE = Path(__file__).resolve().parents[2] / "samples" / "rendered_hand"
BUTTONS = ("Capture", "manient.find_hands", "Capture Frame 1", "manient.add_hand")


@pytest.fixture
def settings(registered):
    yield bpy.context.scene.manient
    jobs.abandon()


@pytest.fixture
def clock(monkeypatch) -> SimpleNamespace:
    """Time that stands still until `now` is changed."""
    made = SimpleNamespace(now=100.0)
    made.monotonic = lambda: made.now
    monkeypatch.setattr(steady, "time", made)
    return made


@pytest.mark.parametrize("kind", ["photo", "sequence", "video", "data"])
@pytest.mark.parametrize("matching", ["AUTO", "MATCH", "KEEP"])
def test_rows_stay_when_the_worker_answers(settings, tmp_path, kind, matching, monkeypatch):
    # As narrow as a sidebar: no window tells here how wide letters are.
    monkeypatch.setattr(
        "blender_manient.common.section.wrapped", lambda text, _: textwrap.wrap(text, 28) or [""]
    )
    path, settings.matching = SAMPLE, matching
    if kind != "sequence":  # nobody reads what is in it
        name = {"photo": "photo.jpg", "video": "clip.mp4", "data": "poses.smplx.npz"}[kind]
        path = shutil.copy(SAMPLE / "hand.0001.jpg", tmp_path / name)
    settings.source = str(path)
    info = source_info.of(settings)
    assert info.files.kind == kind
    found = []
    times = {} if kind == "photo" else {"frames": 325, "fps": 25.0, "last": 325}
    problem = {"width": 0, "problem": "It cannot be read: mend it"}
    for news in ({}, {"width": 640, "height": 480, **times}, problem):
        vars(info).update(news)
        pages = [drawn(section).rows for section in (MANIENT_PT_source, MANIENT_PT_capture)]
        buttons = [pages[1].index(name) for name in BUTTONS if name in pages[1]]
        found.append([*map(len, pages), *buttons])
    assert len(buttons) == {"photo": 3, "data": 2}.get(kind, 4)
    assert found[0] == found[1]
    # A problem may say more than there was.
    assert found[2][1:] == found[0][1:]


@pytest.mark.parametrize(("button", "name"), [("capture", 0), ("frame", 2), ("add", 3)])
def test_what_stops_a_capture_stands_where_it_was_started(settings, clock, button, name):
    settings.source = str(SAMPLE)
    before = drawn(MANIENT_PT_capture)
    assert [n for n in BUTTONS if n in before.grey] == []
    job = new_job(bpy.context, only_frame=button == "frame", bare=button == "add")
    assert job.button == button
    jobs.submit(job)
    page = drawn(MANIENT_PT_capture)
    here = before.rows.index(BUTTONS[name])
    assert page.rows[: here + 1] == [*before.rows[:here], "Stop"]
    assert page.rows.count("Stop") == 1
    for later, grey in ((0.0, True), (0.3, True), (0.4, False)):  # a double click would stop it
        clock.now += later
        assert ("Stop" in drawn(MANIENT_PT_capture).grey) == grey
    jobs.cancel(job)
    assert drawn(MANIENT_PT_capture).rows[here] == BUTTONS[name]
    for later, grey in ((0.0, True), (0.7, False)):  # a click on Stop that comes late would begin it again
        clock.now += later
        assert (BUTTONS[name] in drawn(MANIENT_PT_capture).grey) == grey


def test_a_capture_is_stopped_once_and_what_is_finished_stays(settings, clock):
    settings.source = str(SAMPLE)
    job = new_job(bpy.context, only_frame=False)
    jobs.submit(job)
    for state, said in (("capturing", "Stop"), ("capturing", "Stopping"), ("building", "Building Hands")):
        vars(job).update(state=state, _stopping=said != "Stop")
        drawn(MANIENT_PT_capture)
        clock.now += 10.0
        page = drawn(MANIENT_PT_capture)
        assert said in page.rows
        assert (said in page.grey) == (said != "Stop")
    job.state = "done"


def test_a_double_click_captures_once_and_another_source_queues(settings):
    settings.source = str(SAMPLE)
    jobs.submit(new_job(bpy.context, only_frame=False))
    assert jobs.is_repeated(new_job(bpy.context, only_frame=False))
    assert not jobs.is_repeated(new_job(bpy.context, only_frame=True))
    assert "Add to Queue" in drawn(MANIENT_PT_capture).rows
    settings.source = str(SAMPLE / "hand.0001.jpg")
    assert not jobs.is_repeated(new_job(bpy.context, only_frame=False))
    jobs.cancel_all()
    settings.source = str(SAMPLE)
    assert not jobs.is_repeated(new_job(bpy.context, only_frame=False))


def test_rows_stay_while_hands_are_chosen_and_added(settings, clock, monkeypatch):
    settings.source = str(SAMPLE)
    before = drawn(MANIENT_PT_capture).rows
    places = [before.index(name) for name in BUTTONS]
    monkeypatch.setattr(find_mode, "current", SimpleNamespace(choice=SimpleNamespace(chosen=())))
    page = drawn(MANIENT_PT_capture)
    assert [page.rows[place] for place in places] == ["Capture 0 Hands", "Leave Find Hands", *BUTTONS[2:]]
    assert {"Leave Find Hands", *BUTTONS[2:]} <= set(page.grey)
    clock.now += 0.7
    assert "Leave Find Hands" not in drawn(MANIENT_PT_capture).grey
    monkeypatch.setattr(find_mode, "current", None)
    monkeypatch.setattr(add_hand, "_mode", object())
    page = drawn(MANIENT_PT_capture)
    assert [page.rows[place] for place in places] == [*BUTTONS[:3], "manient.leave"]


def test_the_buttons_over_the_picture_stay(monkeypatch):
    monkeypatch.setattr("blender_manient.operators.modes.find_hands.ui_scale", lambda: 1.0)
    free = (0.0, 0.0, 900.0, 600.0)
    capture, leave, add = ("capture", "Capture 12 Hands"), ("leave", "Leave"), ("add", "Add Hand")
    alone, full = row_of(None, leave, None, free), row_of(capture, leave, add, free)
    assert [b.name for b in sorted(full, key=lambda b: b.box)] == ["capture", "leave", "add"]
    assert alone[0] == full[0]
    assert row_of(None, leave, add, free)[1] == full[2]
    assert max(b.box[0] for b in full if b.name != "capture") > full[1].box[2]


@pytest.fixture
def hand(make_take, registered):
    armature = build_take(correctable(make_take(sides=("right",)).take)).hands[0].armature
    bpy.context.view_layer.objects.active = armature
    return armature


@pytest.mark.parametrize("operator", ["manient.refit_range", "manient.touch"])
def test_a_fit_is_stopped_where_it_was_begun(hand, clock, monkeypatch, operator):
    before, running = drawn(MANIENT_PT_refine).rows, MANIENT_OT_refit_range.running
    here = before.index(operator)
    monkeypatch.setitem(running, operator, ModalState())
    page = drawn(MANIENT_PT_refine)
    assert page.rows == [*before[:here], "Stop", *before[here + 1 :]]
    assert "Stop" in page.grey
    clock.now += 0.7
    assert "Stop" not in drawn(MANIENT_PT_refine).grey
    assert bpy.ops.manient.leave(what="FIT") == {"FINISHED"}
    assert running[operator].stopped
    assert "Stop" in drawn(MANIENT_PT_refine).grey
    del running[operator]
    with pytest.raises(RuntimeError, match="Nothing is under way"):
        bpy.ops.manient.leave(what="FIT")


def test_the_refine_section_and_the_dialog_of_a_range_keep_their_rows(hand, settings):
    before = drawn(MANIENT_PT_refine).rows
    settings.source = str(SAMPLE)
    jobs.submit(new_job(bpy.context, only_frame=False))
    assert drawn(MANIENT_PT_refine).rows == before
    ranges = ((1, 1), (3, 9), (500, 600))
    pages = [drawn(MANIENT_OT_refit_range, first=first, last=last).rows for first, last in ranges]
    assert len({len(page) for page in pages}) == 1
