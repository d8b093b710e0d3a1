"""Locks: the exact wheels of a platform and Python, by version and hash.

A lock is a file of pip requirements, one `NAME==VERSION --hash=sha256:...` a line, so that each names one
file. `# missing: NAME: WHY` says in words what cannot be had. `nox -s lock` writes them.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

from scripts.extension.errors import BuildError
from scripts.extension.wheel_file import normalized

FOLDER = Path(__file__).parent / "locks"
BUILD_LOCK = FOLDER / "build.txt"
"""What builds handfit_core's wheel."""

_PIN = re.compile(r"(?P<name>[\w.-]+)==(?P<version>\S+) --hash=sha256:(?P<sha256>[0-9a-f]{64})")
_MISSING = re.compile(r"# missing: (?P<name>[\w.-]+): (?P<why>.+)")


@dataclass(frozen=True)
class Pin:
    """One wheel: normalized package name, version, hash in hexadecimal digits."""

    name: str
    version: str
    sha256: str

    @property
    def requirement(self) -> str:
        """As pip reads it."""
        return f"{self.name}=={self.version} --hash=sha256:{self.sha256}"


@dataclass(frozen=True)
class Lock:
    """Wheels, and packages that are not to be had, with the reason."""

    pins: tuple[Pin, ...]
    missing: dict[str, str] = field(default_factory=dict)


def lock_path(platform: str, python: str, folder: Path = FOLDER) -> Path:
    """Of the lock of a platform ("linux-x64") and a Python ("3.11")."""
    return folder / f"{platform}-py{python.replace('.', '')}.txt"


def read_lock(path: Path) -> Lock:
    """Raises BuildError where it is missing, or a line is neither a pin nor a comment."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise BuildError(
            f"{path}: this lock cannot be read ({error.strerror}); make it with `nox -s lock`"
        ) from error
    pins, missing = [], {}
    for number, line in enumerate(lines, 1):
        if found := _PIN.fullmatch(line.strip()):
            pins.append(Pin(normalized(found["name"]), found["version"], found["sha256"]))
        elif found := _MISSING.fullmatch(line.strip()):
            missing[normalized(found["name"])] = found["why"]
        elif line.strip() and not line.startswith("#"):
            raise BuildError(
                f"{path}, line {number}: expected NAME==VERSION --hash=sha256:HEX, found {line!r}; "
                "make the lock anew with `nox -s lock`"
            )
    return Lock(tuple(pins), missing)


def lock_text(title: str, lock: Lock) -> str:
    """The lock as a file. `title` says what it is for."""
    lines = [f"# {title}", "# Made by `nox -s lock` from constraints.txt; do not edit.", ""]
    lines += [pin.requirement for pin in lock.pins]
    lines += [f"# missing: {name}: {why}" for name, why in lock.missing.items()]
    return "\n".join(lines) + "\n"
