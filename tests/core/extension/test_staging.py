from __future__ import annotations

import tomllib

import pytest

from scripts.extension.errors import BuildError
from scripts.extension.staging import MANIFEST, stage, staged_manifest


def test_the_manifest_is_for_one_platform_and_lists_the_wheels(contents):
    text = MANIFEST.read_text(encoding="utf-8")
    before, after = tomllib.loads(text), tomllib.loads(staged_manifest(text, contents))
    assert after.pop("wheels") == [f"./wheels/{wheel.path.name}" for wheel, _ in contents.wheels]
    assert after.pop("platforms") == ["linux-x64"]
    before.pop("platforms")
    assert after == before


@pytest.mark.parametrize("text", ['id = "x"\n[permissions]\n', 'platforms = [\n  "linux-x64",\n]\n'])
def test_a_manifest_of_another_form_is_refused(contents, text):
    with pytest.raises(BuildError, match="expected one line"):
        staged_manifest(text, contents)


def test_the_folder_holds_the_addon_and_the_wheels_unchanged(contents, tmp_path):
    stage(tmp_path / "staged", contents)
    names = {p.relative_to(tmp_path / "staged").as_posix() for p in (tmp_path / "staged").rglob("*")}
    assert {"__init__.py", "LICENSE", "THIRD_PARTY_LICENSES", "sbom.cdx.json", "wheels.json"} <= names
    assert not [name for name in names if "__pycache__" in name or name.endswith(".pyc")]
    for wheel, _ in contents.wheels:
        assert (tmp_path / "staged" / "wheels" / wheel.path.name).read_bytes() == wheel.path.read_bytes()
