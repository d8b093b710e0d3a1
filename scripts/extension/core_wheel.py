"""handfit_core as a wheel, with the landmark model in it. The same source gives the same bytes."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

from handfit_core.detect import landmark_model
from scripts.extension import archive
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


def core_wheel(folder: Path, root: Path = ROOT) -> WheelFile:
    """Build the wheel of the checkout `root` into `folder`.

    From a copy of the source: setuptools leaves files beside it, and takes in what it finds there the next
    time. Raises BuildError, also where the source holds a file that is not the core's, or
    LandmarkModelError where the landmark model is not to be had.
    """
    files = source_files(root)
    tools = fetched(read_lock(BUILD_LOCK).pins, None, None)
    with tempfile.TemporaryDirectory() as temporary:
        source, tool_folder = Path(temporary) / "source", Path(temporary) / "tools"
        for name in (*files, *BESIDE):
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(root / name, source / name)
        shutil.copyfile(checked_landmark_model(), source / "handfit_core" / LANDMARK_MODEL)
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
    archive.fix(built[0])
    wheel = wheel_file(built[0])
    expected = {*files, f"handfit_core/{LANDMARK_MODEL}"}
    inside = {name for name in wheel.members if ".dist-info/" not in name}
    if inside != expected:
        raise BuildError(
            f"handfit_core's wheel differs from its source in {', '.join(sorted(inside ^ expected))}; "
            "list packages and data in pyproject.toml"
        )
    return wheel


def data_files(root: Path = ROOT) -> set[str]:
    """The core's files other than modules, as pyproject.toml lists them: POSIX paths from `root`."""
    settings = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    return {
        f"{package.replace('.', '/')}/{name}"
        for package, names in settings["package-data"].items()
        for name in names
    }


def source_files(root: Path = ROOT) -> list[str]:
    """Modules and data of handfit_core, but for the landmark model: POSIX paths from `root`, sorted.

    Raises BuildError where anything else lies there, such as MANO's files, which must not be passed on.
    """
    allowed = data_files(root)
    found = []
    for path in sorted((root / "handfit_core").rglob("*")):
        name = path.relative_to(root).as_posix()
        parts = name.split("/")
        if path.is_dir() or "__pycache__" in parts or any(part.startswith(".") for part in parts):
            continue
        if path.suffix != ".py" and name not in allowed:
            raise BuildError(
                f"{name}: this is not one of the core's files, and must not go into the zip; move it "
                "elsewhere (MANO's files are named in the add-on's preferences), or list it in pyproject.toml"
            )
        if name != f"handfit_core/{LANDMARK_MODEL}":
            found.append(name)
    return found


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
