"""scripts/release.py: what it refuses, and that what it writes can be checked and made again."""

from __future__ import annotations

import os
import shutil
import subprocess
import tarfile
import zipfile
from pathlib import Path

import pytest

from scripts.release import (
    checked_notes,
    emptied,
    main,
    take_from_zips,
    write_checksums,
    write_source_archive,
)
from scripts.releasing.errors import ReleaseError

MANIFEST = 'id = "manient"\nversion = "1.2.0"\n'
CHANGELOG = "# Changelog\n\n## Unreleased\n\n## 1.2.0 - 2026-12-01\n\n### Added\n- A new thing.\n"

pytestmark = pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")


def git(repository: Path, *arguments: str) -> str:
    """With nothing of this machine's settings."""
    who = {f"GIT_{role}_{what}": "test" for role in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")}
    nowhere = {"GIT_CONFIG_GLOBAL": os.devnull, "GIT_CONFIG_NOSYSTEM": "1"}
    done = subprocess.run(
        ["git", "-c", "init.defaultBranch=main", *arguments],
        cwd=repository,
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, **who, **nowhere},
    )
    return done.stdout.strip()


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """A clone that is ready to be released, but for the zips' builder."""
    folder = tmp_path / "clone"
    folder.mkdir()
    (folder / "blender_manifest.toml").write_text(MANIFEST)
    (folder / "CHANGELOG.md").write_text(CHANGELOG)
    git(folder, "init")
    commit(folder)
    return folder


def commit(repository: Path) -> None:
    git(repository, "add", "--all")
    git(repository, "commit", "--message", "All")


def test_notes_are_the_versions_section(repository: Path) -> None:
    assert checked_notes(repository, "1.2.0") == "### Added\n- A new thing.\n"


@pytest.mark.parametrize("name", ["new.py", "CHANGELOG.md"])
def test_uncommitted_changes_are_refused_unless_allowed(repository: Path, name: str) -> None:
    with (repository / name).open("a") as file:
        file.write("- More.\n")
    with pytest.raises(ReleaseError, match=rf"^{name} is changed or not in git; commit"):
        checked_notes(repository, "1.2.0")
    assert "A new thing" in checked_notes(repository, "1.2.0", allow_dirty=True)


@pytest.mark.parametrize(
    ("changelog", "says"),
    [
        ("# Changelog\n\n## Unreleased\n\n- A new thing.\n", "has no section for 1.2.0"),
        (CHANGELOG.replace("1.2.0", "1.20.0"), "has no section for 1.2.0"),
        (CHANGELOG.replace("- A new thing.\n", ""), "section for 1.2.0 is empty"),
        (CHANGELOG.replace(" - 2026-12-01", ""), "heading of 1.2.0 has no date"),
        (CHANGELOG.replace("2026-12-01", "2026-13-01"), "heading of 1.2.0 has no date"),
    ],
)
def test_changelog_must_tell_of_the_version(
    repository: Path, capsys: pytest.CaptureFixture[str], changelog: str, says: str
) -> None:
    (repository / "CHANGELOG.md").write_text(changelog)
    commit(repository)
    output = repository.parent / "out"
    assert main(["--output", str(output)], repository) == 1
    said = capsys.readouterr().err
    assert says in said
    assert said.count("\n") == 1
    assert not output.exists()


def test_version_is_released_once(repository: Path) -> None:
    git(repository, "tag", "--annotate", "v1.2.0", "--message", "1.2.0")
    assert checked_notes(repository, "1.2.0")  # the release of this very tag
    (repository / "more.py").touch()
    commit(repository)
    with pytest.raises(ReleaseError, match=r"1\.2\.0 is released already"):
        checked_notes(repository, "1.2.0")


def test_folder_without_git_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    with pytest.raises(ReleaseError, match="make the release from a clone"):
        checked_notes(tmp_path, "1.2.0")


def test_source_archive_has_the_commits_files_and_the_same_bytes_each_time(repository: Path) -> None:
    (repository / "not-committed.py").touch()
    first = write_source_archive(repository, "1.2.0", repository.parent).read_bytes()
    again = write_source_archive(repository, "1.2.0", repository.parent)
    assert again.read_bytes() == first
    with tarfile.open(again) as archive:
        names = [member.name for member in archive.getmembers() if member.isfile()]
    assert names == ["manient-1.2.0/CHANGELOG.md", "manient-1.2.0/blender_manifest.toml"]


def test_checksums_are_those_of_the_files(tmp_path: Path) -> None:
    (tmp_path / "b.zip").write_bytes(b"two")
    (tmp_path / "a.whl").write_bytes(b"one")
    sums = write_checksums(tmp_path)
    assert [line.split("  ")[1] for line in sums.read_text().splitlines()] == ["a.whl", "b.zip"]
    assert sums.read_text().startswith(
        "7692c3ad3540bb803c020b3aee66cd8887123234ea0c6e7143c0add73ff431ed  a.whl\n"
    )
    assert write_checksums(tmp_path).read_text() == sums.read_text()  # it is not in its own list


def test_core_wheel_and_sboms_are_those_in_the_zips(tmp_path: Path) -> None:
    for platform in ("linux_x64", "windows_x64"):
        with zipfile.ZipFile(tmp_path / f"manient-1.2.0-{platform}.zip", "w") as archive:
            archive.writestr("wheels/torch-2.0-py3-none-any.whl", b"other")
            archive.writestr("wheels/handfit_core-1.2.0-py3-none-any.whl", b"core")
            archive.writestr("sbom.cdx.json", platform)
    assert {path.name: path.read_bytes() for path in take_from_zips(tmp_path)} == {
        "handfit_core-1.2.0-py3-none-any.whl": b"core",
        "manient-1.2.0-linux_x64.cdx.json": b"linux_x64",
        "manient-1.2.0-windows_x64.cdx.json": b"windows_x64",
    }


def test_zip_without_an_sbom_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "manient-1.2.0-linux_x64.zip", "w") as archive:
        archive.writestr("wheels/handfit_core-1.2.0-py3-none-any.whl", b"core")
    with pytest.raises(ReleaseError, match=r"lacks .* sbom\.cdx\.json"):
        take_from_zips(tmp_path)
    assert len(list(tmp_path.iterdir())) == 1


def test_output_folder_is_emptied_only_where_a_release_wrote_it(tmp_path: Path) -> None:
    old = emptied(tmp_path / "release") / "manient-1.1.0-linux_x64.zip"
    old.touch()
    assert [path.name for path in emptied(tmp_path / "release").iterdir()] == ["SHA256SUMS"]
    (tmp_path / "precious.txt").touch()
    with pytest.raises(ReleaseError, match="name another folder"):
        emptied(tmp_path)
    assert (tmp_path / "precious.txt").exists()
