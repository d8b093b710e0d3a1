"""The wheels of a zip: which ones a lock names, and where they are.

A lock (locks/PLATFORM-pyVERSION.txt) is a file of pip requirements, one `NAME==VERSION --hash=sha256:...` a
line, so that each line names one file. `nox -s lock` writes them.
"""

from __future__ import annotations

import hashlib
import re
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from email.message import Message
from email.parser import HeaderParser
from functools import cached_property
from pathlib import Path
from platform import machine
from typing import Any

from handfit_core.common.errors import HandfitError
from handfit_core.common.files import cache_dir

LOCKS = Path(__file__).parent / "locks"
BUILD_LOCK = LOCKS / "build.txt"
"""The lock of the tool that builds handfit_core's wheel."""

PYTHONS = ("3.11", "3.13")
"""The Pythons of the supported Blenders: 3.11 in 4.2, 4.5 and 5.0, 3.13 in 5.2."""

PLATFORMS = {
    # Blender itself asks for glibc 2.28.
    "linux-x64": (*(f"manylinux_2_{n}_x86_64" for n in range(28, 16, -1)), "manylinux2014_x86_64"),
    "windows-x64": ("win_amd64",),
    "macos-arm64": tuple(
        f"macosx_{n}_0_{arch}" for n in range(14, 10, -1) for arch in ("arm64", "universal2")
    ),
}
"""Blender's name of each platform that has a zip, and the wheel tags that it takes, newest first."""

RUN_TIME = (
    *("scipy", "opencv-python-headless", "mediapipe", "av"),
    *("loky", "cloudpickle", "tqdm", "threadpoolctl"),
)
"""Packages that the worker and batches import beside handfit_core and Blender's own NumPy. mediapipe
declares absl-py, flatbuffers and sounddevice, but its hand landmarker imports none of them."""
TORCH = ("torch", "typing-extensions")
"""Packages that the paper's experiments import, too. Others that torch declares (sympy,
networkx, jinja2, ...) it imports only for what is not used here."""

_PIN = re.compile(r"(?P<name>[\w.-]+)==(?P<version>\S+) --hash=sha256:(?P<sha256>[0-9a-f]{64})")


def this_platform() -> str:
    """This machine as Blender's manifests name it: linux-x64, windows-x64, macos-arm64."""
    system = {"win32": "windows", "darwin": "macos"}.get(sys.platform, sys.platform)
    name = machine().lower()
    return f"{system}-" + {"x86_64": "x64", "amd64": "x64", "aarch64": "arm64"}.get(name, name)


class BuildError(HandfitError):
    """A zip that cannot be built: a wheel, lock or tool that is missing, or is not the one expected."""


@dataclass(frozen=True)
class Wheel:
    """A wheel on disk, and the Pythons of the zip that it is for."""

    path: Path
    pythons: tuple[str, ...] = PYTHONS

    @property
    def name(self) -> str:
        """The package's name, normalized: typing_extensions becomes typing-extensions."""
        return self.path.name.split("-")[0].replace("_", "-").lower()

    @property
    def version(self) -> str:
        """The package's version, such as "2.13.0+cpu"."""
        return self.path.name.split("-")[1]

    @cached_property
    def sha256(self) -> str:
        """The hash of the file, in hexadecimal digits."""
        return sha256_of(self.path)

    @cached_property
    def size(self) -> int:
        """The size of the file, in bytes."""
        return self.path.stat().st_size

    @cached_property
    def members(self) -> dict[str, int]:
        """Sizes in bytes of the files inside, unpacked, by their names."""
        with zipfile.ZipFile(self.path) as archive:
            return {i.filename: i.file_size for i in archive.infolist() if not i.is_dir()}

    @cached_property
    def metadata(self) -> Message:
        """The headers of its METADATA file."""
        ((_, text),) = self.texts(r"[^/]+\.dist-info/METADATA")
        return HeaderParser().parsestr(text)

    def texts(self, pattern: str) -> list[tuple[str, str]]:
        """Name and text of the files inside whose whole name matches the regular expression, in order."""
        with zipfile.ZipFile(self.path) as archive:
            names = sorted(n for n in self.members if re.fullmatch(pattern, n))
            return [(n, archive.read(n).decode(errors="replace")) for n in names]


@dataclass(frozen=True)
class Pin:
    """One line of a lock: package name, version, hash in hexadecimal digits."""

    name: str
    version: str
    sha256: str

    def __str__(self) -> str:
        return f"{self.name}=={self.version} --hash=sha256:{self.sha256}"


def lock_path(platform: str, python: str) -> Path:
    """The lock of a platform ("linux-x64") and a Python ("3.11")."""
    return LOCKS / f"{platform}-py{python.replace('.', '')}.txt"


def read_lock(path: Path) -> list[Pin]:
    """The pins of a lock. Raises BuildError where a line is neither a pin nor a comment."""
    pins = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        if found := _PIN.fullmatch(line.strip()):
            pins.append(Pin(**found.groupdict()))
        elif line.strip() and not line.startswith("#"):
            raise BuildError(
                f"{path}, line {number}: expected NAME==VERSION --hash=sha256:HEX, found {line!r}; "
                "make the lock anew with `nox -s lock`"
            )
    return pins


def locked_wheels(platform: str, torch: bool) -> list[Wheel]:
    """All wheels of a platform's zip but handfit_core's, by file name. Raises BuildError."""
    found: dict[Path, tuple[str, ...]] = {}
    for python in PYTHONS:
        pins = [pin for pin in read_lock(lock_path(platform, python)) if torch or pin.name not in TORCH]
        for path in fetched(pins, platform, python):
            found[path] = (*found.get(path, ()), python)
    return [Wheel(path, pythons) for path, pythons in sorted(found.items())]


def fetched(pins: Sequence[Pin], platform: str | None = None, python: str | None = None) -> list[Path]:
    """The pinned wheels in the user's cache, in order; where one is not there, all are downloaded.

    Without a platform and a Python they are for any. Raises BuildError, with pip's reason.
    """
    paths = [_in_cache(pin) for pin in pins]
    if None in paths:
        _download(pins, platform, python)
        paths = [_in_cache(pin) for pin in pins]
    assert all(paths), pins  # pip has held them against their hashes
    return [path for path in paths if path]


def wheel_cache() -> Path:
    """The folder of downloaded wheels."""
    return cache_dir() / "wheels"


def _in_cache(pin: Pin) -> Path | None:
    named = wheel_cache().glob(f"{pin.name.replace('-', '_')}-{pin.version}-*.whl")
    return next((path for path in sorted(named) if sha256_of(path) == pin.sha256), None)


def _download(pins: Sequence[Pin], platform: str | None, python: str | None) -> None:
    """pip holds every file against its hash."""
    cache = wheel_cache()
    cache.mkdir(parents=True, exist_ok=True)
    # In the cache's own folder, so that a wheel comes to its place in one step, and whole.
    with tempfile.TemporaryDirectory(prefix=".download-", dir=cache) as folder:
        requirements = Path(folder) / "requirements.txt"
        requirements.write_text("".join(f"{pin}\n" for pin in pins), encoding="utf-8")
        command = ["download", "--require-hashes", "--no-deps", "--dest", folder, *target(platform, python)]
        try:
            pip(*command, "--requirement", str(requirements))
        except BuildError as error:
            what = f"the wheels for {platform}, Python {python}" if platform else "what builds the core"
            raise BuildError(
                f"{what} could not be downloaded ({error}); check the network and pip's index, or put the "
                f"wheels of the lock into {cache}"
            ) from error
        for path in Path(folder).glob("*.whl"):
            path.replace(cache / path.name)


def target(platform: str | None, python: str | None) -> list[str]:
    """pip's options for wheels of a platform and a Python, or of any."""
    tags = [f"--platform={tag}" for tag in PLATFORMS.get(platform or "", ())]
    return ["--only-binary=:all:", *tags, *(["--python-version", python] if python else [])]


def pip(*arguments: str, **settings: Any) -> None:
    """Run this Python's pip; `settings` are those of subprocess.run. Raises BuildError with pip's reason."""
    command = [sys.executable, "-m", "pip", *arguments, "--quiet", "--disable-pip-version-check"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, **settings)
    if done.returncode:
        said = done.stderr.strip().splitlines() or ["pip gave no reason"]
        errors = [line.removeprefix("ERROR: ").strip() for line in said if line.startswith("ERROR: ")]
        differs = "DO NOT MATCH" in done.stderr
        raise BuildError("no file of the index has the hash in the lock" if differs else (errors or said)[-1])


def sha256_of(path: Path) -> str:
    """The SHA-256 of a file, in hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
