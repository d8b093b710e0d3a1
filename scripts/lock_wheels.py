#!/usr/bin/env python3
"""Write the locks of the add-on's wheels: which file of each package, per platform and Python.

    python scripts/lock_wheels.py            # or: nox -s lock

Versions come from constraints.txt, files and hashes from the index that pip is set up for. Torch on Linux
must be a CPU build ("+cpu"): the plain file for Linux is several GB of CUDA. Where the index has none for a
platform and Python, the lock has none, and this says so.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from scripts.needed import need

need("numpy", "nox -s lock")
need("packaging", "nox -s lock")

from packaging.requirements import Requirement

from scripts.extension.wheels import (
    BUILD_LOCK,
    PLATFORMS,
    PYTHONS,
    RUN_TIME,
    TORCH,
    BuildError,
    Pin,
    lock_path,
    pip,
    target,
)

SYSTEMS = {"linux": "linux", "windows": "win32", "macos": "darwin"}
"""Beginning of Blender's name of a platform -> the value of `sys.platform` there"""


def main() -> int:
    """Write all locks; returns the exit code."""
    constraints = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    try:
        (tool,) = resolved(["setuptools"], versions(constraints, PYTHONS[0], "linux"))
        write(BUILD_LOCK, "What builds handfit_core's wheel.", [tool])
        for platform in PLATFORMS:
            for python in PYTHONS:
                pinned = versions(constraints, python, SYSTEMS[platform.partition("-")[0]])
                if platform == "linux-x64":
                    pinned["torch"] += "+cpu"
                pins = resolved(RUN_TIME, pinned, platform, python)
                try:
                    pins += resolved(TORCH, pinned, platform, python)
                except BuildError as error:
                    print(f"no torch for {platform}, Python {python}: {error}")
                title = f"The wheels of the add-on's zip for {platform}, Python {python}."
                write(lock_path(platform, python), title, pins)
    except BuildError as error:
        sys.exit(f"error: {error}")
    return 0


def write(path: Path, title: str, pins: Iterable[Pin]) -> None:
    """The lock as a file. `title` says what it is for."""
    lines = [f"# {title}", "# Made by `nox -s lock` from constraints.txt; do not edit.", "", *map(str, pins)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")
    print(path.relative_to(ROOT))


def versions(constraints: Iterable[str], python: str, sys_platform: str) -> dict[str, str]:
    """Versions by package name, from lines such as `scipy==1.15.3; python_version < "3.12"`, as they hold for
    a Python ("3.11") on a platform, as `sys.platform` names it."""
    found = {}
    # The markers that constraints.txt uses; others would be taken from this machine.
    environment = {"python_version": python, "sys_platform": sys_platform}
    for line in constraints:
        if text := line.split("#")[0].strip():
            requirement = Requirement(text)
            if requirement.marker is None or requirement.marker.evaluate(environment):
                (specifier,) = requirement.specifier
                found[requirement.name.replace("_", "-").lower()] = specifier.version
    return found


def resolved(
    names: Iterable[str], pinned: dict[str, str], platform: str | None = None, python: str = PYTHONS[0]
) -> list[Pin]:
    """The files that pip would download, in order of the names. Raises BuildError."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        asked = [f"{name}=={pinned[name]}" for name in names]
        options = ["--dry-run", "--ignore-installed", "--no-deps", f"--report={report}", f"--target={folder}"]
        pip("install", *options, *target(platform, python), *asked)
        entries = json.loads(report.read_text(encoding="utf-8"))["install"]
    found = {entry["metadata"]["name"].replace("_", "-").lower(): entry for entry in entries}
    return [
        Pin(
            name,
            found[name]["metadata"]["version"],
            found[name]["download_info"]["archive_info"]["hashes"]["sha256"],
        )
        for name in names
    ]


if __name__ == "__main__":
    sys.exit(main())
