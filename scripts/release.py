#!/usr/bin/env python3
"""Make everything that a release publishes, into out/release/:

    python scripts/release.py [--allow-dirty] [--output DIR]      # nox -s release

    manient-VERSION-PLATFORM.zip            the add-on for each platform
    handfit_core-VERSION-py3-none-any.whl   the core alone, the same file as in the zips
    manient-VERSION-source.tar.gz           the commit's files
    manient-VERSION-PLATFORM.cdx.json       what is in each zip (SBOM, CycloneDX), the same file as in the zip
    RELEASE_NOTES.md                        the version's section of CHANGELOG.md
    SHA256SUMS                              of all of these: sha256sum -c SHA256SUMS

The version is the manifest's; scripts/bump_version.py sets it. The same commit gives the same bytes.
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from scripts.extension.targets import PLATFORM_NAMES
from scripts.releasing.changelog import CHANGELOG, release_notes
from scripts.releasing.errors import ReleaseError
from scripts.releasing.versions import current_version

CHECKSUMS = "SHA256SUMS"
NOTES = "RELEASE_NOTES.md"
SBOM = "sbom.cdx.json"
"""inside a zip"""


def main(argv: Sequence[str] | None = None, repository: Path = ROOT) -> int:
    """Check, build, and write the checksums; returns the exit code."""
    parser = argparse.ArgumentParser(description="Make everything that a release publishes.")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "release", metavar="DIR")
    parser.add_argument(
        "--allow-dirty", action="store_true", help="go on with changes that are not committed, to try it out"
    )
    args = parser.parse_args(argv)
    try:
        version = current_version(repository)
        notes = checked_notes(repository, version, args.allow_dirty)
        output = emptied(args.output)
        build_zips(repository, output)
        take_from_zips(output)
        write_source_archive(repository, version, output)
    except ReleaseError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    (output / NOTES).write_text(notes, encoding="utf-8", newline="\n")
    print(write_checksums(output).read_text(encoding="utf-8"), end="")
    print(f"release {version} is in {output}")
    return 0


def checked_notes(repository: Path, version: str, allow_dirty: bool = False) -> str:
    """The release's notes, after everything was checked that costs no time.

    Raises ReleaseError: changes that are not committed, no or an empty section in CHANGELOG.md, or a
    version that was released before.
    """
    changed = _git(repository, "status", "--porcelain").splitlines()
    if changed and not allow_dirty:
        more = f" and {len(changed) - 1} more are" if changed[1:] else " is"
        raise ReleaseError(
            f"{changed[0][3:]}{more} changed or not in git; commit everything, or try the release out with "
            "--allow-dirty"
        )
    notes = release_notes((repository / CHANGELOG).read_text(encoding="utf-8"), version)
    tag = f"v{version}"
    # A release of a public host runs on the tag itself.
    tagged = _git(repository, "tag", "--list", tag) and _git(repository, "rev-list", "-n", "1", tag)
    if tagged and tagged != _git(repository, "rev-parse", "HEAD"):
        raise ReleaseError(
            f"{version} is released already (tag {tag}, another commit); give the release a new version with "
            "scripts/bump_version.py"
        )
    return notes


def emptied(output: Path) -> Path:
    """The folder, with nothing of an earlier release in it.

    Raises ReleaseError where it holds anything else.
    """
    if output.is_dir() and any(output.iterdir()):
        if not (output / CHECKSUMS).is_file():
            raise ReleaseError(
                f"{output} holds files that no finished release wrote; empty it, or name another folder"
            )
        shutil.rmtree(output)
    output.mkdir(parents=True, exist_ok=True)
    # Of a release that fails half-way, so that the next one may empty the folder.
    (output / CHECKSUMS).touch()
    return output


def build_zips(repository: Path, output: Path) -> None:
    """The zip of every platform, by scripts/build_extension.py. Raises ReleaseError."""
    command = [sys.executable, str(repository / "scripts" / "build_extension.py")]
    command += ["--platform", ",".join(PLATFORM_NAMES), "--output", str(output)]
    done = subprocess.run(command, check=False)
    if done.returncode:
        raise ReleaseError("the zips could not be built; scripts/build_extension.py says why above")


def take_from_zips(output: Path) -> list[Path]:
    """The core's wheel, and each zip's list of its parts, put beside the zips; returns where they are.

    Both come out of the zips, so that they are the same files. Raises ReleaseError where one is missing.
    """
    taken = {}
    for path in sorted(output.glob("*.zip")):
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
            wheels = [name for name in names if name.startswith("wheels/handfit_core-")]
            if len(wheels) != 1 or SBOM not in names:
                raise ReleaseError(f"{path} lacks handfit_core's wheel or {SBOM}; build it anew")
            taken[output / Path(wheels[0]).name] = archive.read(wheels[0])
            taken[path.with_suffix(".cdx.json")] = archive.read(SBOM)
    for path, content in taken.items():
        path.write_bytes(content)
    return list(taken)


def write_source_archive(repository: Path, version: str, output: Path) -> Path:
    """The files of the commit HEAD as .tar.gz; the same commit gives the same bytes."""
    name = f"manient-{version}"
    command = ["git", "-c", "tar.umask=0022", "archive", "--format=tar", f"--prefix={name}/", "HEAD"]
    archive = subprocess.run(command, cwd=repository, capture_output=True, check=True).stdout
    path = output / f"{name}-source.tar.gz"
    path.write_bytes(gzip.compress(archive, mtime=0))
    return path


def write_checksums(output: Path) -> Path:
    """SHA256SUMS of all files in the folder, in the form that `sha256sum -c` reads."""
    lines = []
    for path in sorted(output.iterdir()):
        if path.is_file() and path.name != CHECKSUMS:
            with path.open("rb") as file:
                lines.append(f"{hashlib.file_digest(file, 'sha256').hexdigest()}  {path.name}\n")
    sums = output / CHECKSUMS
    sums.write_text("".join(lines), encoding="utf-8", newline="\n")
    return sums


def _git(repository: Path, *arguments: str) -> str:
    """What git answers. Raises ReleaseError, also outside of a repository."""
    try:
        done = subprocess.run(
            ["git", *arguments], cwd=repository, capture_output=True, text=True, encoding="utf-8", check=False
        )
    except FileNotFoundError:
        raise ReleaseError("git is not installed; a release is made from a git repository") from None
    if done.returncode:
        raise ReleaseError(f"{repository}: git says: {done.stderr.strip()}; make the release from a clone")
    return done.stdout.rstrip("\n")


if __name__ == "__main__":
    sys.exit(main())
