#!/usr/bin/env python3
"""Assemble MediaPipe's hand_landmarker.task from the pinned wheel on the package index.

    python scripts/fetch_landmark_model.py            # into the cache, where everything finds it
    python scripts/fetch_landmark_model.py --wheel mediapipe-0.10.21-....whl -o hand_landmarker.task

It is run while setting up, never by the add-on.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from scripts.needed import need

need("numpy", "python -m pip install -c constraints.txt .")

from handfit_core.detect import landmark_model
from handfit_core.errors import HandfitError, LandmarkModelError
from scripts.extension.wheels import BuildError, pip


def main() -> int:
    """Run the script; returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--wheel", type=Path, help="use this wheel instead of downloading it")
    parser.add_argument("-o", "--output", type=Path, help="where to write the file (default: the cache)")
    parser.add_argument("--force", action="store_true", help="assemble it even if it is there already")
    args = parser.parse_args()
    output = args.output or landmark_model.cached_path()
    if output.is_file() and not args.force:
        print(f"{output}: already there")
        return 0
    try:
        with tempfile.TemporaryDirectory() as folder:
            wheel = args.wheel or download_wheel(Path(folder))
            landmark_model.assemble(wheel, output)
    except HandfitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(f"{output}: assembled ({output.stat().st_size / 1e6:.1f} MB)")
    return 0


def download_wheel(folder: Path) -> Path:
    """Download the pinned wheel with pip. Raises LandmarkModelError."""
    of_linux = ["--python-version", landmark_model.WHEEL_PYTHON, "--platform", landmark_model.WHEEL_PLATFORM]
    options = ["--no-deps", "--only-binary=:all:", *of_linux, "--dest", str(folder)]
    try:
        pip("download", landmark_model.WHEEL_REQUIREMENT, *options)
    except BuildError as error:
        raise LandmarkModelError(
            f"{landmark_model.WHEEL_REQUIREMENT} could not be downloaded ({error}); check the network, or "
            "download the wheel elsewhere and give it with --wheel"
        ) from error
    return next(folder.glob("*.whl"))


if __name__ == "__main__":
    sys.exit(main())
