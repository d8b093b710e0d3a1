#!/usr/bin/env python3
"""Make everything that a release publishes, into out/release/:

    python scripts/release.py [--allow-dirty] [--output DIR]      # nox -s release

    manient-VERSION-PLATFORM.zip            the add-on for each platform
    handfit_core-VERSION-py3-none-any.whl   the core alone, the same file as in the zips
    manient-VERSION-source.tar              the commit's files
    manient-VERSION-PLATFORM.cdx.json       what is in each zip (SBOM, CycloneDX), the same file as in the zip
    RELEASE_NOTES.md                        the version's section of CHANGELOG.md
    SHA256SUMS                              of all of these: sha256sum -c SHA256SUMS

The version is the manifest's; scripts/bump_version.py sets it. All is made from the files of the commit, not
from those that lie about, and the same commit gives the same bytes: nothing is compressed here, since the
bytes would depend on the zlib of the Python at work. The folder is replaced once everything is there.
"""

from __future__ import annotations

import argparse
import hashlib
import re
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from scripts.extension.targets import PLATFORM_NAMES
from scripts.releasing.changelog import changelog_text, release_notes
from scripts.releasing.errors import ReleaseError
from scripts.releasing.versions import current_version

CHECKSUMS = "SHA256SUMS"
NOTES = "RELEASE_NOTES.md"
SBOM = "sbom.cdx.json"
"""inside a zip"""
_OURS = re.compile(r"manient-[^/]+(\.zip|\.tar(\.gz)?|\.cdx\.json)|handfit_core-[^/]+\.whl|RELEASE_NOTES\.md")
"""Names of what a release publishes"""


def main(argv: Sequence[str] | None = None, repository: Path = ROOT) -> int:
    """Check, build, and write the checksums; returns the exit code."""
    parser = argparse.ArgumentParser(description="Make everything that a release publishes.")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "release", metavar="DIR")
    parser.add_argument(
        "--allow-dirty",
        action="store_true",
        help="to try it out: build the zips from the working tree, with what is not committed; the source "
        "archive holds the commit's files all the same, so that the two differ",
    )
    args = parser.parse_args(argv)
    try:
        version = current_version(repository)
        notes = checked_notes(repository, version, args.allow_dirty)
        sums = make(repository, args.output, version, notes, args.allow_dirty)
    except ReleaseError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(sums.read_text(encoding="utf-8"), end="")
    print(f"release {version} is in {args.output}")
    return 0


def make(repository: Path, output: Path, version: str, notes: str, allow_dirty: bool = False) -> Path:
    """Build everything beside the folder `output`, and put it in its place; returns the checksums' file.

    What stands there is kept where anything fails. Raises ReleaseError.
    """
    refuse_foreign_files(output)
    try:
        output.absolute().parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".release-", dir=output.absolute().parent) as temporary:
            made, source = Path(temporary) / "made", Path(temporary) / "source"
            made.mkdir()
            archive = write_source_archive(repository, version, made)
            if not allow_dirty:
                unpack_source(archive, source)
            build_zips(repository if allow_dirty else source / f"manient-{version}", made)
            take_from_zips(made)
            (made / NOTES).write_text(notes, encoding="utf-8", newline="\n")
            write_checksums(made)
            put_in_place(made, output)
    except OSError as error:
        raise ReleaseError(
            f"{error.filename or output}: cannot be written ({error.strerror}); name another folder with -o"
        ) from error
    return output / CHECKSUMS


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
    notes = release_notes(changelog_text(repository), version)
    tag = f"v{version}"
    # A release of a public host runs on the tag itself.
    tagged = _git(repository, "tag", "--list", tag) and _git(repository, "rev-list", "-n", "1", tag)
    if tagged and tagged != _git(repository, "rev-parse", "HEAD"):
        raise ReleaseError(
            f"{version} is released already (tag {tag}, another commit); give the release a new version with "
            "scripts/bump_version.py"
        )
    return notes


def refuse_foreign_files(output: Path) -> None:
    """Raise ReleaseError where `output` is anything but a folder that holds a release and nothing else.

    That is: every entry is a file by a name that a release gives, and stands in the folder's SHA256SUMS.
    """
    if output.is_symlink() or (output.exists() and not output.is_dir()):
        raise ReleaseError(f"{output}: this is not a folder; name another with -o")
    if not output.is_dir():
        return
    sums = output / CHECKSUMS
    listed = set()
    if sums.is_file():
        text = sums.read_text(encoding="utf-8", errors="replace")
        listed = {line.partition("  ")[2] for line in text.splitlines()}
    for path in sorted(output.iterdir()):
        ours = path == sums or (path.name in listed and _OURS.fullmatch(path.name))
        if not ours or path.is_symlink() or not path.is_file():
            raise ReleaseError(
                f"{path}: no release wrote this, and the folder would be replaced; move it elsewhere, or "
                "name another folder with -o"
            )


def put_in_place(made: Path, output: Path) -> None:
    """Move the folder `made` to `output`; an older release there goes. Raises ReleaseError, OSError."""
    refuse_foreign_files(output)  # something may have come there meanwhile
    old = made.with_name("old")
    if output.is_dir():
        output.rename(old)
    try:
        made.rename(output)
    except OSError:
        if old.is_dir():
            old.rename(output)
        raise


def build_zips(repository: Path, output: Path) -> None:
    """The zip of every platform, by scripts/build_extension.py. Raises ReleaseError."""
    command = [sys.executable, str(repository / "scripts" / "build_extension.py")]
    command += ["--platform", ",".join(PLATFORM_NAMES), "--output", str(output)]
    done = subprocess.run(command, check=False)
    if done.returncode:
        raise ReleaseError("the zips could not be built; scripts/build_extension.py says why above")


def take_from_zips(output: Path) -> list[Path]:
    """The core's wheel, and each zip's list of its parts, put beside the zips; returns where they are.

    Both come out of the zips, so that they are the same files. Raises ReleaseError where one is missing, or
    two zips have different wheels of the core.
    """
    taken: dict[Path, bytes] = {}
    for path in sorted(output.glob("*.zip")):
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
            wheels = [name for name in names if name.startswith("wheels/handfit_core-")]
            if len(wheels) != 1 or SBOM not in names:
                raise ReleaseError(f"{path} lacks handfit_core's wheel or {SBOM}; build it anew")
            core, content = output / Path(wheels[0]).name, archive.read(wheels[0])
            if any(other.suffix == ".whl" and (other, taken[other]) != (core, content) for other in taken):
                raise ReleaseError(
                    f"{path} has another wheel of handfit_core than the zips before it; the source was "
                    "changed while they were built, so begin again"
                )
            taken[core] = content
            taken[path.with_suffix(".cdx.json")] = archive.read(SBOM)
    for path, content in taken.items():
        path.write_bytes(content)
    return list(taken)


def write_source_archive(repository: Path, version: str, output: Path) -> Path:
    """The files of the commit HEAD as .tar; the same commit gives the same bytes. Raises ReleaseError."""
    name = f"manient-{version}"
    path = output / f"{name}-source.tar"
    # What a user's git is set to must not show in the bytes.
    options = ["-c", "tar.umask=0022", "-c", "core.autocrlf=false"]
    _git(
        repository,
        *options,
        "archive",
        "--format=tar",
        f"--prefix={name}/",
        f"--output={path.absolute()}",
        "HEAD",
    )
    return path


def unpack_source(archive: Path, folder: Path) -> None:
    """The commit's files as they are, without anything that git ignores or does not know."""
    with tarfile.open(archive) as opened:
        opened.extractall(folder, filter="data")


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
