#!/usr/bin/env python3
"""Calibrate how far off fits are expected to be (handfit_core/fit/doubt.py).

    python scripts/train_doubt.py FOLDER              makes samples (some ten minutes), fits them, calibrates
    python scripts/train_doubt.py FOLDER --install    and puts the result into the package

Samples are those of train_landmarks.py, of other seeds: networks know too well what they were trained on. Run
it again whenever the networks, the hand or the solver have changed. FOLDER keeps the samples.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from handfit_core.detect.correction.corrected import with_side_judged
from handfit_core.detect.keypoints import Detections
from handfit_core.errors import HandfitError
from handfit_core.evaluate.summary import doubt_figures
from handfit_core.files import written_whole
from handfit_core.fit import doubt
from handfit_core.fit.doubt import evidence, side_logits
from handfit_core.fit.fast import fitter_of
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.similarity import align
from handfit_core.skeleton import SIDES
from scripts.benchmark.kinematics import model_of
from scripts.train_landmarks import samples_of_stills

SHIPPED, CHECKED = "300:500,302:250:closed", "301:250,303:100:closed"
ITERATIONS = 30


def main(argv: Sequence[str] | None = None) -> int:
    """Run the script; returns the exit code."""
    parser = argparse.ArgumentParser(prog="train_doubt.py", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="where samples and the result go")
    pictures = "painted pictures, of which seeds, to %s with; what ships: %s"
    for name, use, shipped in (("--stills", "calibrate", SHIPPED), ("--check", "measure", CHECKED)):
        parser.add_argument(
            name, default=shipped, metavar="SEED:COUNT[:closed],...", help=pictures % (use, shipped)
        )
    parser.add_argument("--install", action="store_true", help="write the result into the package")
    args = parser.parse_args(argv)
    try:
        found = calibrated(*fitted(samples_of_stills(args.folder, args.stills)))
        path = doubt.FILE if args.install else args.folder / doubt.FILE.name
        with written_whole(path) as beside, open(beside, "wb") as stream:
            np.savez(stream, **found)
        print(path, *(f"\n{name}: {np.round(values, 3)}" for name, values in found.items()))
        features, errors = fitted(samples_of_stills(args.folder, args.check))
        expected = 1e3 * np.exp(features @ found["weights"] + found["constants"]).mean(axis=1)
        true = 1e3 * errors.mean(axis=1)
        print(f"{len(true)} hands: {expected.mean():.1f} mm expected, {true.mean():.1f} mm true")
        print(doubt_figures(expected, true))
    except HandfitError as error:
        print(f"train_doubt: {error}", file=sys.stderr)
        return 2
    return 0


def fitted(samples: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """`doubt.evidence` (N, 5, 6) of samples, fitted as captures do it, and their fingers' true errors (N, 5),
    metres."""
    seen = (samples[name] for name in ("detected_side", "score", "keypoints", "world"))
    detections = with_side_judged(Detections(np.arange(len(samples["score"])), *seen))
    features, errors = [], []
    for side in SIDES:
        rows = np.flatnonzero(detections.likely_side == SIDES.index(side))
        chosen, model = detections.select(rows), model_of(side)
        size = int(samples["size"][0])
        camera = Intrinsics.assumed(size, size)
        fitter = fitter_of(model)
        seen, solution = fitter.solve_pictures(fitter.observe(chosen, camera))
        points = fitter.chain.points(solution.state)
        features.append(evidence(seen, points, side_logits(chosen, side)))
        betas, *poses = fitter.chain.parameters(solution.state)
        for i, row in enumerate(rows):
            pose = (values[i : i + 1] for values in poses)
            joints, true = model.keypoints(betas[i], *pose)[0], samples["joints_3d"][row]
            off = np.linalg.norm(align(joints, true, with_scale=True).apply(joints) - true, axis=1)
            errors.append(off[1:].reshape(5, 4).mean(axis=1))
    return np.concatenate(features), np.array(errors)


def calibrated(features: np.ndarray, errors: np.ndarray) -> dict[str, Any]:
    """The weights (6,) and each finger's constant (5,) with which errors (N, 5) are likeliest, were they
    exponentially distributed: the expected ones are then right in the mean. Newton's method."""
    count, _, size = features.shape
    whole = np.concatenate([features, np.broadcast_to(np.eye(5), (count, 5, 5))], axis=2).reshape(
        -1, size + 5
    )
    found = np.concatenate([np.zeros(size), np.full(5, np.log(errors.mean()))])
    for _ in range(ITERATIONS):
        share = errors.reshape(-1) * np.exp(-whole @ found)
        found += np.linalg.solve((whole.T * np.maximum(share, 0.1)) @ whole, whole.T @ (share - 1.0))
    return {"weights": found[:size], "constants": found[size:]}


if __name__ == "__main__":
    sys.exit(main())
