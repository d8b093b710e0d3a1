"""handfit_core as a wheel, with the landmark models in it. The same source gives the same bytes."""

from __future__ import annotations

import os
import shutil
import tempfile
import tomllib
from pathlib import Path

from handfit_core.detect import landmark_model
from scripts.extension.staging import ROOT, fix
from scripts.extension.wheels import BUILD_LOCK, BuildError, Wheel, fetched, pip, read_lock
from scripts.fetch_landmark_model import landmark_models

BESIDE = ("pyproject.toml", "README.md", "LICENSE", "blender_manifest.toml")
"""Files that the core's build reads."""
NOT_THE_ARTISTS = ("handfit_core/evaluate/", "handfit_core/capturing/live/send.py")
"""Modules that only a checkout has."""

_FILES = (landmark_model.TASK, landmark_model.BODY, landmark_model.NETWORK_2020)
LANDMARK_MODELS = tuple(f"handfit_core/detect/data/{file.name}" for file in _FILES)
"""`landmark_model` looks there."""

SAME_TIME = "1577836800"
"""Seconds since 1970 of the files in the wheel: 2020-01-01"""


def core_wheel(folder: Path, root: Path = ROOT) -> Wheel:
    """Build the wheel of the checkout `root` into `folder`.

    From a copy of the source: setuptools leaves files beside it, and takes in what it finds there the next
    time. Raises BuildError, also where the source holds a file that is not the core's, or
    LandmarkModelError where a landmark model is not to be had.
    """
    files = source_files(root)
    (setuptools,) = fetched(read_lock(BUILD_LOCK))
    with tempfile.TemporaryDirectory() as temporary:
        source = Path(temporary) / "source"
        for name in (*files, *BESIDE):
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(root / name, source / name)
        for name, path in zip(LANDMARK_MODELS, landmark_models(), strict=True):
            shutil.copyfile(path, source / name)
        for path in source.rglob("*"):
            path.chmod(0o755 if path.is_dir() else 0o644)
        # Only the locked setuptools, whatever else is installed or on an index: its version is in the wheel.
        tools = Path(temporary) / "tools"
        tools.mkdir()
        shutil.copy(setuptools, tools)
        fixed = {"SOURCE_DATE_EPOCH": SAME_TIME, "PIP_CONSTRAINT": "", "PIP_FIND_LINKS": ""}
        try:
            pip(
                *("wheel", "--no-deps", "--no-index", "--find-links", str(tools)),
                *("--wheel-dir", str(folder), str(source)),
                env={**os.environ, **fixed},
                umask=0o022,  # the files' modes are in the wheel
            )
        except BuildError as error:
            raise BuildError(f"handfit_core could not be built as a wheel: {error}") from error
    built = sorted(folder.glob("handfit_core-*.whl"))
    fix(built[0])
    wheel = Wheel(built[0])
    inside = {name for name in wheel.members if ".dist-info/" not in name}
    if differing := inside ^ {*files, *LANDMARK_MODELS}:
        raise BuildError(
            f"handfit_core's wheel differs from its source in {', '.join(sorted(differing))}; "
            "list packages and data in pyproject.toml"
        )
    return wheel


def source_files(root: Path = ROOT) -> list[str]:
    """Modules and data of the artist's handfit_core, but for the landmark models: POSIX paths from `root`.

    Raises BuildError where anything else lies there, such as MANO's files, which must not be passed on.
    """
    settings = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    data = {
        f"{package.replace('.', '/')}/{name}"
        for package, names in settings["package-data"].items()
        for name in names
    }
    found = []
    for path in sorted((root / "handfit_core").rglob("*")):
        name = path.relative_to(root).as_posix()
        hidden = any(part == "__pycache__" or part.startswith(".") for part in name.split("/"))
        if path.is_dir() or hidden or name in LANDMARK_MODELS or name.startswith(NOT_THE_ARTISTS):
            continue
        if path.suffix != ".py" and name not in data:
            raise BuildError(
                f"{name}: this is not one of the core's files, and must not go into the zip; move it "
                "elsewhere (MANO's files are named in the add-on's preferences), or list it in pyproject.toml"
            )
        found.append(name)
    return found
