import json
from pathlib import Path

import pytest

from benchmarks.__main__ import chosen_parts, main, numbers
from benchmarks.detections import find_hand
from handfit_core.errors import OptionError
from handfit_core.media.frame_range import FrameRange
from tests.conftest import ROOT

SAMPLE = str(ROOT / "samples" / "rendered_hand" / "hand.%04d.jpg")


def test_tiny_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "times.json"
    # Any solver may be the one to compare with; the paper's take seconds.
    slow = ["--slow", "fast-per-frame"]
    options = ["--frames", "1-2", *slow, "--batches", "1,3", "--rounds", "1", "--runs", "1"]
    assert main([SAMPLE, *options, "-o", str(output)]) == 0
    text = capsys.readouterr().out
    assert "Solvers, on the same detections" in text
    assert "Whole pipeline against detection alone, 2 frames" in text
    document = json.loads(output.read_text(encoding="utf-8"))
    assert document["input"] == "hand"
    names = [t["name"] for t in document["solvers"]["timings"]]
    assert names == ["fast-per-frame", "fast, one frame", "fast, batch of 1", "fast, batch of 3"]
    assert document["solvers"]["distinct_detections"] == 2
    for timing in document["solvers"]["timings"] + document["pipeline"]["timings"]:
        assert timing["seconds_per_frame"]["median"] > 0
        assert str(timing["name"]) in text
    assert document["solvers"]["timings"][0]["times_faster"]["median"] == 1.0
    assert "memory_mb" not in document


def test_hand_is_repeated_to_fill_a_batch() -> None:
    hand = find_hand(SAMPLE, FrameRange.parse("1-3"))
    assert hand.model.side == "right"
    assert [hand.detections.index(d) for d in hand.batch(7)] == [0, 1, 2, 0, 1, 2, 0]
    track = hand.single(1)
    assert track.detections == (hand.detections[1],)
    assert hand.intrinsics.cx == 320.0


def test_parts() -> None:
    assert chosen_parts(None, memory=False) == ("solvers", "pipeline")
    assert chosen_parts(None, memory=True) == ("solvers", "pipeline", "memory")
    assert chosen_parts("memory", memory=True) == ("memory",)
    with pytest.raises(OptionError, match="no part 'speed'; choose from solvers, pipeline, memory"):
        chosen_parts("solvers,speed", memory=False)


@pytest.mark.parametrize("text", ["", "0", "1,-2", "1,two"])
def test_bad_lists(text: str) -> None:
    with pytest.raises(OptionError, match="--batches"):
        numbers(text, "--batches")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["gone.mp4"], "gone.mp4: there is no such file"),
        (["--slow", "magic"], "there is no solver 'magic'"),
        (["--rounds", "0"], "must be at least 1"),
    ],
)
def test_user_errors_are_one_line(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert message in error
    assert error.count("\n") == 1


def test_help_names_every_part(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--help"])
    text = capsys.readouterr().out
    for word in ("solvers", "pipeline", "memory", "packages", "--batches", "--lengths", "--zip", "examples"):
        assert word in text
