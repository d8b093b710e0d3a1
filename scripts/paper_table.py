#!/usr/bin/env python3
"""The paper's solvers on labelled pictures: mean joint error after similarity alignment, and time.

    python scripts/paper_table.py FOLDER [--solvers paper-a,paper-b,...] [--every 1] [-o table.md]

FOLDER holds pictures and an index.json: a list of {"file", "hand", "joints_3d_mm"} with 21 joints in
MediaPipe's order. Every picture is detected once; all solvers fit the same detections, in turn, so that
their times compare. Pictures without a detection are counted, not scored.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from handfit_core.align import align
from handfit_core.camera import Intrinsics
from handfit_core.detect.mediapipe_tasks import MediaPipeHands
from handfit_core.errors import HandfitError, InputError
from handfit_core.hand_model import HandModel, load_model
from handfit_core.keypoints import HandDetection
from handfit_core.media import read_picture
from handfit_core.solvers import PAPER_SOLVERS, solver_names
from handfit_core.solvers.paper import PaperFitter


def main() -> int:
    """Run the script; returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--solvers", default=",".join(solver_names()))
    parser.add_argument("--every", type=int, default=1, help="use every n-th picture only")
    parser.add_argument("-o", "--output", type=Path, help="write the table there too")
    args = parser.parse_args()
    try:
        table = measure(args.folder, args.solvers.split(","), args.every)
    except HandfitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(table)
    if args.output:
        args.output.write_text(table + "\n", encoding="utf-8")
    return 0


def measure(folder: Path, solvers: list[str], every: int) -> str:
    """The table as Markdown."""
    index = folder / "index.json"
    if not index.is_file():
        raise InputError(f"{folder}: no index.json in it; see the head of this script for the layout")
    samples = json.loads(index.read_text(encoding="utf-8"))[::every]
    errors: dict[str, list[float]] = {name: [] for name in ("image landmarks", "world landmarks", *solvers)}
    seconds: dict[str, list[float]] = {name: [] for name in solvers}
    sides = sorted({sample["hand"] for sample in samples})
    models = {side: load_model(None, side) for side in sides}
    fitters = {(n, s): PaperFitter(models[s], PAPER_SOLVERS[n]) for n in solvers for s in sides}
    detected = 0
    with MediaPipeHands(max_hands=1) as detector:
        for number, sample in enumerate(samples, 1):
            picture = read_picture(folder / sample["file"])[0]
            found = detector.detect(picture)
            print(f"\r{number}/{len(samples)}", end="", file=sys.stderr, flush=True)
            if not found:
                continue
            detected += 1
            truth = np.array(sample["joints_3d_mm"])
            errors["image landmarks"].append(pa_mpjpe(found[0].keypoints, truth))
            errors["world landmarks"].append(pa_mpjpe(found[0].world, truth))
            for name in solvers:
                started = time.perf_counter()
                camera = Intrinsics.assumed(picture.shape[1], picture.shape[0])
                points = fitted(fitters[name, sample["hand"]], models[sample["hand"]], found[0], camera)
                seconds[name].append(time.perf_counter() - started)
                errors[name].append(pa_mpjpe(points, truth))
    print(file=sys.stderr)
    lines = [
        f"{detected} of {len(samples)} pictures with a detected hand.",
        "",
        "| | PA-MPJPE mean, mm | median | seconds per frame, median |",
        "|---|---|---|---|",
    ]
    for name, values in errors.items():
        spent = f"{np.median(seconds[name]):.2f}" if name in seconds else "-"
        lines.append(f"| {name} | {np.mean(values):.2f} | {np.median(values):.2f} | {spent} |")
    return "\n".join(lines)


def fitted(fitter: PaperFitter, model: HandModel, detection: HandDetection, camera: Intrinsics) -> np.ndarray:
    """The fitted hand's 21 keypoints (21, 3) in metres, placed before an assumed camera."""
    fit = fitter.fit(detection.keypoints)
    hand = fitter.place(fit, detection.keypoints, camera, fit_shape=True)
    return model.keypoints(hand.betas, hand.global_orient, hand.hand_pose, hand.transl)


def pa_mpjpe(points: np.ndarray, truth: np.ndarray) -> float:
    """Mean distance of (21, 3) points to the truth after the best similarity transform, truth's unit."""
    return float(np.linalg.norm(align(points, truth, with_scale=True).apply(points) - truth, axis=-1).mean())


if __name__ == "__main__":
    sys.exit(main())
