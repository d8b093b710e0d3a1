"""What the packages that a capture loads cost: disk, time to load, memory, and their part of a zip."""

from __future__ import annotations

import json
import subprocess
import sys
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path, PurePosixPath

from benchmarks.interleaved import Spread
from handfit_core.errors import InputError

MODULES = {
    "numpy": "numpy",
    "scipy": "scipy.linalg",
    "opencv-python-headless": "cv2",
    "mediapipe": "mediapipe",
    "torch": "torch",
}
"""Packages and what is imported of them"""

MB = 1_000_000


@dataclass(frozen=True)
class PackageCost:
    """What one package costs. Its own dependencies count as its own, but for NumPy, which all have loaded."""

    name: str
    installed: float
    """MB (10^6 bytes) on disk"""
    seconds: Spread
    """to import in a process that has NumPy (NumPy's own: in an empty one)"""
    memory: float
    """MB of resident memory by which that process grows; median"""
    zipped: float | None
    """MB of its wheels in the extension's zip; None: no zip was given"""


@dataclass(frozen=True)
class PackageCosts:
    """All of them."""

    packages: list[PackageCost]
    whole_zip: float | None
    """MB; None: no zip was given"""


def measure_packages(
    rounds: int,
    *,
    names: Sequence[str] = tuple(MODULES),
    extension: Path | None = None,
    on_round: Callable[[int], None] = lambda _: None,
) -> PackageCosts:
    """Import each package of MODULES in processes of its own, in turn, `rounds` times after one that is not
    counted. `extension`: a zip of the add-on. Raises InputError."""
    zipped = {} if extension is None else _wheels_in(extension)
    installed = {name: installed_size(name) for name in names}
    seconds: dict[str, list[float]] = {name: [] for name in names}
    memory: dict[str, list[float]] = {name: [] for name in names}
    for name in names:
        _import(name)
    for number in range(rounds):
        for name in names:
            took, grew = _import(name)
            seconds[name].append(took)
            memory[name].append(grew)
        on_round(number + 1)
    return PackageCosts(
        [
            PackageCost(
                name,
                installed[name],
                Spread.of(seconds[name]),
                Spread.of(memory[name]).median,
                None if extension is None else zipped.get(name, 0.0),
            )
            for name in names
        ],
        None if extension is None else extension.stat().st_size / MB,
    )


def installed_size(name: str) -> float:
    """MB of the files that a package has installed, without what Python compiled. Raises InputError."""
    try:
        files = distribution(name).files or []
    except PackageNotFoundError as error:
        raise InputError(f"{name} is not installed in this Python; install the packages first") from error
    paths = [Path(str(file.locate())) for file in files if file.suffix != ".pyc"]
    return sum(path.stat().st_size for path in paths if path.is_file()) / MB


def _wheels_in(extension: Path) -> dict[str, float]:
    """MB of the wheels in a zip, by package, those for several Pythons together. Raises InputError."""
    sizes: dict[str, float] = {}
    try:
        with zipfile.ZipFile(extension) as archive:
            for entry in archive.infolist():
                path = PurePosixPath(entry.filename)
                if path.suffix == ".whl":
                    name = path.name.partition("-")[0].lower().replace("_", "-")
                    sizes[name] = sizes.get(name, 0.0) + entry.compress_size / MB
    except (OSError, zipfile.BadZipFile) as error:
        raise InputError(f"{extension}: this is no zip that can be read; build one first") from error
    if not sizes:
        raise InputError(f"{extension}: there are no wheels in this zip; give one of the extension's")
    return sizes


def _import(name: str) -> tuple[float, float]:
    """Seconds, and MB of memory."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.packages_child", MODULES[name]],
        capture_output=True,
        text=True,
        cwd=Path(__file__).resolve().parent.parent,
        check=False,
    )
    if done.returncode != 0:
        raise InputError(f"{name} cannot be loaded: {(done.stderr.strip().splitlines() or ['?'])[-1]}")
    seconds, memory = json.loads(done.stdout.splitlines()[-1])
    return seconds, memory
