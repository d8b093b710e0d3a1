"""CHANGELOG.md: a section per version, and one for what is not released."""

from __future__ import annotations

import datetime
import re
from pathlib import Path

from scripts.releasing.errors import ReleaseError

CHANGELOG = "CHANGELOG.md"
UNRELEASED = "Unreleased"
_HEADING = re.compile(r"^## (?P<name>\S+)(?: - (?P<date>\S+))?[ \t]*$", re.MULTILINE)


def changelog_text(repository: Path) -> str:
    """The whole file. Raises ReleaseError where it cannot be read."""
    try:
        return (repository / CHANGELOG).read_text(encoding="utf-8")
    except (OSError, UnicodeError) as error:
        raise ReleaseError(
            f"{repository / CHANGELOG} cannot be read ({error}); bring it back from git"
        ) from error


def release_notes(text: str, version: str) -> str:
    """What the section `## VERSION - DATE` of the changelog `text` says, without its heading.

    Raises ReleaseError where the section is missing, has no date (YYYY-MM-DD), or lists no change.
    """
    heading = _heading(text, version)
    if heading is None:
        raise ReleaseError(
            f"{CHANGELOG} has no section for {version}; move its lines from {UNRELEASED} with "
            f"scripts/bump_version.py {version}"
        )
    try:
        datetime.date.fromisoformat(heading["date"] or "")
    except ValueError:
        raise ReleaseError(
            f"{CHANGELOG}'s heading of {version} has no date; write ## {version} - YYYY-MM-DD"
        ) from None
    body = _body(text, heading)
    if not _lists_changes(body):
        raise ReleaseError(f"{CHANGELOG}'s section for {version} is empty; write what users will notice")
    return body + "\n"


def with_release(text: str, version: str, date: datetime.date) -> str:
    """The changelog with everything under Unreleased moved into a section `## VERSION - DATE`.

    Raises ReleaseError where nothing is unreleased, or the version has a section already.
    """
    if _heading(text, version) is not None:
        raise ReleaseError(f"{CHANGELOG} has a section for {version} already; choose a higher version")
    unreleased = _heading(text, UNRELEASED)
    if unreleased is None or not _lists_changes(_body(text, unreleased)):
        raise ReleaseError(f"{CHANGELOG} lists nothing under ## {UNRELEASED}; write what users will notice")
    start = unreleased.end()
    return f"{text[:start]}\n\n## {version} - {date.isoformat()}{text[start:]}"


def _heading(text: str, name: str) -> re.Match[str] | None:
    return next((found for found in _HEADING.finditer(text) if found["name"] == name), None)


def _body(text: str, heading: re.Match[str]) -> str:
    following = _HEADING.search(text, heading.end())
    return text[heading.end() : following.start() if following else len(text)].strip()


def _lists_changes(body: str) -> bool:
    """Whether there is more than headings such as "### Added"."""
    return any(line.strip() and not line.startswith("#") for line in body.splitlines())
