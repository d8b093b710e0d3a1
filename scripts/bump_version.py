#!/usr/bin/env python3
"""Give the next release its version: in blender_manifest.toml, and as a section of CHANGELOG.md.

    python scripts/bump_version.py 0.2.0 [--date YYYY-MM-DD]      # nox -s bump -- 0.2.0

What stands under Unreleased moves into the section. Commit the two files, then make the release
(scripts/release.py).
"""

from __future__ import annotations

import argparse
import datetime
import sys
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from scripts.releasing.changelog import CHANGELOG, changelog_text, with_release
from scripts.releasing.errors import ReleaseError
from scripts.releasing.versions import MANIFEST, as_numbers, current_version, with_version


def main(argv: Sequence[str] | None = None, repository: Path = ROOT) -> int:
    """Change the two files; returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("version", help="the new version, such as 0.2.0")
    parser.add_argument(
        "--date",
        type=datetime.date.fromisoformat,
        default=datetime.date.today(),
        metavar="YYYY-MM-DD",
        help="of the release (default: today)",
    )
    args = parser.parse_args(argv)
    try:
        bump(repository, args.version, args.date)
    except ReleaseError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(f"{MANIFEST} and {CHANGELOG} are at {args.version}: look at them, commit, and run nox -s release")
    return 0


def bump(repository: Path, version: str, date: datetime.date) -> None:
    """Write both files, or none. The manifest's own version is allowed as long as it is not released.

    Raises ReleaseError.
    """
    now = current_version(repository)
    if as_numbers(version) < as_numbers(now):
        raise ReleaseError(f"{version} is lower than {now}, which {MANIFEST} has; choose a higher version")
    released = with_release(changelog_text(repository), version, date)
    manifest = with_version(repository, version)
    for name, text in ((CHANGELOG, released), (MANIFEST, manifest)):
        try:
            (repository / name).write_text(text, encoding="utf-8", newline="\n")
        except OSError as error:
            raise ReleaseError(f"{repository / name} cannot be written ({error.strerror})") from error


if __name__ == "__main__":
    sys.exit(main())
