#!/usr/bin/env python3
"""Train what ships as learned: landmark offsets, the pose prior and the landmark network.

    python scripts/train_landmarks.py FOLDER                  makes samples (an hour or two), then trains
    python scripts/train_landmarks.py FOLDER --install        and puts the results into the package

Samples are what MediaPipe's networks see in painted pictures of the open hand, beside the truth,
in usual poses and closed ones. Seeds are 100 and above; the rendered benchmark's test seed is 0. Needs no
Blender. FOLDER keeps the samples: an interrupted run goes on where it stopped.
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

from handfit_core.detect.correction import network
from handfit_core.errors import HandfitError, OptionError
from handfit_core.files import written_whole
from handfit_core.hand_model.anatomy import LANDMARKS_FILE
from handfit_core.hand_model.landmarks import Landmarks
from scripts.benchmark.stills import Poses

LEAST_SEED = 100
"""Seeds below are for rendered benchmarks: nothing is trained on what is tested"""
SHIPPED = "100:12000,101:6500"
NETWORK_SEED = 0
CHUNK = 250
"""Stills per file of samples"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the script; returns the exit code."""
    parser = argparse.ArgumentParser(prog="train_landmarks.py", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="where samples and results go")
    parser.add_argument(
        "--stills",
        default=SHIPPED,
        metavar="SEED:COUNT[:closed],...",
        help=f"painted pictures, maybe of closed hands, of seeds {LEAST_SEED} or more; what ships: {SHIPPED}",
    )
    parser.add_argument("--install", action="store_true", help="write the results into the package")
    args = parser.parse_args(argv)
    try:
        _train(samples_of_stills(args.folder, args.stills), args.folder, install=args.install)
    except HandfitError as error:
        print(f"train_landmarks: {error}", file=sys.stderr)
        return 2
    return 0


def _asked(text: str) -> list[tuple[int, int, Poses]]:
    """`SEED:COUNT[:closed],...` -> seeds, counts and which hands. Raises OptionError."""
    found: list[tuple[int, int, Poses]] = []
    try:
        for part in text.split(","):
            seed, count, *closed = part.split(":")
            if closed not in ([], ["closed"]):
                raise ValueError
            found.append((int(seed), int(count), "closed" if closed else "usual"))
    except ValueError:
        raise OptionError(f"--stills wants SEED:COUNT[:closed],..., as in {SHIPPED}, not {text!r}") from None
    if any(seed < LEAST_SEED or count < 1 for seed, count, _ in found):
        raise OptionError(
            f"--stills wants seeds of {LEAST_SEED} or more and counts of 1 or more, not {text!r}"
        )
    return found


def samples_of_stills(folder: Path, text: str) -> dict[str, np.ndarray]:
    """Stacked rows of the stills that `SEED:COUNT[:closed],...` asks for; made where `folder` does not keep
    them. Raises OptionError."""
    kept = [rows for asked in _asked(text) if (rows := _samples(folder, *asked))]
    if not kept:
        raise OptionError("the detector found no hand in these pictures; ask for more --stills")
    return {name: np.concatenate([rows[name] for rows in kept]) for name in kept[0]}


def _samples(folder: Path, seed: int, stills: int, poses: Poses) -> dict[str, np.ndarray]:
    """Stacked rows of all stills; made where they are not kept."""
    from handfit_core.detect.networks import Networks
    from scripts.training.samples import samples_of

    kept = []
    with Networks() as networks:
        for first in range(0, stills, CHUNK):
            path = folder / f"samples-{seed}-{first:06d}-{min(first + CHUNK, stills):06d}.npz"
            if not path.is_file():
                numbers = range(first, min(first + CHUNK, stills))
                found = [
                    row for number in numbers for row in samples_of(seed, number, networks, poses=poses)[1]
                ]
                names = found[0] if found else ()
                columns: dict[str, Any] = {name: np.array([row[name] for row in found]) for name in names}
                with written_whole(path) as beside, open(beside, "wb") as stream:
                    np.savez(stream, **columns)
                print(f"stills {first}..{first + CHUNK - 1}: {len(found)} samples", flush=True)
            with np.load(path, allow_pickle=False) as arrays:
                kept.append(dict(arrays))
    kept = [rows for rows in kept if rows]
    return {name: np.concatenate([rows[name] for rows in kept]) for name in kept[0]} if kept else {}


def _train(samples: dict[str, np.ndarray], folder: Path, *, install: bool) -> None:
    from scripts.training.learn import calibrate, pose_prior, train

    offsets = calibrate(samples)
    mean, covariance = pose_prior(samples)
    weights = train(samples, Landmarks(offsets), NETWORK_SEED, lambda line: print(line, flush=True))
    found: dict[Path, dict[str, Any]] = {
        LANDMARKS_FILE: {"offsets": offsets, "pose_mean": mean, "pose_covariance": covariance},
        network.FILE: weights,
    }
    for file, arrays in found.items():
        path = file if install else folder / file.name
        with written_whole(path) as beside, open(beside, "wb") as stream:
            np.savez_compressed(stream, **arrays)
        print(path)


if __name__ == "__main__":
    sys.exit(main())
