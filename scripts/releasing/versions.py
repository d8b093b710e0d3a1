"""The version in blender_manifest.toml, the only place where it stands."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from scripts.releasing.errors import ReleaseError

MANIFEST = "blender_manifest.toml"
_LINE = re.compile(r'^version = "[^"\n]*"$', re.MULTILINE)


def current_version(repository: Path) -> str:
    """As the manifest has it. Raises ReleaseError where it is not MAJOR.MINOR.PATCH, or cannot be read."""
    try:
        version = str(tomllib.loads(_text(repository)).get("version", ""))
    except tomllib.TOMLDecodeError as error:
        raise ReleaseError(f"{repository / MANIFEST} is not TOML ({error}); mend this line") from error
    as_numbers(version)
    return version


def as_numbers(version: str) -> tuple[int, int, int]:
    """(1, 2, 3) of "1.2.3". Raises ReleaseError for any other form: Blender and pip order suffixes
    such as "-beta" differently, so that an update would not be seen as one."""
    found = re.fullmatch(r"(0|[1-9]\d*)\.(0|[1-9]\d*)\.(0|[1-9]\d*)", version)
    if found is None:
        raise ReleaseError(f'"{version}" is not a version; give three numbers, such as 1.2.0')
    major, minor, patch = (int(number) for number in found.groups())
    return major, minor, patch


def with_version(repository: Path, version: str) -> str:
    """The manifest's text with another version. Raises ReleaseError where it has no line for it."""
    changed, count = _LINE.subn(f'version = "{version}"', _text(repository))
    if count != 1:
        raise ReleaseError(f'{MANIFEST} has {count} lines such as version = "1.2.0"; it needs one')
    return changed


def _text(repository: Path) -> str:
    try:
        return (repository / MANIFEST).read_text(encoding="utf-8")
    except (OSError, UnicodeError) as error:
        raise ReleaseError(
            f"{repository / MANIFEST} cannot be read ({error}); bring it back from git"
        ) from error
