"""Names and sentences as people read them, and the names of what a capture builds."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import pytest

from blender_manient.common.block_reference import BlockReference
from blender_manient.common.wording import (
    NAME_BYTES,
    capitalised,
    named_after,
    shortened,
    shortened_name,
    without_name,
)
from blender_manient.operators.review import MANIENT_OT_jump_worst
from blender_manient.panels.capture import MANIENT_PT_capture
from blender_manient.panels.refine import MANIENT_PT_refine
from blender_manient.panels.result import MANIENT_PT_result
from blender_manient.panels.shape import MANIENT_PT_other_proportions, MANIENT_PT_proportions
from blender_manient.scene import confidence, reshape, store
from blender_manient.scene.build import build_take
from blender_manient.scene.store import active_hand
from blender_manient.session import jobs, refiner
from blender_manient.session.jobs import Building, Job
from handfit_core.fit_quality import EXPECTED, mean_relative_error, relative_errors
from handfit_core.media.source import Source
from handfit_core.options import CaptureOptions
from tests.drawn import drawn

LONG = "entrevista con la señora Muñoz en el taller, segunda toma, cámara B, mano izquierda"


@pytest.mark.parametrize(
    ("sentence", "shown"),
    [
        ("no hand was found", "No hand was found"),
        ("no hand was found: try a larger picture", "No hand was found: try a larger picture"),
        ("clip.mp4: no frame could be read", "clip.mp4: no frame could be read"),
        ("my first clip.mp4: no frame could be read", "my first clip.mp4: no frame could be read"),
        ("shots/a: no pictures in this folder", "shots/a: no pictures in this folder"),
        ("hand.%04d.png names no file", "hand.%04d.png names no file"),
        ("the file clip.mp4: it is gone", "the file clip.mp4: it is gone"),
        ("", ""),
    ],
)
def test_a_sentence_begins_with_a_capital_and_a_file_name_as_it_is(sentence, shown):
    assert capitalised(sentence) == shown


def test_a_name_that_is_shown_already_is_not_repeated():
    names = ("clip.mp4", "/home/a/clip.mp4", "clip")
    assert without_name("/home/a/clip.mp4: not a video", names) == "not a video"
    assert without_name("clip: no hand was found: try again", names) == "no hand was found: try again"
    assert without_name("clip", names) == "clip"
    assert without_name("clips: none", names) == "clips: none"


def test_names_lose_their_middle():
    assert shortened("clip left hand", lambda text: len(text) <= 14) == "clip left hand"
    short = shortened("a very long name of a clip left hand", lambda text: len(text) <= 20)
    assert short == "a very l...left hand"
    assert shortened("abcdef", lambda _text: False) == "a...f"
    for most in range(8, 80):
        assert len(shortened_name(LONG, most).encode()) <= most


@pytest.mark.parametrize("sides", [("right", "left")])
def test_both_hands_of_a_long_name_can_be_told_apart(registered, make_take, tmp_path, sides):
    path = tmp_path / f"{LONG}.png"
    take = make_take(sides=sides).take
    take = replace(take, source=Source("photo", (str(path),)))
    for _ in range(2):  # the second time Blender puts numbers behind equal names
        built = build_take(take, picture=False)
        assert built.collection.name.startswith("entrevista")
        for hand in built.hands:
            assert f"{hand.side} hand" in hand.armature.name
            assert hand.mesh.name == f"mesh of {hand.armature.name}"
            assert "izquierda" in hand.armature.name
        assert "camera" in built.camera.name
    assert len(f"mesh of {named_after(LONG, 'right hand 12')}.001".encode()) <= NAME_BYTES


def test_hands_are_named_after_their_capture_and_its_program(make_take):
    take = make_take(sides=("left", "right")).take
    take = replace(take, hands=(*take.hands, take.hands[1]), program="SAM 3D Body")
    built = build_take(take, picture=False)
    assert built.collection.name == "photo of a hand (SAM 3D Body)"
    parts = [hand.armature.name.partition(" of ")[0] for hand in built.hands]
    assert parts == ["left hand", "right hand", "right hand 2"]
    assert built.hands[0].armature.name == "left hand of photo of a hand (SAM 3D Body)"


def a_job(name: str) -> Job:
    scene = BlockReference.of("scenes", bpy.context.scene)
    return Job(name, (f"/shots/{name}",), CaptureOptions(), Building(scene))


def fails(job: Job, sentence: str) -> str:
    job.state = "capturing"
    jobs._fail(job, sentence, "")
    return job.message


def test_a_failure_says_the_files_name_once_and_as_it_is(registered):
    for sentence in (
        "/shots/my clip.mp4: not a video",
        "my clip: not a video",
        "my clip.mp4: not a video",
        "not a video",
    ):
        assert fails(a_job("my clip.mp4"), sentence) == "Not a video"
    assert fails(a_job("my clip.mp4"), "hand_model.npz: no hand model") == "hand_model.npz: no hand model"


def succeeds(job: Job) -> None:
    def built():
        return (), [], "1 hand in 1 frame"
        yield 1.0

    job.state, job._builder = "building", built()
    assert jobs.tick()
    assert job.state == "done"


def test_old_failures_go_when_a_newer_capture_succeeds(registered):
    old, other, beside, new = (a_job(f"{name}.mp4") for name in ("old", "other", "beside", "new"))
    for job in (old, other):
        jobs.submit(job)
        fails(job, "not a video")
    assert jobs.jobs() == (old, other)
    jobs.submit(new)
    jobs.submit(beside)
    fails(beside, "not a video")
    # What failed while it waited is news, and stays.
    succeeds(new)
    assert jobs.jobs() == (new, beside)


def test_the_list_says_what_was_undone_and_which_hands_were_left_out(registered):
    job = a_job("new.mp4")
    job.warnings = ["4 hands were seen, and the 2 surest were captured"]
    jobs.submit(job)
    bpy.ops.ed.undo_push(message="Before")
    succeeds(job)
    captured = "new.mp4: 1 hand in 1 frame 4 hands were seen, and the 2 surest were captured"
    for step, said in ((None, captured), (bpy.ops.ed.undo, "new.mp4: Undone"), (bpy.ops.ed.redo, captured)):
        if step is not None:
            step()
        assert drawn(MANIENT_PT_capture).said.endswith(f"{said} Clear List")


@pytest.mark.parametrize(("count", "pixels", "word"), [(0, 0.1, "good"), (1, 2.1, "fair"), (3, 9.0, "poor")])
def test_a_hands_block_has_units_and_a_word(registered, make_take, count, pixels, word):
    take = make_take(sides=("right",)).take
    track = take.hands[0]
    flags = np.arange(len(track.detected)) < count
    track = replace(track, doubtful=flags, reprojection_error=np.where(track.detected, pixels, np.nan))
    hand = store.hand_of(build_take(replace(take, hands=(track,))).hands[0].armature)
    share = mean_relative_error(hand.track, hand.take.intrinsics)
    block = drawn(MANIENT_PT_result).said
    assert f"Error {100 * share:.1f} % of the hand: {word} " in block
    assert f" {count or 'No'} doubtful frame{'' if count == 1 else 's'} " in block
    assert "px" not in block


def test_a_hands_block_tells_the_error_that_is_expected(registered, make_take):
    take = make_take(sides=("right",)).take
    track = replace(take.hands[0], expected_error=np.full((len(take.frame_numbers), 5), 0.0093))
    store.hand_of(build_take(replace(take, hands=(track,))).hands[0].armature)
    assert "Likely error 9.3 mm: fair " in drawn(MANIENT_PT_result).said


def test_a_hands_block_says_what_nobody_knows(registered, make_take):
    take = make_take(sides=("right",)).take
    track = replace(take.hands[0], expected_error=np.full((len(take.frame_numbers), 5), np.nan))
    hand = store.hand_of(build_take(replace(take, hands=(track,))).hands[0].armature)
    block = drawn(MANIENT_PT_result).said
    assert "Likely error not known " in block
    assert not any(word in block for word in ("good", "fair", "poor", "doubtful"))
    colors = confidence.colors_of(confidence.errors_of(hand).bones, EXPECTED.levels)
    assert (colors == confidence.UNSEEN_COLOR).all()


@pytest.mark.parametrize("larger", [1.0, 1.01])
def test_a_hands_block_says_that_its_model_has_changed(registered, make_take, larger):
    take = make_take(sides=("right",), model_digests={"right": "0" * 16}).take
    track = replace(take.hands[0], joints_3d=larger * take.hands[0].joints_3d)
    build_take(replace(take, hands=(track,)))
    assert ("another version of the hand model" in drawn(MANIENT_PT_result).loud) == (larger > 1.0)


def test_a_photos_hand_has_a_photos_word(registered, make_take):
    take = make_take(sides=("right",), frame_numbers=np.array([1])).take
    track = replace(take.hands[0], expected_error=np.full((1, 5), 0.0158))
    build_take(replace(take, hands=(replace(track, doubtful=np.array([True])),)))
    block = drawn(MANIENT_PT_result).said
    assert "Likely error 15.8 mm: fair " in block
    assert "doubtful" not in block


def test_proportions_without_a_name_are_folded_away(registered, make_take):
    hand = store.hand_of(build_take(make_take(sides=("right",)).take).hands[0].armature)
    bpy.context.view_layer.objects.active = hand.armature
    names = reshape.shape_names_of(hand)
    named = " ".join(name for name in names if name)
    others = " ".join(f"Shape {number}" for number, name in enumerate(names, start=1) if name is None)
    assert drawn(MANIENT_PT_proportions).said == f"{named} manient.reset_shape"
    assert drawn(MANIENT_PT_other_proportions).said == others
    assert "DEFAULT_CLOSED" in MANIENT_PT_other_proportions.bl_options


def test_a_mirrored_hand_is_not_told_to_be_captured_again(registered, make_take):
    made = make_take(sides=("right",))
    made.take.hands[0].transl[:, 0] += 0.4
    bpy.context.view_layer.objects.active = build_take(made.take).hands[0].armature
    assert "old one" in refiner.why_not(bpy.context, active_hand(bpy.context))  # made without detections
    assert bpy.ops.manient.mirror_hand() == {"FINISHED"}
    why = refiner.why_not(bpy.context, active_hand(bpy.context))
    assert why.startswith("A mirrored hand is not in the picture")
    assert "capture" not in why
    assert drawn(MANIENT_PT_refine).said.startswith(why)
    assert "Mirrored: it is not in the picture itself" in drawn(MANIENT_PT_result).said


def test_the_tooltip_has_the_pixels_and_the_button_goes_to_the_worst_frame(registered, make_take):
    take = make_take(sides=("right",)).take
    hand = store.hand_of(build_take(take).hands[0].armature)
    bpy.context.view_layer.objects.active = hand.armature
    pixels = take.hands[0].reprojection_error[take.hands[0].detected].mean()
    properties = type("Properties", (), {"hand": hand.armature.name})
    assert f"{pixels:.1f} px" in MANIENT_OT_jump_worst.description(bpy.context, properties)
    errors = relative_errors(hand.track, hand.take.intrinsics)
    worst = max(range(len(errors)), key=lambda row: errors[row] if errors[row] == errors[row] else -1.0)
    assert bpy.ops.manient.jump_worst() == {"FINISHED"}
    assert bpy.context.scene.frame_current == store.scene_frames(hand.collection, hand.take)[worst]
