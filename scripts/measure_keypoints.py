#!/usr/bin/env python3
"""Measure what keypoints without depth are worth: clips that were captured, fitted again to the x and y alone
that their detector saw, spoilt or not, against fits of all that it saw.

    python scripts/measure_keypoints.py TAKE [...]
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

import numpy as np

from handfit_core.detect.keypoints import Detections, Track
from handfit_core.errors import HandfitError
from handfit_core.evaluate.flat import Flat, flattened
from handfit_core.fitting import hand_track
from handfit_core.geometry.similarity import align
from handfit_core.hand_model import load_model
from handfit_core.solvers import get_solver
from handfit_core.take import HandTrack, Take

SPOILT: Final = tuple(Flat(noise, missing) for missing in (0.0, 0.1) for noise in (0.0, 0.01, 0.02))


def main(argv: Sequence[str] | None = None) -> int:
    """Print a line per hand and way of spoiling; returns the exit code."""
    parser = argparse.ArgumentParser(prog="measure_keypoints.py", description="Keypoints without depth.")
    parser.add_argument("takes", nargs="+", type=Path, metavar="TAKE")
    parser.add_argument("--solver", default="fast", help="what fits (default: fast)")
    parser.add_argument(
        "--every", type=int, default=1, metavar="N", help="every n-th frame, for slow solvers"
    )
    args = parser.parse_args(argv)
    try:
        for path in args.takes:
            take = Take.load(path)
            for hand in take.hands:
                measure(f"{path.name}, {hand.side} hand", take, hand, args.solver, args.every)
    except HandfitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def measure(name: str, take: Take, hand: HandTrack, solver: str, every: int) -> None:
    """Print what fits of one hand's keypoints are off its capture."""
    rows = np.flatnonzero(hand.detected)[::every]
    detections = hand.detections(rows)
    as_captured = fitted(take, hand, detections, solver, every)
    print(f"{name}: {len(rows)} frames, its own keypoints {reprojection(as_captured):.2f} % off its fit")
    for flat in SPOILT:
        lifted = flattened(detections, flat)
        found = fitted(take, hand, lifted, solver, every)
        apart = [
            1000 * np.linalg.norm(align(a, b, with_scale=True).apply(a) - b, axis=1).mean()
            for a, b in zip(found.joints_3d, as_captured.joints_3d, strict=True)
        ]
        # Against the keypoints before they were spoilt.
        clean = replace(found, reprojection_error=_off(take, found, as_captured.keypoints_2d))
        print(
            f"  noise {flat.noise:.0%}, {flat.missing:.0%} missing: PA {np.mean(apart):.2f} mm "
            f"(95th percentile {np.percentile(apart, 95):.1f}) from its capture; the detector's keypoints "
            f"{reprojection(clean):.2f} % of the hand off",
            flush=True,
        )


def fitted(take: Take, hand: HandTrack, detections: Detections, solver: str, every: int) -> HandTrack:
    """Those detections as one clip."""
    model = load_model(take.model, hand.side)
    track = Track(hand.side, detections, len(detections), take.fps / every)
    fit = get_solver(solver)(model, track, take.intrinsics, lambda: None)
    return hand_track(model, track, fit, take.intrinsics)


def _off(take: Take, hand: HandTrack, keypoints: np.ndarray) -> np.ndarray:
    """(T,) pixels that a fit's joints project from those keypoints (T, 21, 2) on average."""
    return np.linalg.norm(take.intrinsics.project(hand.joints_3d) - keypoints, axis=-1).mean(axis=1)


def reprojection(hand: HandTrack) -> float:
    """What its fit is off its keypoints, in percent of its size."""
    size = np.ptp(hand.keypoints_2d, axis=1).max(axis=1)
    return float(np.mean(hand.reprojection_error / size) * 100.0)


if __name__ == "__main__":
    sys.exit(main())
