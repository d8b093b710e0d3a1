"""The platforms and Pythons that zips are built for, and which wheels fit them."""

from __future__ import annotations

import platform as machine
import sys
from dataclasses import dataclass

from handfit_core.errors import OptionError

PYTHONS = ("3.11", "3.13")
"""The Pythons of the supported Blenders: 3.11 in 4.2, 4.5 and 5.0, 3.13 in 5.2."""


@dataclass(frozen=True)
class Platform:
    """A platform by Blender's name for it, by Python's, and the wheel tags that it takes, newest first."""

    name: str
    sys_platform: str
    tags: tuple[str, ...]
    local_tag: str = ""
    """Of wheels that no index takes, built on the machine or served by their makers"""

    @property
    def windows(self) -> bool:
        """Whether it has Windows' limits."""
        return self.sys_platform == "win32"


_PLATFORMS = (
    # Blender itself asks for glibc 2.28.
    Platform(
        "linux-x64",
        "linux",
        (*(f"manylinux_2_{n}_x86_64" for n in range(28, 16, -1)), "manylinux2014_x86_64"),
        "linux_x86_64",
    ),
    Platform("windows-x64", "win32", ("win_amd64",)),
    # torch has no build for an older macOS.
    Platform(
        "macos-arm64",
        "darwin",
        tuple(f"macosx_{n}_0_{arch}" for n in range(14, 10, -1) for arch in ("arm64", "universal2")),
    ),
)
PLATFORM_NAMES = tuple(p.name for p in _PLATFORMS)


def platform_named(name: str) -> Platform:
    """Raises OptionError."""
    for found in _PLATFORMS:
        if found.name == name:
            return found
    raise OptionError(f"{name}: there is no zip for this platform; choose from {', '.join(PLATFORM_NAMES)}")


def this_platform() -> str:
    """Blender's name of the platform that this runs on, such as linux-x64 (also of those without a zip)."""
    system = {"linux": "linux", "win32": "windows", "darwin": "macos"}.get(sys.platform, sys.platform)
    processor = machine.machine().lower()
    return f"{system}-{ {'x86_64': 'x64', 'amd64': 'x64', 'aarch64': 'arm64'}.get(processor, processor) }"


def checked_pythons(pythons: tuple[str, ...] | list[str]) -> tuple[str, ...]:
    """The Pythons in order, each once. Raises OptionError for one that no supported Blender has, or none."""
    for python in pythons:
        if python not in PYTHONS:
            raise OptionError(
                f"{python}: no supported Blender has this Python; choose from {', '.join(PYTHONS)}"
            )
    if not pythons:
        raise OptionError(f"no Python was named; choose from {', '.join(PYTHONS)}")
    return tuple(p for p in PYTHONS if p in pythons)


def fits_python(python_tag: str, abi_tag: str, python: str) -> bool:
    """Whether a wheel's tags, such as "cp37" and "abi3", suit a Python such as "3.11"."""
    own, minor = f"cp{python.replace('.', '')}", int(python.partition(".")[2])
    abis = abi_tag.split(".")
    for tag in python_tag.split("."):
        if tag == "py3" or (tag == own and {own, "none", "abi3"} & set(abis)):
            return True
        # The stable ABI holds from the named version on, and cp39 is older than cp311.
        if "abi3" in abis and tag.startswith("cp3") and int(tag[3:]) <= minor:
            return True
    return False


def fits_platform(platform_tag: str, platform: Platform) -> bool:
    """Whether a wheel's platform tag, such as "manylinux2014_x86_64" or "any", suits the platform."""
    return any(tag in ("any", platform.local_tag, *platform.tags) for tag in platform_tag.split("."))
