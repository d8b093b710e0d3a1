"""scripts/release.py: what it refuses, and that what it writes can be checked and made again."""

import os
import shutil
import subprocess
import tarfile
import zipfile
from pathlib import Path

import pytest

from scripts.release import (
    ReleaseError,
    checked_notes,
    main,
    take_from_zips,
    write_checksums,
    write_source_archive,
)

MANIFEST = 'id = "manient"\nversion = "1.2.0"\n'
CHANGELOG = (
    "# Changelog\n\n## Unreleased\n\n## 1.2.0 - 2026-12-01\n\n### Added\n- A new thing.\n\n## 1.1.0\n- Old.\n"
)

pytestmark = pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")


def git(repository: Path, *arguments: str) -> None:
    """With nothing of this machine's settings."""
    who = {f"GIT_{role}_{what}": "test" for role in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")}
    nowhere = {"GIT_CONFIG_GLOBAL": os.devnull, "GIT_CONFIG_NOSYSTEM": "1"}
    subprocess.run(["git", *arguments], cwd=repository, check=True, env={**os.environ, **who, **nowhere})


def commit(repository: Path) -> None:
    git(repository, "add", "--all")
    git(repository, "commit", "--quiet", "--allow-empty", "--message", "All")


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """A clone that is ready to be released, but for the zips' builder."""
    folder = tmp_path / "clone"
    folder.mkdir()
    (folder / "blender_manifest.toml").write_text(MANIFEST)
    (folder / "CHANGELOG.md").write_text(CHANGELOG)
    git(folder, "init", "--quiet", "--initial-branch=main")
    commit(folder)
    return folder


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("CHANGELOG.md", CHANGELOG.replace("1.2.0", "1.20.0"), "no changes under ## 1.2.0"),
        ("CHANGELOG.md", None, "CHANGELOG.md"),
        ("blender_manifest.toml", "id = \n", "line 1"),
        # This repository has no scripts/build_extension.py.
        ("CHANGELOG.md", CHANGELOG, "zips could not be built"),
    ],
)
def test_what_is_not_ready_is_one_sentence_and_makes_nothing(repository, capsys, name, text, says):
    (repository / name).unlink()
    if text:
        (repository / name).write_text(text)
    commit(repository)
    assert main(["--output", str(repository.parent / "out")], repository) == 1
    said = capsys.readouterr().err
    assert says in said
    assert said.count("\n") == 1
    assert list(repository.parent.iterdir()) == [repository]


def test_a_clean_version_is_released_once_with_its_notes(repository):
    assert checked_notes(repository, "1.2.0") == "### Added\n- A new thing.\n"
    git(repository, "tag", "--annotate", "v1.2.0", "--message", "1.2.0")
    assert checked_notes(repository, "1.2.0")  # the release of this very tag
    (repository / "more.py").touch()
    with pytest.raises(ReleaseError, match=r"^more\.py is changed or not in git; commit"):
        checked_notes(repository, "1.2.0")
    commit(repository)
    with pytest.raises(ReleaseError, match=r"1\.2\.0 is released already"):
        checked_notes(repository, "1.2.0")


def test_source_archive_has_the_commits_files_and_the_same_bytes_for_everybody(repository):
    (repository / "run.sh").touch(mode=0o700)
    (repository / ".gitignore").write_text("*.task\n")
    commit(repository)
    (repository / "second.task").touch()
    path = write_source_archive(repository, "1.2.0", repository.parent)
    first = path.read_bytes()
    git(repository, "config", "tar.umask", "0077")
    git(repository, "config", "core.autocrlf", "true")
    assert write_source_archive(repository, "1.2.0", repository.parent).read_bytes() == first
    with tarfile.open(path, "r:") as archive:  # not compressed: those bytes depend on the zlib at hand
        modes = {member.name: member.mode for member in archive.getmembers() if member.isfile()}
    assert modes == {
        "manient-1.2.0/.gitignore": 0o644,
        "manient-1.2.0/CHANGELOG.md": 0o644,
        "manient-1.2.0/blender_manifest.toml": 0o644,
        "manient-1.2.0/run.sh": 0o755,
    }


def test_core_wheel_and_sboms_are_those_in_the_zips_and_the_sums_are_theirs(tmp_path):
    for platform in ("linux_x64", "windows_x64"):
        with zipfile.ZipFile(tmp_path / f"manient-1.2.0-{platform}.zip", "w") as archive:
            archive.writestr("wheels/handfit_core-1.2.0-py3-none-any.whl", b"one")
            archive.writestr("sbom.cdx.json", platform)
    take_from_zips(tmp_path)
    assert (tmp_path / "handfit_core-1.2.0-py3-none-any.whl").read_bytes() == b"one"
    assert (tmp_path / "manient-1.2.0-windows_x64.cdx.json").read_bytes() == b"windows_x64"
    write_checksums(tmp_path)
    lines = (tmp_path / "SHA256SUMS").read_text().splitlines()
    digest = "7692c3ad3540bb803c020b3aee66cd8887123234ea0c6e7143c0add73ff431ed"
    assert lines[0] == f"{digest}  handfit_core-1.2.0-py3-none-any.whl"
    assert len(lines) == 5
