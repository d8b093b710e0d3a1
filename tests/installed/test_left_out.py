"""A zip without torch for this Blender's Python, in a Blender where no other Python is named."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.installed.conftest import PYTHON
from tests.installed.sealed import Finished

WHY = "this Blender cannot capture by itself"
REMEDY = "choose a Python of your own"


@pytest.fixture(scope="module")
def tried(new_sealed, zipped: Path, left_out: str, samples: Path) -> Finished:
    if not left_out:
        pytest.skip(f"nothing is left out of this zip for Python {PYTHON}")
    sealed = new_sealed()
    photo = sealed.give(samples / "photos" / "thumb_up.jpg")
    finished = sealed.run("attempts", zip=sealed.give(zipped), photo=photo)
    assert finished.code == 0, finished.said
    return finished


def test_it_installs_and_all_but_capturing_is_there(tried):
    assert tried.facts["installed"]["enabled"] == ["bl_ext.user_default.manient"]
    panels = " ".join(tried.facts["panels"]["said"])
    assert all(f"[{section}]" in panels for section in ("Source", "Capture", "Refine", "Export"))


def test_the_panel_says_once_what_to_do(tried):
    """The field for it is right there; why is told by the tooltip of the button, and by what follows here."""
    said = tried.facts["panels"]["said"]
    assert [text for text in said if "Python" in text] == ["[Installation] Choose a Python that captures"]


@pytest.mark.parametrize("command", ["check", "batch"])
def test_so_does_the_command_line(tried, command):
    found = tried.facts[command]
    assert found["code"] == 1
    said = (found["out"] + found["err"]).replace("This", "this")
    assert WHY in said
    assert REMEDY in said


def test_the_report_tells_the_builds_reason(tried, left_out):
    assert left_out in tried.facts["check"]["out"]


def test_so_does_the_button(tried):
    assert WHY in tried.facts["button"]["said"].replace("This", "this")


def test_no_traceback(tried):
    assert "Traceback" not in tried.said
    assert "Traceback" not in str(tried.facts)
