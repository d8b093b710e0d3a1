#!/usr/bin/env python3
"""Train the lifter: what keypoints without depth say of it (handfit_core/interchange/lift.py).

    python scripts/train_lift.py FOLDER               draws poses (some minutes), then trains (some more)
    python scripts/train_lift.py FOLDER --install     and puts the result into the package

Poses are those of the painted pictures, of another seed, and nothing is painted: of every pose each epoch
sees one new projection. FOLDER keeps the poses.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from handfit_core.errors import HandfitError
from handfit_core.files import written_whole
from scripts.training.lift import EPOCHS, poses_of, train

SEED: Final = 500
"""Of the poses; those of tests and of the other networks are others"""
EACH: Final = 500
"""Hands of each usual kind of pose"""
EACH_CLOSED: Final = 16
NETWORK_SEED: Final = 0


def main(argv: Sequence[str] | None = None) -> int:
    """Run the script; returns the exit code."""
    parser = argparse.ArgumentParser(prog="train_lift.py", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="where poses and the result go")
    parser.add_argument("--epochs", type=int, default=EPOCHS, help=f"what ships: {EPOCHS}")
    parser.add_argument("--install", action="store_true", help="write the result into the package")
    args = parser.parse_args(argv)
    try:
        kept = args.folder / f"poses-{SEED}-{EACH}-{EACH_CLOSED}.npz"
        if not kept.is_file():
            with written_whole(kept) as beside, open(beside, "wb") as stream:
                np.savez(stream, angles=poses_of(SEED, EACH, EACH_CLOSED))
        with np.load(kept, allow_pickle=False) as arrays:
            angles = arrays["angles"]
        print(f"{len(angles)} poses", flush=True)
        weights: dict[str, Any] = train(angles, NETWORK_SEED, args.epochs, partial(print, flush=True))
        path = (
            (Path(__file__).parent / "data" / "lift_network.npz")
            if args.install
            else args.folder / (Path(__file__).parent / "data" / "lift_network.npz").name
        )
        with written_whole(path) as beside, open(beside, "wb") as stream:
            np.savez_compressed(stream, **weights)
        print(path)
    except HandfitError as error:
        print(f"train_lift: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
