"""Whether an installed copy of the add-on is whole, in one sentence.

In the folder of the add-on, the zip has wheels.json: every wheel with its size and version, and for which
Pythons it is. Blender unpacks the wheels into a folder that all extensions share. Names, sizes and versions
are looked at; what is inside the files is for Blender and the file system. A checkout has no wheels.json, and
there is nothing to check.

Only Python's standard library here: handfit_core itself may be what is missing.
"""

from __future__ import annotations

import json
import platform
import re
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ADDON_FOLDER = Path(__file__).resolve().parents[1]
CONTENTS = "wheels.json"
MANIFEST = "blender_manifest.toml"
CORE = "handfit-core"


@dataclass(frozen=True)
class Fault:
    """What is wrong."""

    sentence: str
    """For an artist: what is wrong, and what to do"""
    runs: bool = False
    """Whether the add-on works all the same, but for capturing with Blender's own Python"""


_fault: Fault | None = None
"""What is known to be wrong in this session"""


def fault() -> Fault | None:
    """What was found to be wrong in this session. Costs nothing."""
    return _fault


def note(found: Fault | None) -> None:
    """Remember what is wrong."""
    global _fault
    _fault = found


def is_refused() -> bool:
    """Whether something keeps the add-on from running."""
    return _fault is not None and not _fault.runs


def is_installed(folder: Path = ADDON_FOLDER) -> bool:
    """Whether this copy came from a zip with wheels; also where the list of them was lost since."""
    return (folder / CONTENTS).is_file() or (folder / MANIFEST).is_file()


def installed_version(folder: Path = ADDON_FOLDER) -> str:
    """The version of the zip. Raises what `examine` takes for damage."""
    return str(_contents(folder)["version"])


def examine(extensions: Path, folder: Path = ADDON_FOLDER) -> Fault | None:
    """What is wrong as far as a look at names, sizes and versions tells. `extensions`: Blender's folder of
    extensions."""
    if not is_installed(folder):
        return None
    try:
        contents = _contents(folder)
        version = contents["version"]
        manifest = tomllib.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        if manifest["version"] != version:
            return broken(f"its files are of the versions {manifest['version']} and {version}")
        if contents["platform"] != this_platform():
            return broken(f"it is for {contents['platform']}, and this is {this_platform()}", runs=True)
        if this_python() not in contents["pythons"]:
            return broken(f"it has no parts for this Blender's Python {this_python()}", runs=True)
        unpacked = _unpacked(extensions / ".local" / "lib" / f"python{this_python()}" / "site-packages")
        wheels = [wheel for wheel in contents["wheels"] if this_python() in wheel["pythons"]]
        # handfit_core first: nothing works without it.
        for wheel in sorted(wheels, key=lambda wheel: _canonical(wheel["name"]) != CORE):
            name, path = _canonical(wheel["name"]), folder / "wheels" / wheel["file"]
            there = unpacked.get(name, "")
            if not path.is_file() or path.stat().st_size != wheel["size"] or not there:
                what = "missing or damaged" if there else "not unpacked; is the disk full?"
                return broken(f"{name} {wheel['version']} is {what}", runs=name != CORE)
            # Another extension may bring a newer version, which Blender keeps for both.
            if name == CORE and there != version:
                return other_core(version, there)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        return broken(f"its list of parts cannot be read ({type(error).__name__})")
    return None


def broken(what: str, *, runs: bool = False) -> Fault:
    """For a copy that is not whole: the remedy is always the same."""
    return Fault(
        f"the add-on is not whole ({what}): remove it, restart Blender, get the zip for this machine once "
        "more and install it",
        runs,
    )


def other_core(version: str, found: str) -> Fault:
    """For a handfit_core of another version than the add-on's."""
    return broken(f"it is version {version}, and its other half, handfit_core, is version {found}")


def second_copy(other: str) -> Fault:
    """For a copy that finds another one, of the package name `other`, running."""
    repository = other.split(".")[1] if other.count(".") == 2 else other
    return Fault(
        f"another copy of this add-on is enabled already, in the repository {repository}: disable or remove "
        "one of the two and restart Blender"
    )


def import_fault(error: Exception) -> Fault:
    """For files that are there and cannot be imported."""
    if isinstance(error, ModuleNotFoundError) and error.name == "numpy":
        return Fault(
            "this Blender's Python lacks NumPy, which Blender brings along: use Blender from blender.org, "
            "or install your system's package for it (python3-numpy)"
        )
    return broken(" ".join(f"{type(error).__name__}: {error}".split()))


def report() -> str:
    """What is installed, and what is wrong with it, for a bug report."""
    try:
        contents = _contents(ADDON_FOLDER)
        zipped = f"version {contents['version']} for {contents['platform']}"
        lines = [f"Installed: {zipped}, Python {' and '.join(contents['pythons'])}"]
    except (OSError, ValueError, KeyError, TypeError):
        lines = ["Not installed from a zip with wheels"]
    lines += [f"  in {ADDON_FOLDER}", f"This Blender: {this_platform()}, Python {this_python()}"]
    return "\n".join([*lines, *([f"  {_fault.sentence}"] if _fault else [])])


def print_sentence(sentence: str) -> None:
    """Print a sentence on the console."""
    print(f"Manient Hand Capture: {sentence}", file=sys.stderr)


def this_python() -> str:
    """The running Python, as in 3.11."""
    return f"{sys.version_info.major}.{sys.version_info.minor}"


def this_platform() -> str:
    """This machine as Blender's manifests name it: linux-x64, windows-x64, macos-arm64."""
    system = {"win32": "windows", "darwin": "macos"}.get(sys.platform, sys.platform)
    machine = platform.machine().lower()
    machine = {"x86_64": "x64", "amd64": "x64", "aarch64": "arm64"}.get(machine, machine)
    return f"{system}-{machine}"


def _contents(folder: Path) -> dict[str, Any]:
    """What wheels.json says."""
    return json.loads((folder / CONTENTS).read_bytes())


def _unpacked(site_packages: Path) -> dict[str, str]:
    """The versions of the packages that Blender has unpacked, by name. Blender leaves empty folders where
    unpacking failed."""
    found = {}
    for record in site_packages.glob("*.dist-info/RECORD"):
        name, _, version = record.parent.name.removesuffix(".dist-info").rpartition("-")
        found[_canonical(name)] = version
    return found


def _canonical(name: str) -> str:
    """Wheels write the same name in several ways."""
    return re.sub(r"[-_.]+", "-", name).lower()
