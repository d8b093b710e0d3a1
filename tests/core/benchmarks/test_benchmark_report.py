import json

import pytest

from benchmarks.interleaved import Timing
from benchmarks.memory import Peak
from benchmarks.report import Results, json_of, significant, table, text_of
from benchmarks.solvers import SolverTimings

MACHINE = {
    "processor": "Some CPU",
    "cores": 4,
    "usable_cores": 2,
    "load_before": 1.25,
    "torch_threads": 2,
    "opencv_threads": 2,
    "python": "3.11.7",
    "versions": {"numpy": "2.0"},
}


def results(*extra: Timing, reference: str = "paper-a") -> Results:
    timings = [
        Timing("paper-a", 1, rounds=[[1.0], [2.0], [3.0]]),
        Timing("fast, batch of 4", 4, rounds=[[0.04], [0.04], [0.04]]),
        *extra,
    ]
    return Results(
        machine=MACHINE,
        source="clip",
        detections=24,
        solvers=SolverTimings(timings, converged=0.75, doubtful=0.5),
        reference=reference,
        pipeline=(
            Timing("detection alone", 100, rounds=[[2.0], [4.0]]),
            Timing("whole pipeline", 100, rounds=[[2.5], [5.0]]),
        ),
        memory=[Peak(300, 180.0, 400.0, 0.4), Peak(10_000, 190.0, 450.0, 13.0)],
    )


def line_of(text: str, start: str) -> str:
    (line,) = [line for line in text.splitlines() if line.startswith(start)]
    return line


def test_table_lines_up() -> None:
    assert table(["what", "ms"], [["a", "10.5"], ["longer", "2"]]).splitlines() == [
        "what      ms",
        "------  ----",
        "a       10.5",
        "longer     2",
    ]


@pytest.mark.parametrize(
    ("value", "text"),
    [(4093.4, "4093"), (99.96, "100.0"), (12.34, "12.3"), (1.234, "1.23"), (0.2444, "0.244"), (0.0, "0.000")],
)
def test_significant_digits(value: float, text: str) -> None:
    assert significant(value) == text


def test_medians_spreads_and_ratios() -> None:
    text = text_of(results())
    # 2 s a frame; 10 ms a frame, 100, 200 and 300 times faster in the three rounds.
    assert line_of(text, "paper-a").split() == ["paper-a", "2000", "1500-2500", "0.500", "1.00", "1.00-1.00"]
    assert line_of(text, "fast, batch of 4").split()[4:] == ["10.0", "10.0-10.0", "100", "200", "100-300"]
    assert line_of(text, "detection alone").split()[2:] == ["33.3", "28.6-40.0", "30.0"]
    assert "pipeline / detection: 0.80 (0.80-0.80)" in text
    assert "24 distinct detections" in text
    assert "75 % of those converged, 50 % doubtful" in text


def test_memory_is_flat_or_not() -> None:
    assert "+50 MB over the shortest (+10 MB of it until the end of detection): flat" in text_of(results())
    leak = Results(MACHINE, "clip", memory=[Peak(300, 180, 400, 1), Peak(10_000, 300, 601, 1)])
    assert "+201 MB over" in text_of(leak)
    assert "NOT flat" in text_of(leak)
    one = Results(MACHINE, "clip", memory=[Peak(300, 180, 400, 1)])
    assert "flat" not in text_of(one)


def test_machine_is_described() -> None:
    text = text_of(results())
    assert "Some CPU, 2 of 4 cores, load 1.2 before the start" in text
    assert "torch 2 (solvers take 1), OpenCV 2" in text
    assert "Python 3.11.7, numpy 2.0" in text


def test_without_anything_to_compare_with() -> None:
    text = text_of(results(reference=""))
    assert line_of(text, "fast, batch of 4").split()[4:] == ["10.0", "10.0-10.0", "100"]
    assert json_of(results(reference=""))["solvers"]["reference"] is None


def test_json_holds_the_same_numbers() -> None:
    document = json.loads(json.dumps(json_of(results())))
    assert document["machine"]["cores"] == 4
    fast = document["solvers"]["timings"][1]
    assert fast["seconds_per_frame"]["median"] == pytest.approx(0.01)
    assert fast["frames_per_second"] == pytest.approx(100.0)
    assert fast["times_faster"] == pytest.approx({"median": 200.0, "low": 100.0, "high": 300.0})
    assert fast["rounds"] == [[0.04], [0.04], [0.04]]
    assert document["pipeline"]["share_of_detection_rate"]["median"] == pytest.approx(0.8)
    assert document["memory_mb"][1] == {"frames": 10_000, "detection": 190.0, "whole": 450.0, "take": 13.0}
    only_memory = json_of(Results(MACHINE, "clip", memory=[]))
    assert "solvers" not in only_memory
    assert "pipeline" not in only_memory
