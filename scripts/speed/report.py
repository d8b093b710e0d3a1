"""The tables for people and the numbers for machines."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any

from handfit_core.machine import usable_cores
from scripts.speed.memory import Peak
from scripts.speed.timings import Timing

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


def timed_part(
    key: str, title: str, timings: Sequence[Timing], reference: str, notes: Sequence[str], **more: Any
) -> Part:
    """What takes how long, and how many times faster than `reference` each is; `more` goes to the numbers."""
    compared = next((t for t in timings if t.name == reference), None)
    header = ["", "ms/frame", "quartiles", "frames/s"]
    header += [f"x {compared.name}", "range"] if compared else []
    rows, numbers = [], []
    for timing in timings:
        seconds = timing.seconds_per_frame
        rate = {"seconds_per_frame": seconds._asdict(), "frames_per_second": 1 / seconds.median}
        calls = {"frames_per_call": timing.frames, "rounds": timing.rounds}
        numbers.append({"name": timing.name, **calls, **rate})
        median, *quartiles = (1000 * value for value in seconds)
        rows.append([timing.name, significant(median), _range(*quartiles), significant(1 / seconds.median)])
        if compared:
            ratio = timing.times_faster_than(compared)
            rows[-1] += [significant(ratio.median), _range(ratio.low, ratio.high)]
            numbers[-1]["times_faster"] = ratio._asdict()
    found = {"reference": compared and compared.name, **more, "timings": numbers}
    return Part(title, header, rows, notes, {key: found})


def solvers_part(
    timings: Sequence[Timing], reference: str, detections: int, converged: float, doubtful: float
) -> Part:
    """All solvers, and how many times faster than `reference` each is.

    `detections` were distinct; of the fast solver's fits to them these shares converged and are doubtful.
    """
    notes = [
        f"{len(timings[0].rounds)} rounds, in each of which all have their turn; batches are made of "
        f"{detections} distinct detections",
        f"fast: {100 * converged:.0f} % of those converged, {100 * doubtful:.0f} % doubtful",
    ]
    shares = {"fast_converged": converged, "fast_doubtful": doubtful}
    title = "Solvers, on the same detections"
    return timed_part("solvers", title, timings, reference, notes, distinct_detections=detections, **shares)


def pipeline_part(detection: Timing, pipeline: Timing) -> Part:
    """The whole pipeline beside detection alone, and the share of its frame rate."""
    title = "Whole pipeline against detection alone"
    title += f", {detection.frames} frames, {len(detection.rounds)} runs of each"
    return timed_part("pipeline", title, (detection, pipeline), detection.name, ())


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
        "usable_cores": usable_cores(),
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


def _range(low: float, high: float) -> str:
    return f"{significant(low)}-{significant(high)}"


def significant(value: float) -> str:
    """Three significant digits, without an exponent."""
    before_the_point = len(str(int(abs(value)))) if abs(value) >= 1 else 0
    return f"{value:.{max(0, 3 - before_the_point)}f}"
