#!/usr/bin/env python3
"""Measure how fast solvers and whole captures are.

    python scripts/measure_speed.py                            the bundled pictures, about a minute
    python scripts/measure_speed.py one.mp4 two.mp4            both clips, one after the other
    python scripts/measure_speed.py clip.mp4 --frames 1-300    a part of a clip

Solvers fit the hand that the first INPUT shows most. What is compared takes turns in every round, so that
another program's load hits all alike, and ratios are taken within rounds. Run it on an idle machine all the
same.
"""

from __future__ import annotations

import os

# Before SciPy loads: more BLAS threads than one only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from handfit_core.capturing.detection import detect_frames, open_detector
from handfit_core.capturing.options import CaptureOptions
from handfit_core.capturing.pipeline import capture
from handfit_core.common.errors import HandfitError, OptionError
from handfit_core.detect.keypoints import Track
from handfit_core.detect.tracks import link_tracks
from handfit_core.fit.fast import fitter_of
from handfit_core.fit.solvers import get_solver
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model import load_model
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.opening import open_media

SAMPLE = str(ROOT / "samples" / "rendered_hand" / "hand.%04d.jpg")
BATCH = 256

Timed = Mapping[str, tuple[Callable[[], object], int]]
"""Name -> what is timed, and how many frames one call does"""


def main(argv: Sequence[str] | None = None) -> int:
    """Measure and print; returns the exit code. User errors are one line on stderr."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("input", nargs="*", default=[SAMPLE], metavar="INPUT", help="default: the sample")
    parser.add_argument("--frames", metavar="A-B:S", help="source frames, as in 1-300:2 (default: all)")
    parser.add_argument("--slow", default="paper-a", metavar="SOLVER", help="to compare with")
    parser.add_argument("--rounds", type=int, default=5, metavar="N", help="default: 5")
    args = parser.parse_args(argv)
    try:
        if args.rounds < 1:
            raise OptionError("--rounds must be at least 1")
        frames = FrameRange.parse(args.frames) if args.frames else None
        measured = [("solvers", solvers(args.input[0], frames, args.slow))]
        measured += [(Path(source).stem, captures(source, frames)) for source in args.input]
        for title, timed in measured:
            print(table(title, timed, paired_times(timed, args.rounds)), end="\n\n", flush=True)
    except HandfitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def solvers(source: str, frames: FrameRange | None, slow: str) -> Timed:
    """A slow solver and the fast one on one frame, and the fast one on a batch. Raises HandfitError."""
    media = open_media(source, frames)
    found = detect_frames(media, CaptureOptions(processes=1))
    track = max(link_tracks(found.hands, len(found.numbers)), key=lambda t: len(t.detections))
    model, intrinsics = load_model(None, track.side), Intrinsics.assumed(media.width, media.height)
    one = replace(track.detections.select(np.array([0])), frame=np.zeros(1, dtype=int))
    single = Track(track.side, one, frame_count=1, fps=media.fps)
    batch = track.detections.select(np.arange(BATCH) % len(track.detections))
    fitter, slow_solver, fast = fitter_of(model), get_solver(slow), get_solver("fast")
    return {
        slow: (lambda: slow_solver(model, single, intrinsics, lambda: None), 1),
        "fast, one frame": (lambda: fast(model, single, intrinsics, lambda: None), 1),
        f"fast, {BATCH} frames": (lambda: fitter.solve_pictures(fitter.observe(batch, intrinsics)), BATCH),
    }


def captures(source: str, frames: FrameRange | None) -> Timed:
    """Reading an input and finding its hands with MediaPipe's VIDEO mode, two at most, and with our detector;
    and capturing it from file to take. Raises HandfitError."""

    def by_mediapipe() -> None:
        with open_detector(CaptureOptions(detector="mediapipe", max_hands=2), video=True) as detector:
            for frame in open_media(source, frames).frames():
                detector.find(frame.rgb, frame.time)

    def detect() -> int:
        return len(detect_frames(open_media(source, frames), CaptureOptions()).numbers)

    count = detect()
    return {
        "MediaPipe's VIDEO": (by_mediapipe, count),
        "detection": (detect, count),
        "capture": (lambda: capture(source, frames=frames), count),
        "capture, draft": (lambda: capture(source, frames=frames, quality="draft"), count),
    }


def paired_times(timed: Timed, rounds: int) -> np.ndarray:
    """Seconds (rounds, N) of N calls, which take turns; a round before the first is not counted."""
    seconds = np.empty((rounds + 1, len(timed)))
    for row in seconds:
        for i, (call, _) in enumerate(timed.values()):
            began = time.perf_counter()
            call()
            row[i] = time.perf_counter() - began
    return seconds[1:]


def table(title: str, timed: Timed, seconds: np.ndarray) -> str:
    """Median milliseconds a frame, and the median, lowest and highest ratio of the first's to each one's."""
    each = seconds / [frames for _, frames in timed.values()]
    ratios = each[:, :1] / each
    lines = [f"{title:<20} ms/frame  times faster"]
    for name, own, ratio in zip(timed, each.T, ratios.T, strict=True):
        lines.append(
            f"{name:<20} {1000.0 * np.median(own):8.3g}  {np.median(ratio):.3g} "
            f"({ratio.min():.3g} to {ratio.max():.3g})"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
