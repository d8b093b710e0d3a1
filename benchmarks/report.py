"""The tables for people and the numbers for machines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from benchmarks.interleaved import Spread, Timing
from benchmarks.memory import MOST_MORE_MB, Peak
from benchmarks.packages import PackageCosts
from benchmarks.solvers import SolverTimings

Row = Sequence[str]


@dataclass(frozen=True, eq=False)
class Results:
    """What was measured; None for what was not asked for."""

    machine: dict[str, Any]
    source: str
    """name of the input"""
    detections: int | None = None
    """distinct ones that the solvers got"""
    solvers: SolverTimings | None = None
    reference: str = "paper-a"
    """the solver that others are compared with"""
    pipeline: tuple[Timing, Timing] | None = None
    """detection alone, whole pipeline"""
    memory: list[Peak] | None = None
    packages: PackageCosts | None = None


def text_of(results: Results) -> str:
    """All tables, with what one has to know to read them."""
    parts = [_machine_lines(results)]
    if results.solvers is not None:
        parts.append(_solver_part(results, results.solvers))
    if results.pipeline is not None:
        parts.append(_pipeline_part(*results.pipeline))
    if results.memory is not None:
        parts.append(_memory_part(results.memory))
    if results.packages is not None:
        parts.append(_packages_part(results.packages))
    return "\n\n".join(parts) + "\n"


def json_of(results: Results) -> dict[str, Any]:
    """Everything in `text_of`, and every single measurement; seconds unless the name says otherwise."""
    document: dict[str, Any] = {"machine": results.machine, "input": results.source}
    if results.solvers is not None:
        reference = _reference(results, results.solvers)
        document["solvers"] = {
            "reference": reference.name if reference else None,
            "distinct_detections": results.detections,
            "fast_converged": results.solvers.converged,
            "fast_doubtful": results.solvers.doubtful,
            "timings": [
                _timing_json(t)
                | ({"times_faster": asdict(t.times_faster_than(reference))} if reference else {})
                for t in results.solvers.timings
            ],
        }
    if results.pipeline is not None:
        detection, pipeline = results.pipeline
        document["pipeline"] = {
            "timings": [_timing_json(t) for t in results.pipeline],
            "share_of_detection_rate": asdict(pipeline.times_faster_than(detection)),
        }
    if results.memory is not None:
        document["memory_mb"] = [asdict(peak) for peak in results.memory]
    if results.packages is not None:
        document["packages_mb"] = asdict(results.packages)
    return document


def table(header: Row, rows: Sequence[Row]) -> str:
    """Columns under their headings, the first flush left and the others flush right."""
    widths = [max(len(row[i]) for row in (header, *rows)) for i in range(len(header))]

    def line(row: Row) -> str:
        cells = [row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True))]
        return "  ".join(cells).rstrip()

    return "\n".join([line(header), line(["-" * w for w in widths]), *map(line, rows)])


def _machine_lines(results: Results) -> str:
    m = results.machine
    load = "" if m["load_before"] is None else f", load {m['load_before']:.1f} before the start"
    packages = ", ".join(f"{name} {number}" for name, number in m["versions"].items())
    return "\n".join(
        [
            f"input: {results.source}",
            f"machine: {m['processor']}, {m['usable_cores']} of {m['cores']} cores{load}",
            f"threads: torch {m['torch_threads']} (solvers take 1), OpenCV {m['opencv_threads']}",
            f"versions: Python {m['python']}, {packages}",
        ]
    )


def _reference(results: Results, solvers: SolverTimings) -> Timing | None:
    return next((t for t in solvers.timings if t.name == results.reference), None)


def _solver_part(results: Results, solvers: SolverTimings) -> str:
    reference = _reference(results, solvers)
    header = ["solver", "ms/frame", "quartiles", "frames/s"]
    if reference is not None:
        header += [f"x {reference.name}", "range"]
    rows = [[t.name, *_solver_cells(t, reference)] for t in solvers.timings]
    rounds = len(solvers.timings[0].rounds)
    notes = [
        f"{rounds} rounds, in each of which all have their turn; batches are made of "
        f"{results.detections} distinct detections",
        f"fast: {100 * solvers.converged:.0f} % of those converged, {100 * solvers.doubtful:.0f} % doubtful",
    ]
    return "\n".join(["Solvers, on the same detections", "", table(header, rows), "", *notes])


def _solver_cells(timing: Timing, reference: Timing | None) -> list[str]:
    seconds = timing.seconds_per_frame
    cells = [_ms(seconds.median), f"{_ms(seconds.low)}-{_ms(seconds.high)}", significant(1 / seconds.median)]
    if reference is not None:
        ratio = timing.times_faster_than(reference)
        cells += [significant(ratio.median), f"{significant(ratio.low)}-{significant(ratio.high)}"]
    return cells


def _pipeline_part(detection: Timing, pipeline: Timing) -> str:
    rows = []
    for timing in (detection, pipeline):
        seconds = timing.seconds_per_frame
        rows.append(
            [
                timing.name,
                significant(1 / seconds.median),
                f"{significant(1 / seconds.high)}-{significant(1 / seconds.low)}",
                _ms(seconds.median),
            ]
        )
    share = pipeline.times_faster_than(detection)
    return "\n".join(
        [
            f"Whole pipeline against detection alone, {detection.frames} frames, "
            f"{len(detection.rounds)} runs of each",
            "",
            table(["", "frames/s", "quartiles", "ms/frame"], rows),
            "",
            f"pipeline / detection: {share.median:.2f} ({share.low:.2f}-{share.high:.2f}) of its frame rate",
        ]
    )


def _memory_part(peaks: Sequence[Peak]) -> str:
    rows = [[f"{p.frames} frames", f"{p.detection:.0f}", f"{p.whole:.0f}", f"{p.take:.1f}"] for p in peaks]
    lines = [
        "Peak of resident memory, MB",
        "",
        table(["clip", "detection", "whole pipeline", "the take itself"], rows),
    ]
    if len(peaks) > 1:
        more = peaks[-1].whole - peaks[0].whole
        more_detecting = peaks[-1].detection - peaks[0].detection
        verdict = "flat" if more <= MOST_MORE_MB else "NOT flat"
        lines += [
            "",
            f"the longest takes {more:+.0f} MB over the shortest ({more_detecting:+.0f} MB of it until the "
            f"end of detection): {verdict}, {MOST_MORE_MB:.0f} MB are allowed",
        ]
    return "\n".join(lines)


def _packages_part(costs: PackageCosts) -> str:
    total = sum(package.installed for package in costs.packages)
    header = ["package", "on disk, MB", "share", "s to load", "quartiles", "memory, MB"]
    header += [] if costs.whole_zip is None else ["in the zip, MB", "share"]
    rows = []
    for package in costs.packages:
        seconds = package.seconds
        row = [
            package.name,
            f"{package.installed:.1f}",
            f"{100 * package.installed / total:.0f} %",
            significant(seconds.median),
            f"{significant(seconds.low)}-{significant(seconds.high)}",
            f"{package.memory:.0f}",
        ]
        if costs.whole_zip is not None and package.zipped is not None:
            row += [f"{package.zipped:.1f}", f"{100 * package.zipped / costs.whole_zip:.0f} %"]
        rows.append(row)
    lines = ["Packages that a capture loads, each in a process that has NumPy", "", table(header, rows)]
    if costs.whole_zip is not None:
        lines += ["", f"the whole zip: {costs.whole_zip:.1f} MB; wheels for several Pythons are added up"]
    return "\n".join(lines)


def _timing_json(timing: Timing) -> dict[str, Any]:
    spread: Spread = timing.seconds_per_frame
    return {
        "name": timing.name,
        "frames_per_call": timing.frames,
        "seconds_per_frame": asdict(spread),
        "frames_per_second": 1 / spread.median,
        "rounds": timing.rounds,
    }


def _ms(seconds: float) -> str:
    return significant(1000 * seconds)


def significant(value: float) -> str:
    """Three significant digits, without an exponent."""
    if abs(value) >= 100:
        return f"{value:.0f}"
    return f"{value:.1f}" if abs(value) >= 10 else f"{value:.2f}" if abs(value) >= 1 else f"{value:.3f}"
