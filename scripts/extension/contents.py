"""The wheels of a zip, and what is missing from it, as every list of its contents needs them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from scripts.extension.errors import BuildError
from scripts.extension.targets import Platform
from scripts.extension.wheel_file import WheelFile


@dataclass(frozen=True)
class Missing:
    """A package that is not in the zip for a Python, and why, in one sentence."""

    name: str
    python: str
    why: str


@dataclass(frozen=True)
class Contents:
    """What a zip is made of. `torch` is "cpu", "none", or the version of a build of the user's own;
    `wheels` tells for which Pythons each wheel is, in the order of the manifest."""

    identity: str
    version: str
    platform: Platform
    pythons: tuple[str, ...]
    torch: str
    wheels: tuple[tuple[WheelFile, tuple[str, ...]], ...]
    missing: tuple[Missing, ...]


def sorted_wheels(
    wheels: Sequence[WheelFile], platform: Platform, pythons: tuple[str, ...]
) -> tuple[tuple[WheelFile, tuple[str, ...]], ...]:
    """Each wheel once, by file name, with the Pythons that it is for.

    Raises BuildError where a wheel fits none of them, or two wheels of a package fit the same.
    """
    once = {wheel.path.name: wheel for wheel in wheels}
    result = []
    taken: dict[tuple[str, str], str] = {}
    for file, wheel in sorted(once.items()):
        fitting = wheel.fits(platform, pythons)
        if not fitting:
            raise BuildError(f"{file}: this wheel is not for {platform.name}, Python {' or '.join(pythons)}")
        for python in fitting:
            other = taken.setdefault((wheel.name, python), file)
            if other != file:
                raise BuildError(f"{file} and {other} are both {wheel.name} for Python {python}; keep one")
        result.append((wheel, fitting))
    return tuple(result)
