"""`convert` and `info`: takes and what other programs write, on the command line."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from handfit_core.__main__ import main
from handfit_core.common.skeleton import other_side
from handfit_core.interchange.writers import writer_for
from handfit_core.media.frame_range import FrameRange
from handfit_core.take import Take, chosen, is_take
from tests.conftest import ROOT

TRUTH = Take.load(ROOT / "samples" / "rendered_hand" / "truth.take.npz")
SIDE, OTHER = TRUTH.hands[0].side, other_side(TRUTH.hands[0].side)


@pytest.fixture
def points(tmp_path: Path) -> Path:
    path = tmp_path / "hand.points.json"
    writer_for(path).write(TRUTH, path)
    return path


@pytest.fixture
def two(tmp_path: Path) -> Path:
    """Ten frames; the second hand, of the other side, is in the first three and less certain."""
    take = chosen(TRUTH, "auto", FrameRange(1, 10), None)
    (hand,) = take.hands
    late = np.arange(10) >= 3
    of_frames = {k: np.array(v) for k, v in vars(hand).items() if isinstance(v, np.ndarray) and k != "betas"}
    for array in of_frames.values():
        array[late] = False if array.dtype == bool else np.nan
    found = hand.detections.select(hand.detections.frame < 3)
    hands = (replace(hand, side=OTHER, detections=found, **of_frames), hand)
    return replace(take, hands=hands).save(tmp_path / "two.take.npz")


@pytest.fixture
def convert(tmp_path: Path) -> Callable[..., Take]:
    """Convert a file to a take, which is given back."""

    def made(path: Path, *options: str) -> Take:
        out = tmp_path / "out.take.npz"
        assert main(["convert", str(path), "-o", str(out), "--progress", "none", *options]) == 0
        assert is_take(out)
        return Take.load(out)

    return made


def test_points_become_a_take_and_points_again(
    points: Path, convert: Callable[..., Take], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["info", str(points)]) == 0
    assert f"points in space: {SIDE} hand in 24 frames" in capsys.readouterr().out
    take = str(convert(points, "--frames", "1-4").save(tmp_path / "four.take.npz"))
    assert main(["info", take]) == 0
    assert "take of data" in capsys.readouterr().out
    again = tmp_path / "again.points.json"
    assert main(["convert", take, "-o", str(again), "--progress", "none"]) == 0
    assert len(json.loads(again.read_text())["frames"]) == 4
    assert main(["convert", take, "-o", str(tmp_path / "hand.xyz"), "--progress", "none"]) == 1
    assert "end the name with one of" in capsys.readouterr().err


def test_hands_and_frames_of_a_take_are_chosen(two: Path, convert: Callable[..., Take]) -> None:
    take = convert(two, "--hands", OTHER, "--frames", "2-3")
    assert (take.frame_numbers.tolist(), [hand.side for hand in take.hands]) == ([2, 3], [OTHER])
    np.testing.assert_array_equal(take.hands[0].transl, TRUTH.hands[0].transl[1:3])
    assert [Path(file).name for file in take.source.files] == ["hand.0002.jpg", "hand.0003.jpg"]
    for options, sides in (
        (["--max-hands", "1"], [SIDE]),
        (["--frames", "5-10:2"], [SIDE]),
        ([], [OTHER, SIDE]),
    ):
        assert [hand.side for hand in convert(two, *options).hands] == sides


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--smoothing", "2", "--refit"], "take, which is captured already: leave --smoothing, --refit out"),
        (["--frames", "100-200"], "none of the take's frames lies in 100-200; it has 1 to 10"),
        (["--frames", "7-9", "--hands", OTHER], f"no {OTHER} hand in these frames"),
    ],
)
def test_what_a_take_cannot_give(
    two: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], said: str
) -> None:
    command = ["convert", str(two), "-o", str(tmp_path / "out.take.npz"), "--progress", "none"]
    assert main([*command, *options]) == 1
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out.take.npz").exists()


def test_more_hands_than_a_take_holds(points: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = json.loads(points.read_text())
    points.write_text(json.dumps(content | {"hands": (content["hands"] * 201)[:201]}))
    out = points.with_name("a.npz")
    out.write_text("a good file")
    assert main(["capture", str(points), "-o", str(out)]) == 1
    assert "there are 201 hands in this input, and a take holds at most 200" in capsys.readouterr().err
    assert out.read_text() == "a good file"


def test_an_input_is_not_written_over(points: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good = points.read_bytes()
    for verb in ("capture", "convert"):
        assert main([verb, str(points), "-o", str(points)]) == 1
        assert "this is an input, which stays" in capsys.readouterr().err
    assert points.read_bytes() == good
