"""scripts/measure_speed.py: what is timed, how ratios are taken, what the tables and the JSON say."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from handfit_core.errors import InputError
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.opening import open_media
from scripts.measure_speed import SAMPLE, main
from scripts.speed import timings as module
from scripts.speed.memory import Peak, measure_memory, peak_memory, write_clip
from scripts.speed.report import Part, memory_part, pipeline_part, significant, solvers_part
from scripts.speed.timings import Contender, Spread, Timing, find_hand, interleaved
from tests.conftest import ROOT

PAPER = Timing("paper-a", 1, [[1.0], [2.0], [3.0]])
FAST = Timing("fast, batch of 4", 4, [[0.04], [0.04], [0.04]])


def line_of(part: Part, start: str) -> list[str]:
    (line,) = [line for line in part.text().splitlines() if line.startswith(start)]
    return line.removeprefix(start).split()


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
    solvers = document["solvers"]["timings"]
    names = ["fast-per-frame", "fast, one frame", "fast, batch of 1", "fast, batch of 3"]
    assert [t["name"] for t in solvers] == names
    assert document["solvers"]["distinct_detections"] == 2
    for timing in solvers + document["pipeline"]["timings"]:
        assert timing["seconds_per_frame"]["median"] > 0
        assert timing["name"] in text
    assert solvers[0]["times_faster"]["median"] == 1.0
    assert "memory_mb" not in document


def test_hand_is_repeated_to_fill_a_batch() -> None:
    hand = find_hand(SAMPLE, FrameRange.parse("1-3"))
    assert hand.model.side == "right"
    np.testing.assert_array_equal(hand.batch(7).keypoints, hand.detections.keypoints[[0, 1, 2, 0, 1, 2, 0]])
    np.testing.assert_array_equal(hand.single(1).detections.keypoints, hand.detections.keypoints[[1]])
    assert hand.intrinsics.cx == 320.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["gone.mp4"], "gone.mp4: there is no such file"),
        (["--slow", "magic"], "there is no solver 'magic'"),
        (["--only", "solvers,speed"], "no part 'speed'; choose from solvers, pipeline, memory"),
        (["--rounds", "0"], "must be at least 1"),
        *((["--batches", text], "--batches: ") for text in ("", "0", "1,-2", "1,two")),
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


def test_everything_has_its_turn_in_every_round_and_is_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    log: list[tuple[str, int]] = []
    now = 0.0

    def contender(name: str, seconds: float, **settings: int) -> Contender:
        def run(number: int) -> None:
            nonlocal now
            log.append((name, number))
            now += seconds + number

        return Contender(name, run, **settings)

    monkeypatch.setattr(module.time, "perf_counter", lambda: now)
    done: list[int] = []
    contenders = [contender("a", 10.0), contender("b", 2.0, calls=2, frames=4)]
    a, b = interleaved(contenders, 3, done.append)
    warm_up = [("a", 0), ("b", 0)]
    assert log == warm_up + [(name, n) for n in range(3) for name in ("a", "b", "b")]
    assert done == [1, 2, 3]
    assert a.rounds == [[10.0], [11.0], [12.0]]
    assert b.rounds == [[2.0, 2.0], [3.0, 3.0], [4.0, 4.0]]
    assert a.seconds_per_frame == Spread(11.0, 10.5, 11.5)
    assert b.seconds_per_frame.median == 0.75


def test_ratios_are_taken_within_rounds() -> None:
    # The machine is ten times slower in the second round: no ratio sees it.
    paper = Timing("paper", 1, rounds=[[1.0], [10.0], [1.2]])
    fast = Timing("fast", 8, rounds=[[0.08, 0.04, 9.0], [0.8, 0.4, 0.81], [0.08, 0.08, 0.08]])
    ratio = fast.times_faster_than(paper)
    assert (ratio.median, ratio.low, ratio.high) == pytest.approx((100.0, 100.0, 120.0))
    assert paper.times_faster_than(fast).median == pytest.approx(0.01)
    assert fast.times_faster_than(fast) == Spread(1.0, 1.0, 1.0)


@pytest.mark.parametrize(
    ("value", "text"),
    [(4093.4, "4093"), (99.96, "100.0"), (12.34, "12.3"), (1.234, "1.23"), (0.2444, "0.244"), (0.0, "0.000")],
)
def test_significant_digits(value: float, text: str) -> None:
    assert significant(value) == text


def test_solvers_and_pipeline_have_medians_spreads_and_ratios() -> None:
    part = solvers_part([PAPER, FAST], "paper-a", 24, converged=0.75, doubtful=0.5)
    # 2 s a frame; 10 ms a frame, 100, 200 and 300 times faster in the three rounds.
    assert line_of(part, "paper-a") == ["2000", "1500-2500", "0.500", "1.00", "1.00-1.00"]
    assert line_of(part, "fast, batch of 4") == ["10.0", "10.0-10.0", "100", "200", "100-300"]
    assert "24 distinct detections" in part.text()
    assert "75 % of those converged, 50 % doubtful" in part.text()
    fast = json.loads(json.dumps(part.numbers))["solvers"]["timings"][1]
    assert fast["frames_per_second"] == pytest.approx(100.0)
    assert fast["times_faster"] == pytest.approx({"median": 200.0, "low": 100.0, "high": 300.0})
    assert fast["rounds"] == FAST.rounds
    alone = solvers_part([PAPER, FAST], "", 24, 1.0, 0.0)
    assert line_of(alone, "fast, batch of 4") == ["10.0", "10.0-10.0", "100"]
    assert alone.numbers["solvers"]["reference"] is None
    both = Timing("detection alone", 100, [[2.0], [4.0]]), Timing("whole pipeline", 100, [[2.5], [5.0]])
    pipeline = pipeline_part(*both)
    assert line_of(pipeline, "detection alone")[:3] == ["30.0", "25.0-35.0", "33.3"]
    assert line_of(pipeline, "whole pipeline")[-2:] == ["0.800", "0.800-0.800"]
    assert pipeline.numbers["pipeline"]["timings"][1]["times_faster"]["median"] == pytest.approx(0.8)


def test_memory_is_flat_or_not() -> None:
    short = Peak(300, 180.0, 400.0, 0.4)
    flat = memory_part([short, Peak(10_000, 190.0, 450.0, 13.0)])
    assert line_of(flat, "10000 frames") == ["190", "450", "13.0"]
    assert "+50 MB over the shortest (+10 MB of it until the end of detection): flat" in flat.text()
    assert flat.numbers["memory_mb"][0] == {"frames": 300, "detection": 180.0, "whole": 400.0, "take": 0.4}
    leak = memory_part([short, Peak(10_000, 300.0, 601.0, 1.0)])
    assert "+201 MB over" in leak.text()
    assert "NOT flat" in leak.text()
    assert "flat" not in memory_part([short]).text()


def test_clip_goes_there_and_back_again(tmp_path: Path) -> None:
    media = open_media(write_clip(SAMPLE, tmp_path / "long.mp4", 60))
    assert (media.width, media.height, media.expected_frames) == (320, 240, 60)
    pictures = [f.rgb.astype(int) for f in media.frames() if f.rgb is not None]
    assert len(pictures) == 60
    # 24 pictures: frames 24 and 46 are the turning points' neighbours, 46 is the first again.
    assert np.abs(pictures[25] - pictures[21]).mean() < 4
    assert np.abs(pictures[46] - pictures[0]).mean() < 4
    assert np.abs(pictures[23] - pictures[12]).mean() > 6


def test_peak_is_of_the_process_itself() -> None:
    """Not of its parent, which is what getrusage starts with."""
    ballast = np.ones(400_000_000 // 8)
    code = "from scripts.speed.memory import peak_memory; print(peak_memory())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert peak_memory() > ballast.nbytes / 1e6
    assert 5 < float(done.stdout) < 300


def test_peaks_of_both_lengths() -> None:
    told: list[int] = []
    peaks = measure_memory(SAMPLE, (2, 4), on_clip=told.append)
    assert told == [p.frames for p in peaks] == [2, 4]
    for peak in peaks:
        assert 50 < peak.detection <= peak.whole
    # Joints, keypoints and parameters of every frame: twice the frames, twice the arrays but for the shape.
    assert peaks[1].take == pytest.approx(2 * peaks[0].take, rel=0.1)


def test_failure_of_the_capture_is_an_error(tmp_path: Path) -> None:
    grey = tmp_path / "grey.png"
    grey.write_bytes(cv2.imencode(".png", np.full((64, 64, 3), 99, np.uint8))[1].tobytes())
    with pytest.raises(InputError, match=r"a clip of 3 frames failed: .*no hand"):
        measure_memory(str(grey), (3,))
