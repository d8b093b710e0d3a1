"""Another version of the add-on in another repository: the two share unpacked wheels, and must not mix."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import pytest

from tests.installed import zips
from tests.installed.sealed import Finished

NEWER, OLDER = "99.0.0", "0.0.1"


@pytest.fixture(scope="module")
def version(zipped: Path) -> str:
    with zipfile.ZipFile(zipped) as archive:
        return json.loads(archive.read(zips.CONTENTS))["version"]


@pytest.fixture(scope="module")
def beside(new_sealed, zipped: Path, samples: Path, tmp_path_factory):
    """beside(version) -> what came of installing that version too."""
    done: dict[str, Finished] = {}

    def install(other: str) -> Finished:
        if other not in done:
            folder, files, sealed = tmp_path_factory.mktemp("zips"), zips.light(zipped), new_sealed()
            first = sealed.give(zips.write(files, folder / "first.zip"))
            zips.as_version(files, other)
            done[other] = sealed.run(
                "two_versions",
                first=first,
                second=sealed.give(zips.write(files, folder / "second.zip")),
                photo=sealed.give(samples / "photos" / "thumb_up.jpg"),
            )
            assert done[other].code == 0, done[other].said
        return done[other]

    return install


@pytest.mark.parametrize("other", [NEWER, OLDER])
def test_the_second_does_not_run_and_says_so(beside, other, version):
    facts = beside(other).facts
    assert facts["first"]["enabled"] == ["bl_ext.user_default.manient"]
    assert facts["second"]["enabled"] == ["bl_ext.user_default.manient", "bl_ext.second.manient"]
    (refusal,) = [text for text in facts["panels"]["said"] if text.startswith("[Installation]")]
    # Which of the reasons is found first depends on whose handfit_core Blender has kept: the newer one.
    expected = "Another copy of this add-on is enabled" if other == NEWER else "two versions of the add-on"
    assert expected in refusal
    assert "/second/" not in facts["loaded"]["addon"]


def test_a_newer_core_is_not_used_by_the_first(beside, version):
    facts = beside(NEWER).facts
    assert facts["first"]["core"] == [f"handfit_core-{version}.dist-info"]
    assert facts["second"]["core"] == [f"handfit_core-{NEWER}.dist-info"]
    for said in (facts["button"]["said"], facts["check"]["out"] + facts["check"]["err"]):
        assert NEWER in said
        assert version in said
        assert "restart Blender" in said
    assert facts["check"]["code"] == 1


def test_an_older_core_does_not_come_in(beside, version):
    facts = beside(OLDER).facts
    assert facts["second"]["core"] == [f"handfit_core-{version}.dist-info"]
    assert OLDER not in facts["check"]["out"]


@pytest.mark.parametrize("other", [NEWER, OLDER])
def test_with_the_second_removed_the_first_works_again(beside, other, version):
    facts = beside(other).facts
    assert facts["second removed"]["said"] == "FINISHED"
    assert facts["second removed"]["enabled"] == ["bl_ext.user_default.manient"]
    assert facts["second removed"]["core"] == [f"handfit_core-{version}.dist-info"]
    alone = facts["panels of the first alone"]["said"]
    assert any(text.startswith("[Capture]") for text in alone)
    assert [text for text in alone if text.startswith("[Installation]")] == []
    assert facts["removed"]["enabled"] == []


@pytest.mark.parametrize("other", [NEWER, OLDER])
def test_no_traceback(beside, other):
    assert "Traceback" not in beside(other).said
