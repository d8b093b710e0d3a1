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
    main,
    make,
    put_in_place,
    refuse_foreign_files,
    take_from_zips,
    unpack_source,
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


def test_source_archive_has_the_commits_files_and_the_same_bytes_for_everybody(repository: Path) -> None:
    (repository / "run.sh").touch(mode=0o700)
    commit(repository)
    (repository / "not-committed.py").touch()
    path = write_source_archive(repository, "1.2.0", repository.parent)
    first = path.read_bytes()
    git(repository, "config", "tar.umask", "0077")
    git(repository, "config", "core.autocrlf", "true")
    assert write_source_archive(repository, "1.2.0", repository.parent).read_bytes() == first
    with tarfile.open(path, "r:") as archive:  # not compressed: those bytes depend on the zlib at hand
        modes = {member.name: member.mode for member in archive.getmembers() if member.isfile()}
    assert modes == {
        "manient-1.2.0/CHANGELOG.md": 0o644,
        "manient-1.2.0/blender_manifest.toml": 0o644,
        "manient-1.2.0/run.sh": 0o755,
    }


def test_what_is_built_is_the_commits_files_without_what_git_ignores(repository: Path) -> None:
    (repository / ".gitignore").write_text("*.task\n")
    commit(repository)
    (repository / "second.task").touch()
    (repository / "stray.py").touch()
    unpack_source(write_source_archive(repository, "1.2.0", repository.parent), repository.parent / "source")
    names = {path.name for path in (repository.parent / "source" / "manient-1.2.0").iterdir()}
    assert names == {".gitignore", "CHANGELOG.md", "blender_manifest.toml"}


def test_checksums_are_those_of_the_files(tmp_path: Path) -> None:
    (tmp_path / "b.zip").write_bytes(b"two")
    (tmp_path / "a.whl").write_bytes(b"one")
    text = write_checksums(tmp_path).read_text()
    assert [line.split("  ")[1] for line in text.splitlines()] == ["a.whl", "b.zip"]
    assert text.startswith("7692c3ad3540bb803c020b3aee66cd8887123234ea0c6e7143c0add73ff431ed  a.whl\n")
    assert write_checksums(tmp_path).read_text() == text  # it is not in its own list


def test_core_wheel_and_sboms_are_those_in_the_zips(tmp_path: Path) -> None:
    for platform in ("linux_x64", "windows_x64"):
        with zipfile.ZipFile(tmp_path / f"manient-1.2.0-{platform}.zip", "w") as archive:
            archive.writestr("wheels/torch-2.0-py3-none-any.whl", b"other")
            archive.writestr("wheels/handfit_core-1.2.0-py3-none-any.whl", b"core")
            archive.writestr("sbom.cdx.json", platform)
    taken = take_from_zips(tmp_path)
    assert len(taken) == 3
    assert {path.name: path.read_bytes() for path in taken} == {
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


@pytest.mark.parametrize(
    "other", ["handfit_core-1.2.0-py3-none-any.whl", "handfit_core-1.1.0-py3-none-any.whl"]
)
def test_zips_with_different_cores_are_refused(tmp_path: Path, other: str) -> None:
    for platform, name in (("linux_x64", "handfit_core-1.2.0-py3-none-any.whl"), ("windows_x64", other)):
        with zipfile.ZipFile(tmp_path / f"manient-1.2.0-{platform}.zip", "w") as archive:
            archive.writestr(f"wheels/{name}", f"core of {platform}")
            archive.writestr("sbom.cdx.json", platform)
    with pytest.raises(ReleaseError, match=r"windows_x64\.zip has another wheel of handfit_core"):
        take_from_zips(tmp_path)
    assert len(list(tmp_path.iterdir())) == 2


def finished(folder: Path, version: str = "1.1.0") -> Path:
    """A folder as a release leaves it."""
    folder.mkdir()
    (folder / f"manient-{version}-linux_x64.zip").write_text(version)
    (folder / "RELEASE_NOTES.md").touch()
    write_checksums(folder)
    return folder


def test_an_older_release_is_replaced(tmp_path: Path) -> None:
    output = finished(tmp_path / "release")
    (tmp_path / "work").mkdir()
    put_in_place(finished(tmp_path / "work" / "made", "1.2.0"), output)
    assert {path.name for path in output.iterdir()} == {
        "manient-1.2.0-linux_x64.zip",
        "RELEASE_NOTES.md",
        "SHA256SUMS",
    }


@pytest.mark.parametrize("foreign", ["precious.txt", "manient-diary.zip", "manient-1.1.0-linux_x64.zip.d/x"])
def test_a_folder_with_anything_else_in_it_is_refused_and_kept(tmp_path: Path, foreign: str) -> None:
    output = finished(tmp_path / "release")
    (output / foreign).parent.mkdir(exist_ok=True)
    (output / foreign).write_text("mine")
    with pytest.raises(ReleaseError, match="no release wrote this"):
        refuse_foreign_files(output)
    assert (output / foreign).read_text() == "mine"


def test_a_folder_with_sums_of_its_own_files_is_refused(tmp_path: Path) -> None:
    """Many downloads have a SHA256SUMS."""
    (tmp_path / "other.iso").touch()
    write_checksums(tmp_path)
    with pytest.raises(ReleaseError, match=r"other\.iso: no release wrote this"):
        refuse_foreign_files(tmp_path)


def test_a_link_to_somewhere_else_is_refused(tmp_path: Path) -> None:
    finished(tmp_path / "release")
    try:
        (tmp_path / "link").symlink_to(tmp_path / "release")
    except OSError:
        pytest.skip("this user may not make symbolic links")
    with pytest.raises(ReleaseError, match="this is not a folder"):
        refuse_foreign_files(tmp_path / "link")


def test_a_release_that_fails_keeps_the_one_before(repository: Path, tmp_path: Path) -> None:
    """This repository has no scripts/build_extension.py, so its zips cannot be built."""
    output = finished(tmp_path / "release")
    before = {path.name: path.read_bytes() for path in output.iterdir()}
    beside = sorted(tmp_path.iterdir())
    with pytest.raises(ReleaseError, match="zips could not be built"):
        make(repository, output, "1.2.0", "notes")
    assert {path.name: path.read_bytes() for path in output.iterdir()} == before
    assert sorted(tmp_path.iterdir()) == beside


@pytest.mark.parametrize("output", ["file", "file/below"])
def test_an_output_that_is_no_folder_is_one_sentence(
    repository: Path, capsys: pytest.CaptureFixture[str], output: str
) -> None:
    (repository.parent / "file").write_text("mine")
    assert main(["-o", str(repository.parent / output)], repository) == 1
    said = capsys.readouterr().err
    assert "with -o" in said
    assert said.count("\n") == 1
    assert (repository.parent / "file").read_text() == "mine"


@pytest.mark.parametrize(
    ("name", "text"),
    [("CHANGELOG.md", None), ("blender_manifest.toml", None)] + [("blender_manifest.toml", "id = \n")],
)
def test_a_file_that_is_missing_or_broken_is_one_sentence(
    repository: Path, capsys: pytest.CaptureFixture[str], name: str, text: str | None
) -> None:
    (repository / name).unlink()
    if text:
        (repository / name).write_text(text)
    commit(repository)
    assert main(["-o", str(repository.parent / "out")], repository) == 1
    said = capsys.readouterr().err
    assert name in said
    assert said.count("\n") == 1
