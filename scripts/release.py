#!/usr/bin/env python3
"""Make everything that a release publishes, into out/release/ (or -o DIR), which must not exist yet:

    manient-VERSION-PLATFORM.zip            the add-on for each platform
    handfit_core-VERSION-py3-none-any.whl   the core alone, the same file as in the zips
    manient-VERSION-source.tar              the commit's files
    manient-VERSION-PLATFORM.cdx.json       what is in each zip (SBOM, CycloneDX), the same file as in the zip
    RELEASE_NOTES.md                        the version's section of CHANGELOG.md
    SHA256SUMS                              of all of these: sha256sum -c SHA256SUMS

The version is the manifest's; `nox -s bump` sets it. All is made from the files of the commit, not from those
that lie about, and the same commit gives the same bytes: nothing is compressed here, since the bytes would
depend on the zlib of the Python at work.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tarfile
import tempfile
import tomllib
import zipfile
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from scripts.extension.wheels import PLATFORMS, sha256_of


class ReleaseError(Exception):
    """An obstacle to the release, in one sentence."""


def main(argv: Sequence[str] | None = None, repository: Path = ROOT) -> int:
    """Check, build, and write the checksums; returns the exit code."""
    parser = argparse.ArgumentParser(description="Make everything that a release publishes.")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "release", metavar="DIR")
    output = parser.parse_args(argv).output.absolute()
    try:
        manifest = tomllib.loads((repository / "blender_manifest.toml").read_text(encoding="utf-8"))
        version = manifest["version"]
        notes = checked_notes(repository, version)
        if output.exists():
            raise ReleaseError(f"{output}: something is there already; move it away, or name another with -o")
        output.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".release-", dir=output.parent) as temporary:
            made = Path(temporary) / "made"
            made.mkdir()
            archive = write_source_archive(repository, version, made)
            with tarfile.open(archive) as opened:
                opened.extractall(temporary, filter="data")
            build_zips(Path(temporary) / f"manient-{version}", made)
            take_from_zips(made)
            (made / "RELEASE_NOTES.md").write_text(notes, encoding="utf-8", newline="\n")
            write_checksums(made)
            made.rename(output)
    except (ReleaseError, OSError, tomllib.TOMLDecodeError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print((output / "SHA256SUMS").read_text(encoding="utf-8"), end="")
    print(f"release {version} is in {output}")
    return 0


def checked_notes(repository: Path, version: str) -> str:
    """The release's notes, after everything was checked that costs no time.

    Raises ReleaseError: changes that are not committed, no section of the version in CHANGELOG.md or an empty
    one, or a version that was released before.
    """
    if changed := _git(repository, "status", "--porcelain").splitlines():
        raise ReleaseError(f"{changed[0][3:]} is changed or not in git; commit everything")
    changelog = (repository / "CHANGELOG.md").read_text(encoding="utf-8")
    heading = rf"^## {re.escape(version)} - \d{{4}}-\d\d-\d\d\n(.*?)(?=^## |\Z)"
    section = re.search(heading, changelog, re.MULTILINE | re.DOTALL)
    if section is None or not re.search(r"^[-*] ", section[1], re.MULTILINE):
        raise ReleaseError(
            f"CHANGELOG.md lists no changes under ## {version} - YYYY-MM-DD; `nox -s bump -- {version}` "
            "moves those of Unreleased there"
        )
    tag = f"v{version}"
    # A release of a public host runs on the tag itself.
    tagged = _git(repository, "tag", "--list", tag) and _git(repository, "rev-list", "-n", "1", tag)
    if tagged and tagged != _git(repository, "rev-parse", "HEAD"):
        raise ReleaseError(f"{version} is released already (tag {tag}, another commit); bump the version")
    return section[1].strip() + "\n"


def build_zips(source: Path, output: Path) -> None:
    """The zip of every platform, by scripts/build_extension.py. Raises ReleaseError."""
    command = [sys.executable, str(source / "scripts" / "build_extension.py")]
    command += ["--platform", ",".join(PLATFORMS), "--output", str(output)]
    if subprocess.run(command, check=False).returncode:
        raise ReleaseError("the zips could not be built; scripts/build_extension.py says why above")


def take_from_zips(output: Path) -> None:
    """Put the core's wheel and each zip's list of its parts beside the zips."""
    for path in sorted(output.glob("*.zip")):
        with zipfile.ZipFile(path) as archive:
            (core,) = (name for name in archive.namelist() if name.startswith("wheels/handfit_core-"))
            (output / Path(core).name).write_bytes(archive.read(core))
            path.with_suffix(".cdx.json").write_bytes(archive.read("sbom.cdx.json"))


def write_source_archive(repository: Path, version: str, output: Path) -> Path:
    """The files of the commit HEAD as .tar; the same commit gives the same bytes. Raises ReleaseError."""
    path = output / f"manient-{version}-source.tar"
    # What a user's git is set to must not show in the bytes.
    settings = ["-c", "tar.umask=0022", "-c", "core.autocrlf=false"]
    _git(repository, *settings, "archive", f"--prefix=manient-{version}/", f"--output={path}", "HEAD")
    return path


def write_checksums(output: Path) -> None:
    """SHA256SUMS of all files in the folder, in the form that `sha256sum -c` reads."""
    lines = [f"{sha256_of(path)}  {path.name}\n" for path in sorted(output.iterdir())]
    (output / "SHA256SUMS").write_text("".join(lines), encoding="utf-8", newline="\n")


def _git(repository: Path, *arguments: str) -> str:
    """The output of a git command. Raises ReleaseError, also outside of a repository."""
    done = subprocess.run(
        ["git", *arguments], cwd=repository, capture_output=True, text=True, encoding="utf-8", check=False
    )
    if done.returncode:
        raise ReleaseError(f"{repository}: git says: {done.stderr.strip()}; make the release from a clone")
    return done.stdout.rstrip("\n")


if __name__ == "__main__":
    sys.exit(main())
