"""Find Hands in the window: hands are chosen, turned, thrown out and looked for with the mouse."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.window.inputs import RENDERED_HAND

PAINTING = RENDERED_HAND.parent / "mona_lisa" / "mona_lisa.jpg"

_WRITE_FOUR = """
import sys, cv2, numpy as np
hand = cv2.imread(sys.argv[1])
row = np.hstack([hand, hand[:, ::-1]])
cv2.imwrite(sys.argv[2], np.vstack([row, row]))
"""


@pytest.fixture
def four_hands(rendered_hand, tmp_path) -> Path:
    """A picture of two right hands and two left ones."""
    path = tmp_path / "four.jpg"
    arguments = [str(rendered_hand / "hand.0007.jpg"), str(path)]
    subprocess.run([sys.executable, "-c", _WRITE_FOUR, *arguments], check=True, timeout=60)
    return path


def test_hands_are_chosen_turned_and_thrown_out(blender, four_hands):
    played = blender.play("finding.chosen", source=four_hands, timeout=300).value
    first, second, third, fourth = played["before"]
    assert sorted(played["before"]) == ["left", "left", "right", "right"]
    turned = {"left": "right", "right": "left"}[second]
    assert played["dropped"] == 3
    assert played["now"] == [[first, False], [turned, True], [third, True], [fourth, True]]
    assert played["nothing"].startswith("No hand was found in the box")
    assert played["built"] == sorted([turned, third, fourth])
    assert played["untouched"] == [0, 0]
    assert played["left"]


def test_a_box_around_a_missed_hand_finds_it(blender, rendered_hand, tmp_path):
    source = shutil.copy(PAINTING, tmp_path / "painting.jpg")
    played = blender.play("finding.boxed_hand", source=source, timeout=300).value
    assert played["found"] == []
    assert played["line"] == "No hand was found: drag a box around one that you see"
    assert played["with_box"] == [["left", True]]
    assert played["built"] == ["left"]


def test_where_a_box_is_empty_a_hand_can_be_added(blender, photo):
    assert blender.play("finding.added", source=photo, timeout=300).value == ["right"]


def test_a_crowd_is_built_only_after_it_was_asked_for(blender, four_hands):
    played = blender.play("finding.crowded", source=four_hands, most=3, timeout=300).value
    assert (played["state"], played["message"]) == ("cancelled", "4 hands: choose those to build")
    assert played["built"] == 0
    assert [chosen for _, chosen in played["shown"]] == [True, True, True, False]
    assert played["then"] == 3


def test_a_frame_of_a_clip_is_shown_and_its_hand_is_followed_both_ways(blender, make_clip):
    played = blender.play("finding.of_a_frame", source=make_clip(60), frame=30, timeout=300).value
    assert played["frame"] == 30
    assert played["zoomed"] < 2
    assert played["jobs"] == 0
    (hand,) = played["hands"]
    assert (hand["side"], hand["frames"], hand["detected"]) == ("left", 60, 60)
