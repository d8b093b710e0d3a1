"""Wheels from the package index into the user's cache folder, and from there when they are there."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from handfit_core.files import cache_dir
from scripts.extension.errors import BuildError
from scripts.extension.locks import Pin
from scripts.extension.targets import Platform
from scripts.extension.wheel_file import WheelFile, normalized, sha256_of, wheel_file


def wheel_cache() -> Path:
    """Where downloaded wheels are kept."""
    return cache_dir() / "wheels"


def fetched(pins: Sequence[Pin], platform: Platform | None, python: str | None) -> list[WheelFile]:
    """The pinned wheels, in order. What is not in the cache is downloaded; the hash of each is checked.

    A platform and a Python of None are for wheels that suit all. Raises BuildError.
    """
    return [in_cache(pin) or _download(pin, platform, python) for pin in pins]


def in_cache(pin: Pin) -> WheelFile | None:
    """The pinned wheel if the cache has it, whole."""
    return next((wheel_file(path) for path in _named(pin) if sha256_of(path) == pin.sha256), None)


def _named(pin: Pin) -> list[Path]:
    """The cache's wheels of this package and version, whatever is in them."""
    found = []
    for path in sorted(wheel_cache().glob("*.whl")):
        name, _, rest = path.name.partition("-")
        if normalized(name) == pin.name and rest.startswith(f"{pin.version}-"):
            found.append(path)
    return found


def _download(pin: Pin, platform: Platform | None, python: str | None) -> WheelFile:
    cache = wheel_cache()
    try:
        cache.mkdir(parents=True, exist_ok=True)
        # Beside its place, so that the move is one step and no half a wheel is ever found in the cache.
        temporary = tempfile.TemporaryDirectory(prefix=".download-", dir=cache)
    except OSError as error:
        raise BuildError(
            f"{cache}: wheels cannot be kept here ({error.strerror}); name another folder with HANDFIT_CACHE"
        ) from error
    with temporary as folder:
        requirements = Path(folder) / "requirements.txt"
        requirements.write_text(pin.requirement + "\n", encoding="utf-8")
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check"]
        command += ["--require-hashes", "--no-deps", "--only-binary=:all:", "--dest", folder]
        for tag in platform.tags if platform else ():
            command += ["--platform", tag]
        command += ["--python-version", python] if python else []
        done = subprocess.run(
            [*command, "--requirement", str(requirements)], capture_output=True, text=True, check=False
        )
        found = sorted(Path(folder).glob("*.whl"))
        if done.returncode or len(found) != 1:
            raise BuildError(_cannot_be_had(pin, platform, python, done.stderr))
        wheel = wheel_file(found[0])
        if wheel.name != pin.name or wheel.sha256 != pin.sha256:
            raise BuildError(
                f"{wheel.path.name}: sha256 is {wheel.sha256}, the lock has {pin.sha256}; the index "
                "serves something else than what was locked, look into it before you run `nox -s lock`"
            )
        kept = cache / wheel.path.name
        wheel.path.replace(kept)
    return wheel_file(kept)


def _cannot_be_had(pin: Pin, platform: Platform | None, python: str | None, said: str) -> str:
    target = f" for {platform.name}, Python {python}" if platform else ""
    errors = [line.removeprefix("ERROR: ").strip() for line in said.splitlines() if line.startswith("ERROR")]
    reason = (errors or said.strip().splitlines() or ["pip gave no reason"])[-1]
    if "DO NOT MATCH" in said:
        reason = "no file of the index has the hash in the lock"
    advice = f"check the network and pip's index, or put the wheel into {wheel_cache()}"
    if pin.name == "torch":
        advice += ", or give it with --torch PATH, or build with --torch none"
    # Of a package and version there is one wheel per platform and Python; another's hash says nothing.
    others = [path for path in _named(pin) if not platform or _fits(path, platform, python)]
    there = "".join(f"; {path} has another hash than the lock, and may be damaged" for path in others)
    return f"{pin.name} {pin.version}{target} could not be downloaded ({reason}){there}; {advice}"


def _fits(path: Path, platform: Platform, python: str | None) -> bool:
    return bool(wheel_file(path).fits(platform, [python] if python else []))
