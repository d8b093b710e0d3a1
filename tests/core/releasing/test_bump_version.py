"""scripts/bump_version.py: one command sets the version, and dates the changelog's section."""

from __future__ import annotations

import datetime
import shutil
import tomllib
from pathlib import Path

import pytest

from scripts.bump_version import bump, main
from scripts.releasing.changelog import release_notes
from scripts.releasing.errors import ReleaseError

ROOT = Path(__file__).resolve().parents[3]
DAY = datetime.date(2026, 12, 1)

CHANGELOG = """# Changelog

## Unreleased

### Added
- A new thing.

## 1.1.0 - 2026-10-02

### Fixed
- An old thing.
"""


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    manifest = 'schema_version = "1.0.0"\n\nid = "manient"\nversion = "1.1.0"\ntype = "add-on"\n'
    (tmp_path / "blender_manifest.toml").write_text(manifest)
    (tmp_path / "CHANGELOG.md").write_text(CHANGELOG)
    return tmp_path


def files(repository: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in repository.iterdir()}


def test_manifest_has_the_new_version_and_is_the_same_otherwise(repository: Path) -> None:
    bump(repository, "1.2.0", DAY)
    assert (repository / "blender_manifest.toml").read_text() == (
        'schema_version = "1.0.0"\n\nid = "manient"\nversion = "1.2.0"\ntype = "add-on"\n'
    )


def test_changes_move_under_the_version_with_its_date(repository: Path) -> None:
    bump(repository, "1.2.0", DAY)
    text = (repository / "CHANGELOG.md").read_text()
    assert (
        "## Unreleased\n\n## 1.2.0 - 2026-12-01\n\n### Added\n- A new thing.\n\n## 1.1.0 - 2026-10-02" in text
    )
    assert release_notes(text, "1.2.0") == "### Added\n- A new thing.\n"
    assert release_notes(text, "1.1.0") == "### Fixed\n- An old thing.\n"


def test_manifests_version_may_get_its_section(repository: Path) -> None:
    """The first release of all has a version in the manifest from the start."""
    changelog = CHANGELOG.split("## 1.1.0")[0]
    (repository / "CHANGELOG.md").write_text(changelog)
    bump(repository, "1.1.0", DAY)
    assert release_notes((repository / "CHANGELOG.md").read_text(), "1.1.0") == "### Added\n- A new thing.\n"


@pytest.mark.parametrize(
    ("version", "changelog", "says"),
    [
        ("1.0.9", CHANGELOG, "1.0.9 is lower than 1.1.0"),
        ("1.1.0", CHANGELOG, "has a section for 1.1.0 already"),
        ("1.2", CHANGELOG, '"1.2" is not a version'),
        ("1.2.0-beta", CHANGELOG, '"1.2.0-beta" is not a version'),
        ("v1.2.0", CHANGELOG, '"v1.2.0" is not a version'),
        ("1.2.0", CHANGELOG.replace("- A new thing.\n", ""), "lists nothing under ## Unreleased"),
        ("1.2.0", CHANGELOG.replace("Unreleased", "Soon"), "lists nothing under ## Unreleased"),
    ],
)
def test_refusal_is_a_sentence_and_changes_nothing(
    repository: Path, capsys: pytest.CaptureFixture[str], version: str, changelog: str, says: str
) -> None:
    (repository / "CHANGELOG.md").write_text(changelog)
    before = files(repository)
    assert main([version], repository) == 1
    said = capsys.readouterr().err
    assert says in said
    assert said.count("\n") == 1
    assert files(repository) == before


def test_manifest_without_a_version_line_is_refused_before_anything_is_written(repository: Path) -> None:
    (repository / "blender_manifest.toml").write_text('version="1.1.0"\n')
    before = files(repository)
    with pytest.raises(ReleaseError, match="needs one"):
        bump(repository, "1.2.0", DAY)
    assert files(repository) == before


@pytest.mark.parametrize("name", ["CHANGELOG.md", "blender_manifest.toml"])
def test_a_missing_file_is_a_sentence(
    repository: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    (repository / name).unlink()
    assert main(["1.2.0"], repository) == 1
    said = capsys.readouterr().err
    assert f"{name} cannot be read" in said
    assert said.count("\n") == 1


def test_it_works_on_this_repositorys_own_files(tmp_path: Path) -> None:
    for name in ("blender_manifest.toml", "CHANGELOG.md"):
        shutil.copy(ROOT / name, tmp_path)
    if "## Unreleased\n\n## " in (tmp_path / "CHANGELOG.md").read_text(encoding="utf-8"):
        with pytest.raises(ReleaseError, match="lists nothing"):  # just after a release
            bump(tmp_path, "99.0.0", DAY)
        return
    bump(tmp_path, "99.0.0", DAY)
    assert release_notes((tmp_path / "CHANGELOG.md").read_text(encoding="utf-8"), "99.0.0")
    assert tomllib.loads((tmp_path / "blender_manifest.toml").read_text())["version"] == "99.0.0"
