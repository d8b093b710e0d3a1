#!/usr/bin/env python3
"""Write the locks of the add-on's wheels: which file of each package, per platform and Python.

    python scripts/lock_wheels.py            # or: nox -s lock

Versions come from constraints.txt, files and hashes from the index that pip is set up for. Torch on Linux
must be a CPU build ("+cpu"): the plain file for Linux is several GB of CUDA. Where the index
has it, but not for a platform and Python, the lock notes it as missing.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from scripts.needed import need

need("numpy", "nox -s lock")
need("packaging", "nox -s lock")

from packaging.requirements import Requirement

from handfit_core.errors import HandfitError
from scripts.extension.errors import BuildError
from scripts.extension.locks import BUILD_LOCK, Lock, Pin, lock_path, lock_text
from scripts.extension.parts import RUN_TIME
from scripts.extension.targets import PLATFORM_NAMES, PYTHONS, Platform, platform_named
from scripts.extension.wheel_file import normalized

CONSTRAINTS = ROOT / "constraints.txt"
BUILD_TOOLS = ("setuptools",)


def main() -> int:
    """Write all locks; returns the exit code."""
    try:
        lines = CONSTRAINTS.read_text(encoding="utf-8").splitlines()
        tools = locked(BUILD_TOOLS, None, PYTHONS[0], versions(lines, PYTHONS[0], "linux"))
        BUILD_LOCK.write_text(lock_text("What builds handfit_core's wheel.", tools), encoding="utf-8")
        print(f"{BUILD_LOCK.relative_to(ROOT)}: {len(tools.pins)} wheels")
        for name in PLATFORM_NAMES:
            for python in PYTHONS:
                platform = platform_named(name)
                lock = locked(RUN_TIME, platform, python, versions(lines, python, platform.sys_platform))
                path = lock_path(name, python)
                title = f"The wheels of the add-on's zip for {name}, Python {python}."
                path.write_text(lock_text(title, lock), encoding="utf-8")
                absent = f", missing: {', '.join(lock.missing)}" if lock.missing else ""
                print(f"{path.relative_to(ROOT)}: {len(lock.pins)} wheels{absent}")
    except HandfitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def versions(constraints: Iterable[str], python: str, sys_platform: str) -> dict[str, str]:
    """Versions by normalized package name, from lines such as `scipy==1.15.3; python_version < "3.12"`, as
    they hold for a Python ("3.11") on a platform, as `sys.platform` names it."""
    found = {}
    # The markers that constraints.txt uses; others would be taken from this machine.
    environment = {"python_version": python, "sys_platform": sys_platform}
    for line in constraints:
        text = line.split("#")[0].strip()
        if not text:
            continue
        requirement = Requirement(text)
        if requirement.marker and not requirement.marker.evaluate(environment):
            continue
        (specifier,) = requirement.specifier
        found[normalized(requirement.name)] = specifier.version
    return found


def locked(names: Sequence[str], platform: Platform | None, python: str, pinned: dict[str, str]) -> Lock:
    """The lock of the named packages; a platform of None is for pure Python. Raises BuildError where the
    index has no such wheel. Only torch may be missing, and only where the index has that version for another
    platform or Python: else the network or an index is what is missing."""
    pins, missing = [], {}
    for name in names:
        if name not in pinned:
            raise BuildError(f"{name}: constraints.txt does not pin it for Python {python}; add it there")
        version = pinned[name]
        cpu_only = name == "torch" and platform is not None and platform.name == "linux-x64"
        wanted = f"{version}+cpu" if cpu_only else version
        pin = resolved(name, wanted, platform, python)
        if pin:
            pins.append(pin)
        elif name == "torch" and platform is not None and found_elsewhere(name, wanted, platform, python):
            kind = "CPU build" if cpu_only else "build"
            missing[name] = f"there is no {kind} of torch {version} for Python {python} on the package index"
        else:
            target = f"{platform.name}, Python {python}" if platform else "all platforms"
            raise BuildError(
                f"{name} {wanted}: no wheel for {target} was found on the index; check the network and which "
                "indexes pip uses (PIP_EXTRA_INDEX_URL for PyTorch's own of CPU builds)"
            )
    return Lock(tuple(pins), missing)


def found_elsewhere(name: str, version: str, platform: Platform, python: str) -> bool:
    """Whether the index has a wheel of the version for any other platform and Python."""
    others = [(platform_named(n), p) for n in PLATFORM_NAMES for p in PYTHONS]
    others.sort(key=lambda other: other[0] != platform)  # the likeliest first
    return any(resolved(name, version, *other) for other in others if other != (platform, python))


def resolved(name: str, version: str, platform: Platform | None, python: str) -> Pin | None:
    """What pip would download, or None."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        command = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        command += ["--dry-run", "--report", str(report), "--ignore-installed", "--no-deps"]
        command += ["--only-binary=:all:", "--target", folder, "--python-version", python]
        for tag in platform.tags if platform else ():
            command += ["--platform", tag]
        done = subprocess.run([*command, f"{name}=={version}"], capture_output=True, text=True, check=False)
        if done.returncode:
            if "No matching distribution" in done.stderr:
                return None
            raise BuildError(f"{name} {version}: pip failed:\n{done.stderr.strip()}")
        (entry,) = json.loads(report.read_text(encoding="utf-8"))["install"]
    sha256 = entry["download_info"]["archive_info"]["hashes"]["sha256"]
    return Pin(normalized(entry["metadata"]["name"]), entry["metadata"]["version"], sha256)


if __name__ == "__main__":
    sys.exit(main())
