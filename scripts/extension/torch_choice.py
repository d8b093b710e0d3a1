"""Which torch goes into a zip: the locked CPU build, none, or wheels of the user's own."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from scripts.extension.errors import BuildError
from scripts.extension.parts import FOR_TORCH, RUN_TIME
from scripts.extension.targets import Platform
from scripts.extension.wheel_file import WheelFile, normalized, wheel_file

CPU, NONE = "cpu", "none"

_NOT_THEIRS = {"numpy", "handfit-core", *RUN_TIME} - set(FOR_TORCH)


def _cuda_libraries(wheels: Sequence[WheelFile]) -> set[str]:
    """The packages with the CUDA libraries, without which torch's CUDA builds for Linux do not load."""
    declared = [
        line for w in wheels if w.name == "torch" for line in w.metadata.get_all("Requires-Dist") or ()
    ]
    names = {normalized(re.split(r"[^\w.-]", line)[0]) for line in declared if "extra ==" not in line}
    return {name for name in names if name.startswith(("nvidia-", "cuda-"))}


def own_torch(choice: str, platform: Platform, pythons: Sequence[str]) -> list[WheelFile]:
    """The wheels of torch that a path names: one file, or a folder with torch and what it needs besides.

    Of a folder those wheels are taken that fit the platform and one of the Pythons, so that one folder
    serves several zips. Raises BuildError where none does, or a wheel is one that comes from elsewhere.
    """
    if not choice.strip():
        raise BuildError("--torch: expected cpu, none, or the path of a wheel or of a folder of wheels")
    path = Path(choice)
    if path.is_dir():
        found = [wheel_file(p) for p in sorted(path.glob("*.whl"))]
    elif path.is_file():
        found = [wheel_file(path)]
    else:
        raise BuildError(f"{choice}: expected cpu, none, or the path of a wheel or of a folder of wheels")
    fitting = [wheel for wheel in found if wheel.fits(platform, pythons)]
    if not any(wheel.name == "torch" for wheel in fitting):
        there = ", ".join(wheel.path.name for wheel in found) or "no wheels"
        raise BuildError(
            f"{choice}: expected torch for {platform.name}, Python {' or '.join(pythons)}, found {there}"
        )
    absent = (
        _cuda_libraries(fitting) - {wheel.name for wheel in fitting} if platform.name == "linux-x64" else ()
    )
    if absent:
        raise BuildError(
            f"{choice}: this torch also needs {', '.join(sorted(absent))}; give a folder with all of their "
            "wheels (pip download makes one)"
        )
    for wheel in fitting:
        if wheel.name in _NOT_THEIRS:
            raise BuildError(
                f"{wheel.path}: {wheel.name} does not come from here; leave only torch and what it needs"
            )
    return fitting
