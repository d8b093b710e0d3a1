"""A wheel on disk: what its name and its metadata say."""

from __future__ import annotations

import hashlib
import re
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass
from email.message import Message
from email.parser import HeaderParser
from functools import cached_property
from pathlib import Path

from scripts.extension.errors import BuildError
from scripts.extension.targets import Platform, fits_platform, fits_python


def normalized(name: str) -> str:
    """A package's name as everything here compares it: typing_extensions becomes typing-extensions."""
    return re.sub(r"[-_.]+", "-", name).lower()


@dataclass(frozen=True)
class WheelFile:
    """A wheel, with what its file name says: `name` normalized, tags as they stand there."""

    path: Path
    name: str
    version: str
    python_tag: str
    abi_tag: str
    platform_tag: str

    def fits(self, platform: Platform, pythons: Iterable[str]) -> tuple[str, ...]:
        """Those of the Pythons that can use it on the platform."""
        if not fits_platform(self.platform_tag, platform):
            return ()
        return tuple(p for p in pythons if fits_python(self.python_tag, self.abi_tag, p))

    @cached_property
    def sha256(self) -> str:
        """Of the file, in hexadecimal digits."""
        return sha256_of(self.path)

    @cached_property
    def size(self) -> int:
        """Of the file, in bytes."""
        return self.path.stat().st_size

    @cached_property
    def members(self) -> dict[str, int]:
        """Sizes in bytes of the files inside, unpacked, by their names."""
        with self._opened() as archive:
            return {i.filename: i.file_size for i in archive.infolist() if not i.is_dir()}

    @property
    def unpacked_size(self) -> int:
        """Of all files inside, in bytes."""
        return sum(self.members.values())

    @cached_property
    def metadata(self) -> Message:
        """The headers of its METADATA file. Raises BuildError where there is none."""
        with self._opened() as archive:
            for name in archive.namelist():
                if re.fullmatch(r"[^/]+\.dist-info/METADATA", name):
                    return HeaderParser().parsestr(archive.read(name).decode())
        raise BuildError(f"{self.path}: this wheel has no METADATA file; download it again")

    def texts(self, pattern: str) -> list[tuple[str, str]]:
        """Name and text of the files inside whose whole name matches the regular expression, in order."""
        with self._opened() as archive:
            names = sorted(n for n in self.members if re.fullmatch(pattern, n))
            return [(n, archive.read(n).decode(errors="replace")) for n in names]

    def _opened(self) -> zipfile.ZipFile:
        try:
            return zipfile.ZipFile(self.path)
        except (OSError, zipfile.BadZipFile) as error:
            raise BuildError(
                f"{self.path}: this wheel cannot be read ({error}); download it again"
            ) from error


def wheel_file(path: Path) -> WheelFile:
    """A wheel by its file name, NAME-VERSION-(BUILD-)PYTHON-ABI-PLATFORM.whl. Raises BuildError."""
    parts = path.name.removesuffix(".whl").split("-")
    if path.suffix != ".whl" or len(parts) not in (5, 6):
        raise BuildError(
            f"{path}: this is not named as a wheel is (NAME-VERSION-PYTHON-ABI-PLATFORM.whl); "
            "keep the name that it was downloaded under"
        )
    name, version, *_, python_tag, abi_tag, platform_tag = parts
    return WheelFile(path, normalized(name), version, python_tag, abi_tag, platform_tag)


def sha256_of(path: Path) -> str:
    """In hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
