"""Capture one clip and print this process's peaks of memory as JSON: `memory_child CLIP SOLVER`."""

from __future__ import annotations

import json
import sys

from handfit_core.pipeline import Progress, capture
from handfit_core.take import Take

MB = 1_000_000


def main(clip: str, solver: str) -> None:
    """Run the capture."""
    after_detection = 0.0

    def look(progress: Progress) -> None:
        nonlocal after_detection
        if progress.stage == "detect":
            after_detection = peak_memory()

    take = capture(clip, solver=solver, progress=look)
    print(json.dumps({"detection": after_detection, "whole": peak_memory(), "take": size_of(take)}))


def peak_memory() -> float:
    """The most resident memory that this process has held so far, in MB (10^6 bytes)."""
    try:
        # Not getrusage: on Linux it starts with the parent's peak.
        with open("/proc/self/status", encoding="ascii", errors="replace") as stream:
            kib = next(int(line.split()[1]) for line in stream if line.startswith("VmHWM:"))
        return kib * 1024 / MB
    except OSError:
        import resource  # not on Windows, where the benchmark of memory does not run

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MB


def size_of(take: Take) -> float:
    """Bytes of a take's arrays, in MB."""
    arrays = [value for hand in take.hands for value in vars(hand).values() if hasattr(value, "nbytes")]
    return sum(array.nbytes for array in arrays) / MB


if __name__ == "__main__":
    main(*sys.argv[1:])
