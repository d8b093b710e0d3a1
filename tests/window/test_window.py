"""What only the real Blender's window shows: events, redraws, modes, undo by keys, the panel's layout.

A test plays a scenario inside Blender, which asserts what must have happened (inside/driver.py). What an
operator does by itself is tested in tests/blender.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from typing import Any

import pytest

from tests.window.blender_window import BlenderWindow
from tests.window.conftest import MakeWindow
from tests.window.inputs import Inputs

CLIP, LONG_CLIP, VERY_LONG_CLIP = 120, 480, 1500
"""frames: the first are enough for the panel to tell its rate before it is done"""

SCENARIOS: dict[str, Callable[[Inputs], dict[str, Any]]] = {
    "addon.disabled_leaves_nothing": lambda i: {"take": i.take},
    "addon.disabled_in_a_mode": lambda i: {"take": i.two_hands()},
    "addon.survives_reloading_scripts": lambda i: {"take": i.take},
    "addon.take_from_the_file_browser": lambda i: {"take": i.take},
    "addon.lens_from_the_file_browser": lambda i: {"film": i.film_of_the_board},
    "addon.all_sections": lambda i: {"source": i.clip(60)},
    "addon.preferences": lambda _: {},
    "addon.whole_picture": lambda i: {"source": i.portrait},
    "capture.photo": lambda i: {"source": i.photo},
    "capture.clip": lambda i: {"source": i.clip(CLIP), "frames": CLIP},
    "capture.escaped": lambda i: {"source": i.clip(VERY_LONG_CLIP), "frames": VERY_LONG_CLIP},
    "capture.pressed_again": lambda i: {"source": i.clip(LONG_CLIP)},
    "capture.quit_asks": lambda i: {"source": i.clip(LONG_CLIP)},
    "capture.own_shot": lambda i: {"source": i.photo},
    "capture.queued": lambda i: {
        "sources": [i.clip(LONG_CLIP), i.photo, shutil.copy(i.photo, i.folder / "second.jpg")]
    },
    "capture.worker_killed": lambda i: {"source": i.clip(LONG_CLIP), "frames": LONG_CLIP},
    "capture.undo_in_the_middle": lambda i: {"source": i.clip(CLIP), "frames": CLIP},
    "capture.another_file_in_the_middle": lambda i: {"source": i.clip(CLIP)},
    "capture.dropped": lambda i: {"source": i.photo},
    "capture.arms_added": lambda i: {"source": i.photo},
    "finding.chosen": lambda i: {"source": i.four_hands},
    "finding.added": lambda i: {"source": i.photo},
    "refine.keypoint_dragged": lambda i: {"source": i.clip(60)},
    "refine.looked_at": lambda i: {"take": i.two_hands(away=5.2)},
    "refine.put_elsewhere": lambda i: {"source": i.clip(60)},
    "refine.smoothed": lambda i: {"source": i.clip(60)},
    "refine.range_refitted": lambda i: {"source": i.clip(60)},
    "adding.in_a_drawing": Inputs.drawing,
    "adding.by_keys": lambda i: {"source": i.drawing()["source"]},
    "posing.proportions": lambda i: {"source": i.photo},
    "posing.pose_of_the_library": lambda i: {"take": i.take},
    "posing.pose_of_the_asset_browser": lambda i: {"take": i.take},
    "posing.keys_simplified": lambda i: {"take": i.two_hands()},
    "posing.exported": lambda i: {"source": i.photo},
    "character.applied": lambda i: {"take": i.two_hands()},
    "character.armed": lambda i: {"take": i.two_arms},
    "character.linked": lambda i: {"source": i.clip(60)},
    "views.captured": lambda i: i.two_cameras,
    "views.told": lambda i: {**i.two_cameras, "rig": i.rig},
    "live.recorded": lambda i: {"source": i.clip(VERY_LONG_CLIP)},
}


ARTISTS_PATH = (
    *("capture.photo", "capture.clip", "finding.chosen", "refine.keypoint_dragged"),
    *("refine.range_refitted", "character.applied", "posing.exported", "live.recorded"),
)
"""Scenarios that are played for every change; the others are slow together"""


@pytest.mark.parametrize(
    "scenario",
    [name if name in ARTISTS_PATH else pytest.param(name, marks=pytest.mark.slow) for name in SCENARIOS],
)
def test_scenario(blender: BlenderWindow, inputs: Inputs, scenario: str):
    blender.play(scenario, **SCENARIOS[scenario](inputs))


@pytest.mark.slow
@pytest.mark.parametrize(("blank_from", "word"), [(0, "hand"), (None, "text")])
def test_a_failure_is_a_sentence(blender: BlenderWindow, inputs: Inputs, blank_from: int | None, word: str):
    source = inputs.words if blank_from is None else inputs.clip(CLIP, blank_from)
    blender.play("capture.fails", source=source, word=word)


@pytest.mark.slow
def test_a_small_window_frames_all_of_the_picture(small_blender: BlenderWindow, inputs: Inputs):
    small_blender.play("addon.whole_picture", source=inputs.portrait)


@pytest.mark.slow
def test_a_rigify_character_follows_live(small_blender: BlenderWindow, inputs: Inputs):
    small_blender.play("live.on_rigify", source=inputs.clip(VERY_LONG_CLIP))


@pytest.mark.slow
def test_both_hands_act_live(small_blender: BlenderWindow, inputs: Inputs):
    small_blender.play("live.acted", source=inputs.two_hands_acting, take=inputs.take)


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["capture.unhindered", "refine.follows_the_mouse"])
def test_the_window_never_freezes(small_blender: BlenderWindow, inputs: Inputs, scenario: str):
    small_blender.play(scenario, source=inputs.clip(60))


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["capture.left_running", "live.left_running"])
def test_quitting_meanwhile_leaves_no_process(make_window: MakeWindow, inputs: Inputs, scenario: str):
    own = make_window((640, 480))
    own.play(scenario, source=inputs.clip(VERY_LONG_CLIP))
    assert own.quit() == []
