"""The tables for people and the numbers for machines."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any

from scripts.speed.interleaved import Spread, Timing
from scripts.speed.memory import Peak

PACKAGES = ("numpy", "scipy", "mediapipe", "opencv-python-headless")
MOST_MORE_MB = 200.0
"""What a capture of a long clip may take more than that of a short one"""


@dataclass(frozen=True, eq=False)
class Part:
    """One part of the measurements."""

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    notes: Sequence[str]
    numbers: dict[str, Any]
    """Every single measurement; seconds unless the name says otherwise"""

    def text(self) -> str:
        """Columns under their headings, the first flush left and the others flush right."""
        widths = [max(map(len, column)) for column in zip(self.header, *self.rows, strict=True)]
        lines = [
            "  ".join(
                c.rjust(w) if i else c.ljust(w) for i, (c, w) in enumerate(zip(row, widths, strict=True))
            )
            for row in (self.header, ["-" * width for width in widths], *self.rows)
        ]
        return "\n".join([self.title, "", *map(str.rstrip, lines), "", *self.notes]).rstrip()


def solvers_part(
    timings: Sequence[Timing], reference: str, detections: int, converged: float, doubtful: float
) -> Part:
    """All solvers, and how many times faster than `reference` each is.

    `detections` were distinct; of the fast solver's fits to them these shares converged and are doubtful.
    """
    compared = next((t for t in timings if t.name == reference), None)
    header = ["solver", "ms/frame", "quartiles", "frames/s"]
    rows, numbers = [], []
    for timing in timings:
        row = [timing.name, *_per_frame(timing)]
        numbers.append(_numbers(timing))
        if compared is not None:
            ratio = timing.times_faster_than(compared)
            row += [significant(ratio.median), _range(ratio)]
            numbers[-1]["times_faster"] = asdict(ratio)
        rows.append(row)
    if compared is not None:
        header += [f"x {compared.name}", "range"]
    notes = [
        f"{len(timings[0].rounds)} rounds, in each of which all have their turn; batches are made of "
        f"{detections} distinct detections",
        f"fast: {100 * converged:.0f} % of those converged, {100 * doubtful:.0f} % doubtful",
    ]
    found = {
        "reference": compared and compared.name,
        "distinct_detections": detections,
        "fast_converged": converged,
        "fast_doubtful": doubtful,
        "timings": numbers,
    }
    return Part("Solvers, on the same detections", header, rows, notes, {"solvers": found})


def pipeline_part(detection: Timing, pipeline: Timing) -> Part:
    """The whole pipeline beside detection alone."""
    share = pipeline.times_faster_than(detection)
    both = (detection, pipeline)
    numbers = {"timings": list(map(_numbers, both)), "share_of_detection_rate": asdict(share)}
    return Part(
        f"Whole pipeline against detection alone, {detection.frames} frames, "
        f"{len(detection.rounds)} runs of each",
        ["", "ms/frame", "quartiles", "frames/s"],
        [[timing.name, *_per_frame(timing)] for timing in both],
        [f"pipeline / detection: {share.median:.2f} ({share.low:.2f}-{share.high:.2f}) of its frame rate"],
        {"pipeline": numbers},
    )


def memory_part(peaks: Sequence[Peak]) -> Part:
    """The peak of each clip, and whether the longest takes more than it may."""
    notes = []
    if len(peaks) > 1:
        more, detecting = (getattr(peaks[-1], n) - getattr(peaks[0], n) for n in ("whole", "detection"))
        notes.append(
            f"the longest takes {more:+.0f} MB over the shortest ({detecting:+.0f} MB of it until the end of "
            f"detection): {'flat' if more <= MOST_MORE_MB else 'NOT flat'}, {MOST_MORE_MB:.0f} MB are allowed"
        )
    return Part(
        "Peak of resident memory, MB",
        ["clip", "detection", "whole pipeline", "the take itself"],
        [[f"{p.frames} frames", f"{p.detection:.0f}", f"{p.whole:.0f}", f"{p.take:.1f}"] for p in peaks],
        notes,
        {"memory_mb": [asdict(peak) for peak in peaks]},
    )


def machine_facts() -> dict[str, Any]:
    """What a timing depends on besides the code; nothing that names the machine."""
    on_linux = sys.platform == "linux"
    return {
        "processor": _processor() if on_linux else platform.processor() or "unknown",
        "cores": os.cpu_count(),
        "usable_cores": len(os.sched_getaffinity(0)) if on_linux else os.cpu_count(),
        "load_before": None if sys.platform == "win32" else round(os.getloadavg()[0], 2),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "versions": {package: version(package) for package in PACKAGES},
    }


def _processor() -> str:
    with open("/proc/cpuinfo", encoding="utf-8") as stream:
        names = (line.partition(":")[2].strip() for line in stream if line.startswith("model name"))
        return next(names, "unknown")


def machine_text(facts: dict[str, Any]) -> str:
    """The machine in two lines."""
    load = "" if facts["load_before"] is None else f", load {facts['load_before']:.1f} before the start"
    packages = ", ".join(f"{name} {number}" for name, number in facts["versions"].items())
    return (
        f"machine: {facts['processor']}, {facts['usable_cores']} of {facts['cores']} cores{load}\n"
        f"versions: Python {facts['python']}, {packages}"
    )


def _per_frame(timing: Timing) -> list[str]:
    seconds = timing.seconds_per_frame
    milliseconds = Spread(1000 * seconds.median, 1000 * seconds.low, 1000 * seconds.high)
    return [significant(milliseconds.median), _range(milliseconds), significant(1 / seconds.median)]


def _numbers(timing: Timing) -> dict[str, Any]:
    seconds = timing.seconds_per_frame
    rate = {"seconds_per_frame": asdict(seconds), "frames_per_second": 1 / seconds.median}
    return {"name": timing.name, "frames_per_call": timing.frames, **rate, "rounds": timing.rounds}


def _range(spread: Spread) -> str:
    return f"{significant(spread.low)}-{significant(spread.high)}"


def significant(value: float) -> str:
    """Three significant digits, without an exponent."""
    if abs(value) >= 100:
        return f"{value:.0f}"
    return f"{value:.1f}" if abs(value) >= 10 else f"{value:.2f}" if abs(value) >= 1 else f"{value:.3f}"
