"""What an installed copy of the add-on consists of, and what of it is missing or wrong, in sentences.

The zip has wheels.json beside this file: every wheel with its size and version, and for which Pythons it is.
Blender unpacks the wheels into a folder that all extensions share. Names, sizes and versions are looked at;
what is inside the files is Blender's and the file system's business. A checkout has no wheels.json, and there
is nothing to check.

Only Python's standard library here: handfit_core itself may be what is missing.
"""

from __future__ import annotations

import contextlib
import json
import os
import platform
import re
import sys
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

ADDON_FOLDER = Path(__file__).resolve().parent
CONTENTS = "wheels.json"
MANIFEST = "blender_manifest.toml"
CORE = "handfit-core"
_SCHEMA = 1

_PLATFORMS = {"linux-x64": "Linux", "windows-x64": "Windows", "macos-arm64": "macOS on ARM"}
"""For which there are zips, and how they are called"""
IN_PREFERENCES = "in the add-on's preferences"
"""Ends sentences; on the command line other words take its place"""

Kind = Literal[
    "copy",  # another copy of the add-on runs already
    "unreadable",  # wheels.json itself, or the manifest
    "mixed",  # the files of two versions of the add-on in one folder
    "platform",  # a zip for another system
    "python",  # a zip without wheels for this Python
    "wheel",  # missing, damaged
    "not-unpacked",
    "module",  # what the add-on's own half needs cannot be imported
    "core-version",  # handfit_core of another version of the add-on
    "other-version",  # another extension brings another version of a package
]
"""What is wrong, causes before their consequences"""
Stops = Literal["add-on", "capture", "nothing"]


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong."""

    kind: Kind
    sentence: str
    """For an artist: what is wrong, and what to do"""
    wheel: str = ""
    """Name of the package, as in opencv-python-headless; empty where it is about no single one"""
    stops: Stops = "capture"
    """What is impossible: everything; capturing with Blender's own Python; nothing, it only explains"""


@dataclass(frozen=True)
class Wheel:
    """One wheel of the zip."""

    file: str
    name: str
    version: str
    size: int
    pythons: tuple[str, ...]

    @property
    def label(self) -> str:
        """For people: torch 2.13.0."""
        return f"{self.name} {self.version.partition('+')[0]}"


@dataclass(frozen=True)
class Contents:
    """wheels.json."""

    version: str
    platform: str
    pythons: tuple[str, ...]
    torch: str
    wheels: tuple[Wheel, ...]


@dataclass(frozen=True)
class Place:
    """Where a copy of the add-on lies, and which Blender it is to work in."""

    folder: Path
    """The add-on's own, with wheels.json"""
    site_packages: Path
    """Where Blender unpacks the wheels of all extensions"""
    platform: str
    """for example linux-x64"""
    python: str
    """for example 3.11"""


def this_place(extensions: Path) -> Place:
    """This copy of the add-on in this Blender. `extensions`: Blender's folder of extensions."""
    python = this_python()
    return Place(
        ADDON_FOLDER,
        extensions / ".local" / "lib" / f"python{python}" / "site-packages",
        this_platform(),
        python,
    )


def this_python() -> str:
    """The running Python, as in 3.11."""
    return f"{sys.version_info.major}.{sys.version_info.minor}"


def this_platform() -> str:
    """This machine as Blender's manifests name it: linux-x64, windows-x64, macos-arm64."""
    system = {"win32": "windows", "darwin": "macos"}.get(sys.platform, sys.platform)
    machine = platform.machine().lower()
    machine = {"x86_64": "x64", "amd64": "x64", "aarch64": "arm64"}.get(machine, machine)
    return f"{system}-{machine}"


def is_installed(folder: Path = ADDON_FOLDER) -> bool:
    """Whether this copy came from a zip with wheels; also where the list of them was lost since."""
    return (folder / CONTENTS).is_file() or _names_wheels(folder / MANIFEST)


def read_contents(folder: Path = ADDON_FOLDER) -> Contents:
    """What wheels.json says. Raises OSError, and ValueError where it is damaged."""
    text = (folder / CONTENTS).read_bytes()
    try:
        data = json.loads(text)
        schema = data["schema"]
        if schema == _SCHEMA:
            return _as_contents(data)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(f"{CONTENTS} is damaged") from error
    raise ValueError(f"{CONTENTS} has the unknown schema {schema}")


def zip_name(contents: Contents, platform_name: str | None = None) -> str:
    """The name of the zip of this version and with as much in it, for a platform, this zip's own where none
    is given."""
    platform_name = (platform_name or contents.platform).replace("-", "_")
    kind = "" if contents.torch == "none" else "-torch"
    return f"manient-{contents.version}-{platform_name}{kind}.zip"


def examine(place: Place) -> list[Problem]:
    """What is wrong as far as a look at names, sizes and versions tells; the cause of the others first.

    Reads a few small files and the names of two folders; nothing where the copy is not an installed one.
    """
    if not is_installed(place.folder):
        return []
    try:
        contents = read_contents(place.folder)
        version = str(_read_manifest(place.folder / MANIFEST)["version"])
    except (OSError, ValueError) as error:
        what = str(error)
        if isinstance(error, OSError):
            what = f"{Path(error.filename).name} cannot be read: {_short(error)}"
        sentence = f"the add-on's files are damaged ({what}): {_REINSTALL}"
        return [Problem("unreadable", sentence, stops="add-on")]
    if version != contents.version:
        mixed = f"the add-on's folder mixes the versions {version} and {contents.version}: {_REINSTALL}"
        return [Problem("mixed", mixed, stops="add-on")]
    unfit = _unfit(place, contents)
    unpacked = unpacked_versions(place.site_packages)
    wheels = _wheels_for(place, contents)
    if unfit is not None and unfit.kind == "platform":
        # Blender leaves the wheels of another system packed; what is for all systems is there.
        wheels = [wheel for wheel in wheels if wheel.name == CORE]
    of_wheels = [
        _wheel_file_problem(place, contents, wheel)
        or _unpacked_problem(place, contents, wheel, unpacked.get(wheel.name))
        for wheel in wheels
    ]
    return causes_first([problem for problem in (unfit, *of_wheels) if problem is not None])


def causes_first(problems: Sequence[Problem]) -> list[Problem]:
    """Causes before their consequences, and of the same kind the one that stops more."""
    kinds, stops = get_args(Kind), get_args(Stops)
    return sorted(problems, key=lambda problem: (kinds.index(problem.kind), stops.index(problem.stops)))


def unpacked_versions(site_packages: Path) -> dict[str, str]:
    """The versions of the packages that lie there with a list of their files, by names as in wheels.json."""
    found: dict[str, str] = {}
    with contextlib.suppress(OSError):
        for entry in os.scandir(site_packages):
            name, _, version = entry.name.removesuffix(".dist-info").rpartition("-")
            # Blender leaves empty folders where unpacking failed.
            if entry.name.endswith(".dist-info") and name and Path(entry.path, "RECORD").is_file():
                found[_canonical(name)] = version
    return found


def report(place: Place, problems: Sequence[Problem]) -> str:
    """The installation's state for a bug report: the zip, every wheel, and where it was unpacked."""
    if not is_installed(place.folder):
        return f"Not installed from a zip with wheels: {place.folder}"
    try:
        contents = read_contents(place.folder)
    except (OSError, ValueError) as error:
        return f"Installed in {place.folder}, with an unreadable {CONTENTS} ({error})"
    lines = [
        f"Installed: version {contents.version} for {contents.platform}, "
        f"Python {' and '.join(contents.pythons)}, torch: {contents.torch}",
        f"  in {place.folder}",
        f"This Blender: {place.platform}, Python {place.python}",
        f"Wheels for it, unpacked in {place.site_packages}:",
    ]
    unpacked = unpacked_versions(place.site_packages)
    used = _wheels_for(place, contents)
    for wheel in used:
        wrong = [p.sentence for p in problems if p.wheel == wheel.name]
        where = f"unpacked {unpacked[wheel.name]}" if wheel.name in unpacked else "not unpacked"
        lines.append(f"  {wheel.file} ({wheel.size / 1e6:.1f} MB), {where}: {'; '.join(wrong) or 'ok'}")
    named = {wheel.name for wheel in used}
    lines += [f"  {p.sentence}" for p in problems if p.wheel not in named]
    return "\n".join(lines)


_REINSTALL = "remove the add-on, restart Blender, get the zip once more and install it"


def _unfit(place: Place, contents: Contents) -> Problem | None:
    """Whether the zip is for another system or other Pythons."""
    if contents.platform != place.platform:
        of = _PLATFORMS.get(contents.platform, contents.platform)
        if place.platform in _PLATFORMS:
            remedy = f"this machine needs {zip_name(contents, place.platform)}: remove the add-on and "
            remedy += "install that one"
        else:
            remedy = f"there is none for this machine, {place.platform}: choose a Python of your "
            remedy += f"own that has SciPy, OpenCV and MediaPipe {IN_PREFERENCES}"
        return Problem("platform", f"this is the zip for {of}, and {remedy}")
    if place.python not in contents.pythons:
        return Problem(
            "python",
            f"this zip has the parts for Python {' and '.join(contents.pythons)}, and this Blender has "
            f"Python {place.python}: remove the add-on and install {zip_name(contents)}, which has them for "
            "all supported versions of Blender",
        )
    return None


def _wheels_for(place: Place, contents: Contents) -> list[Wheel]:
    return [wheel for wheel in contents.wheels if place.python in wheel.pythons]


def _wheel_file_problem(place: Place, contents: Contents, wheel: Wheel) -> Problem | None:
    """What is wrong with the wheel itself, as far as its size tells."""
    try:
        size = (place.folder / "wheels" / wheel.file).stat().st_size
    except FileNotFoundError:
        what = "is missing in the add-on's folder"
    except OSError as error:
        what = f"cannot be read ({_short(error)})"
    else:
        if size == wheel.size:
            return None
        what = f"is damaged ({size} bytes instead of {wheel.size})"
    again = f"remove the add-on, restart Blender, get {zip_name(contents)} once more and install it"
    return Problem("wheel", f"the wheel of {wheel.label} {what}: {again}", wheel.name, _stopped_by(wheel))


def _unpacked_problem(place: Place, contents: Contents, wheel: Wheel, found: str | None) -> Problem | None:
    """What is wrong with the package in the folder that Blender unpacks to; `found`: its version there."""
    if found is None:
        return Problem(
            "not-unpacked",
            f"Blender has not unpacked {wheel.label}: see that there is room, and that you may write, in "
            f"{place.site_packages}, disable the add-on, restart Blender and enable it again; if that does "
            f"not help, install {zip_name(contents)} again",
            wheel.name,
            _stopped_by(wheel),
        )
    if _canonical(found) == _canonical(wheel.version):
        return None
    if wheel.name == CORE:
        return core_version_problem(contents.version, found)
    return Problem(
        "other-version",
        f"another extension brings {wheel.name} {found} where this one has {wheel.version}, and "
        "Blender keeps the newer one for both: if captures fail, disable the other extension",
        wheel.name,
        "nothing",
    )


def core_version_problem(addon: str, core: str) -> Problem:
    """For a handfit_core that is not this add-on's."""
    return Problem(
        "core-version",
        f"this add-on is version {addon}, and its other half, handfit_core, is version {core}: two versions "
        "of the add-on are installed: remove one of them in Preferences > Add-ons and restart Blender",
        CORE,
        "add-on",
    )


def second_copy_problem(other: str) -> Problem:
    """For a copy that finds another one, of the package name `other`, running."""
    repository = other.split(".")[1] if other.count(".") == 2 else other
    return Problem(
        "copy",
        f"another copy of this add-on is enabled already, in the repository {repository}: disable or remove "
        "one of the two and restart Blender",
        stops="add-on",
    )


def import_problem(error: Exception) -> Problem:
    """For files that are there and cannot be imported."""
    return Problem(
        "module",
        f"the add-on's files are damaged, or mixed with those of another version ({type(error).__name__}: "
        f"{_short(error)}): {_REINSTALL}",
        stops="add-on",
    )


def _stopped_by(wheel: Wheel) -> Stops:
    """Without handfit_core nothing works; without the others nothing is captured."""
    return "add-on" if wheel.name == CORE else "capture"


def _canonical(name: str) -> str:
    """Wheels write the same name and version in several ways."""
    return re.sub(r"[-_.]+", "-", name).lower()


def _short(error: Exception) -> str:
    return " ".join(str(getattr(error, "strerror", None) or error).split())


def _as_contents(data: Any) -> Contents:
    """Raises KeyError, TypeError or ValueError where it is not as the build writes it."""
    return Contents(
        version=str(data["version"]),
        platform=str(data["platform"]),
        pythons=tuple(map(str, data["pythons"])),
        torch=str(data.get("torch", "none")),
        wheels=tuple(
            Wheel(
                file=str(wheel["file"]),
                name=_canonical(wheel["name"]),
                version=str(wheel["version"]),
                size=int(wheel["size"]),
                pythons=tuple(map(str, wheel["pythons"])),
            )
            for wheel in data["wheels"]
        ),
    )


def _read_manifest(path: Path) -> dict[str, Any]:
    """A manifest, which has a version. Raises OSError, and ValueError where it is damaged."""
    text = path.read_bytes()
    try:
        data = tomllib.loads(text.decode("utf-8"))
        data["version"]
        return data
    except (ValueError, KeyError, RecursionError) as error:
        raise ValueError(f"{path.name} is damaged") from error


def _names_wheels(manifest: Path) -> bool:
    try:
        return bool(_read_manifest(manifest).get("wheels"))
    except (OSError, ValueError):
        return False
