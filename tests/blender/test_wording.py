"""Names and sentences as people read them, and the names of what a capture builds."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from blender_manient.common.block_reference import BlockReference
from blender_manient.common.wording import (
    NAME_BYTES,
    capitalised,
    headline,
    named_after,
    shortened,
    shortened_name,
    without_name,
)
from blender_manient.modules import MODULES
from blender_manient.operators.housekeeping import MANIENT_OT_note
from blender_manient.operators.review import MANIENT_OT_jump_worst
from blender_manient.panels.advanced import MANIENT_PT_advanced
from blender_manient.panels.capture import MANIENT_PT_capture
from blender_manient.panels.refine import MANIENT_PT_refine
from blender_manient.panels.result import MANIENT_PT_result
from blender_manient.scene import store
from blender_manient.scene.build import build_take
from blender_manient.scene.store import active_hand
from blender_manient.session import jobs, refiner, source_info
from blender_manient.session.jobs import Building, CaptureRequest, CaptureResult, Job
from handfit_core.capturing.options import CaptureOptions
from handfit_core.media.source import Source
from handfit_core.take.fit_quality import relative_errors
from tests.drawn import drawn

LONG = "entrevista con la señora Muñoz en el taller, segunda toma, cámara B, mano izquierda"


@pytest.mark.parametrize(
    ("sentence", "shown"),
    [
        ("no hand was found", "No hand was found"),
        ("clip.mp4: no frame could be read", "clip.mp4: no frame could be read"),
        ("shots/a: no pictures in this folder", "shots/a: no pictures in this folder"),
        ("hand.%04d.png names no file", "hand.%04d.png names no file"),
        ("the file clip.mp4: it is gone", "the file clip.mp4: it is gone"),
        ("", ""),
    ],
)
def test_a_sentence_begins_with_a_capital_and_a_file_name_as_it_is(sentence, shown):
    assert capitalised(sentence) == shown


def test_names_that_are_shown_already_or_too_long_are_shortened():
    names = ("clip.mp4", "/home/a/clip.mp4", "clip")
    assert without_name("/home/a/clip.mp4: not a video", names) == "not a video"
    assert without_name("clip: no hand was found: try again", names) == "no hand was found: try again"
    assert without_name("clip", names) == "clip"
    assert without_name("clips: none", names) == "clips: none"
    for text, most, shown in (
        ("clip left hand", 14, "clip left hand"),
        ("a very long name of a clip left hand", 20, "a very l...left hand"),
        ("abcdef", 0, "a...f"),
    ):
        assert shortened(text, lambda text, most=most: len(text) <= most) == shown
    for most in range(8, 80):
        assert len(shortened_name(LONG, most).encode()) <= most


@pytest.fixture
def take(registered, make_take):
    return make_take(sides=("right",)).take


def test_hands_are_named_after_their_capture_and_its_program(take, tmp_path):
    """Both hands of a long name can be told apart."""
    pair = replace(take, hands=take.hands * 2, program="SAM 3D Body")
    built = build_take(pair, picture=False)
    assert built.collection.name == "photo of a hand (SAM 3D Body)"
    names = [hand.armature.name for hand in built.hands]
    assert names == [f"right hand{number} of photo of a hand (SAM 3D Body)" for number in ("", " 2")]
    take = replace(pair, source=Source("photo", (str(tmp_path / f"{LONG}.png"),)), program="")
    for _ in range(2):  # the second time Blender puts numbers behind equal names
        built = build_take(take, picture=False)
        assert built.collection.name.startswith("entrevista")
        for hand, part in zip(built.hands, ("right hand of", "right hand 2"), strict=True):
            assert part in hand.armature.name
            assert hand.mesh.name == f"mesh of {hand.armature.name}"
            assert "izquierda" in hand.armature.name
        assert "camera" in built.camera.name
    assert len(f"mesh of {named_after(LONG, 'right hand 12')}.001".encode()) <= NAME_BYTES


def a_job(name: str) -> Job:
    scene = BlockReference.of("scenes", bpy.context.scene)
    return jobs.submit(CaptureRequest(name, (f"/shots/{name}",), CaptureOptions(), Building(scene)))


def test_a_clip_is_captured_by_one_button_below_a_few_words(registered, tmp_path):
    """Words before Capture with a clip, and none before the result of a capture."""
    (tmp_path / "clip.mp4").touch()
    settings = bpy.context.scene.manient
    settings.source, settings.use_frames = str(tmp_path / "clip.mp4"), True
    info = source_info.of(settings)
    info.width, info.height, info.fps, info.frames, info.first, info.last = 1280, 720, 30.0, 120, 1, 120
    page = drawn(MANIENT_PT_capture)
    assert page.words_before("Capture") <= 40
    assert "Capture" not in page.grey
    assert {"Arms", "Quality Standard", "Scene: 30 fps, 1-100, 1280×720"} <= set(page.seen)
    assert not {"smoothing", "second_view", "camera", "matching", "target"} & set(page.rows)
    edit = [c for one in MODULES for c in one.classes if getattr(c, "bl_category", "") == "Hand Edit"]
    assert min(edit, key=lambda panel: getattr(panel, "bl_order", 99)) is MANIENT_PT_result


def test_what_does_not_apply_is_not_shown(registered, tmp_path):
    settings = bpy.context.scene.manient
    for name, shown in (("clip.mp4", True), ("photo.png", False)):
        (tmp_path / name).touch()
        settings.source = str(tmp_path / name)
        assert {"second_view", "frame_step", "smoothing"}.isdisjoint(drawn(MANIENT_PT_advanced).rows) != shown
        assert ("Range" in drawn(MANIENT_PT_capture).rows) == shown
    assert "camera" not in drawn(MANIENT_PT_capture).rows
    own = bpy.data.objects.new("Shot", bpy.data.cameras.new("Shot"))
    bpy.context.scene.collection.objects.link(own)
    bpy.context.scene.camera = own
    assert "camera" in drawn(MANIENT_PT_capture).rows, "an artist's camera may be the footage's"


def test_a_message_is_one_line(registered):
    """All of it is the tooltip; it is never wrapped, which would move the buttons below."""
    long = "No hand was found in any of these frames: press Find Hands and drag a box. Or try another clip"
    assert headline(long) == "No hand was found in any of these..."
    assert headline("Scene: 30 fps. It looks through the footage's camera") == "Scene: 30 fps"
    assert (
        headline("/a/very/long/path/without/any/blank/in/it.mp4") == "/a/very/long/path...ny/blank/in/it.mp4"
    )
    assert MANIENT_OT_note.description(bpy.context, SimpleNamespace(text=long)) == long
    job = a_job("clip.mp4")
    warning = "the picture may show another hand: draw a box around it"
    job.state = "done"
    job.result = CaptureResult("1 hand in 40 frames", warnings=(warning,), offer="find_hands")
    bpy.context.scene.manient.captured = job.key
    try:
        page = drawn(MANIENT_PT_capture)
    finally:
        jobs.forget_finished()
    at = page.seen.index("clip.mp4: 1 hand in 40 frames")
    assert page.seen[at + 1 : at + 4] == ["Another hand is likely", "Find Hands", "Dismiss"]


def test_old_failures_go_when_a_newer_capture_succeeds_which_can_be_undone(registered):
    warning = "4 hands were seen, and the 2 surest were captured"

    def built():
        jobs._finish(new, CaptureResult("1 hand in 1 frame", warnings=(warning,)))
        yield from ()

    old = a_job("old.mp4")
    jobs._fail(old, "not a video", "")
    new, beside = a_job("new.mp4"), a_job("beside.mp4")
    jobs._fail(beside, "not a video", "")
    assert jobs.jobs() == (old, new, beside)
    bpy.ops.ed.undo_push(message="Before")
    new.state, new.steps = "building", built()
    assert jobs.tick()
    # What failed while it waited is news, and stays.
    assert jobs.jobs() == (new, beside)
    captured = f"new.mp4: 1 hand in 1 frame. {warning} "
    for step, is_there in ((None, True), (bpy.ops.ed.undo, False), (bpy.ops.ed.redo, True)):
        if step is not None:
            step()
        assert (captured in drawn(MANIENT_PT_capture).said) == is_there


@pytest.mark.parametrize("larger", [1.0, 1.01])
def test_a_hands_block_says_that_its_model_has_changed(take, larger):
    track = replace(take.hands[0], joints_3d=larger * take.hands[0].joints_3d)
    build_take(replace(take, hands=(track,), model_digests={"right": "0" * 16}))
    assert ("another version of the hand model" in drawn(MANIENT_PT_result).loud) == (larger > 1.0)


def test_a_mirrored_hand_is_not_told_to_be_captured_again(take):
    take.hands[0].transl[:, 0] += 0.4
    bpy.context.view_layer.objects.active = build_take(take).hands[0].armature
    assert "old one" in refiner.why_not(bpy.context, active_hand(bpy.context))  # made without detections
    assert bpy.ops.manient.mirror_hand() == {"FINISHED"}
    why = refiner.why_not(bpy.context, active_hand(bpy.context))
    assert why.startswith("A mirrored hand is not in the picture")
    assert "capture" not in why
    assert drawn(MANIENT_PT_refine).said.startswith(why)
    assert "Mirrored: it is not in the picture itself" in drawn(MANIENT_PT_result).said


def test_the_tooltip_has_the_pixels_and_the_button_goes_to_the_worst_frame(take):
    hand = store.hand_of(build_take(take).hands[0].armature)
    bpy.context.view_layer.objects.active = hand.armature
    pixels = np.nanmean(take.hands[0].reprojection_error)
    properties = SimpleNamespace(hand=hand.armature.name)
    assert f"{pixels:.1f} px" in MANIENT_OT_jump_worst.description(bpy.context, properties)
    worst = np.nanargmax(relative_errors(hand.track, hand.take.intrinsics))
    assert bpy.ops.manient.jump_worst() == {"FINISHED"}
    assert bpy.context.scene.frame_current == store.scene_frames(hand.collection, hand.take)[worst]
