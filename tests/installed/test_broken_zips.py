"""Zips that are damaged or for something else: a sentence in the panel and on the command line.

Some of them Blender refuses itself; what it takes in, the add-on must find.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.installed import zips
from tests.installed.conftest import PYTHON
from tests.installed.sealed import Sealed
from tests.installed.zips import Files

MEDIAPIPE = "mediapipe"
CORE = "handfit-core"


def transmission_error(files: Files, path: Path) -> Path:
    """A byte of the zip was changed on the way, in a wheel."""
    content = bytearray(zips.write(files, path).read_bytes())
    content[zips.place_of(content, zips.wheel_of(files, MEDIAPIPE))] ^= 0x10
    path.write_bytes(content)
    return path


def byte_of_a_part(files: Files, path: Path) -> Path:
    """A wheel that captures need was changed, and packed into a proper zip."""
    zips.change_byte(files, zips.wheel_of(files, MEDIAPIPE), "mediapipe/__init__.py")
    return zips.write(files, path)


def byte_of_the_core(files: Files, path: Path) -> Path:
    """The wheel was changed without which the add-on cannot run at all."""
    zips.change_byte(files, zips.wheel_of(files, CORE), "handfit_core/take.py")
    return zips.write(files, path)


def part_is_missing(files: Files, path: Path) -> Path:
    """A wheel was left out; the manifest names it."""
    del files[zips.wheel_of(files, MEDIAPIPE)]
    return zips.write(files, path)


def core_is_missing(files: Files, path: Path) -> Path:
    """handfit_core's wheel was left out, also of the manifest."""
    name = zips.wheel_of(files, CORE)
    del files[name]
    zips.unlist(files, name)
    return zips.write(files, path)


def other_platform(files: Files, path: Path) -> Path:
    """The zip for Windows."""
    zips.set_manifest(files, "platforms", '["windows-x64"]')
    zips.change_contents(files, platform="windows-x64")
    return zips.write(files, path)


def other_platform_unnoticed(files: Files, path: Path) -> Path:
    """The same where Blender takes it for ours."""
    zips.change_contents(files, platform="windows-x64")
    return zips.write(files, path)


def other_python(files: Files, path: Path) -> Path:
    """A zip with no wheel for this Python, of the add-on's own kind: any Python's."""
    zips.change_contents(files, pythons=["3.9"])
    return zips.write(files, path)


def wheels_of_another_python(files: Files, path: Path) -> Path:
    """A zip with a wheel that says so in its name."""
    name = zips.wheel_of(files, MEDIAPIPE)
    zips.rename_wheel(files, name, name.replace("-py3-none-", "-cp39-cp39-"))
    return zips.write(files, path)


def broken_off_download(files: Files, path: Path) -> Path:
    """The first third of the zip; at its half a wheel ends, whose list of files passes for the zip's."""
    content = zips.write(files, path).read_bytes()
    path.write_bytes(content[: len(content) // 3])
    return path


@dataclass(frozen=True)
class Case:
    """What becomes of a zip, and the words by which the artist knows what is wrong."""

    make: Callable[[Files, Path], Path]
    said: tuple[str, ...]
    runs: bool = True
    """Whether the add-on itself runs, and only cannot capture"""


REFUSED = (
    Case(transmission_error, ("Bad CRC-32", MEDIAPIPE)),
    Case(broken_off_download, ("not a zip file",)),
    Case(other_platform, ("linux-x64", "windows-x64")),
    Case(wheels_of_another_python, (f"This Python version ({PYTHON})", "(3.9)")),
)
"""By Blender itself, in its own words"""
TAKEN = (
    Case(byte_of_a_part, (MEDIAPIPE, "has not unpacked", "again")),
    Case(byte_of_the_core, ("handfit-core", "has not unpacked", "again"), runs=False),
    Case(part_is_missing, (MEDIAPIPE, "is missing", "once more")),
    Case(core_is_missing, ("handfit-core", "is missing", "once more"), runs=False),
    Case(other_platform_unnoticed, ("for Windows", "linux_x64.zip")),
    Case(other_python, (f"this Blender has Python {PYTHON}", "linux_x64.zip")),
)


@dataclass(frozen=True)
class Tried:
    """A case, and what came of it."""

    case: Case
    facts: dict
    said: str
    processes: list[str]


@pytest.fixture(scope="module")
def try_out(new_sealed: Callable[[], Sealed], zipped: Path, samples: Path, tmp_path_factory):
    """try_out(case) -> what a Blender of its own made of the zip."""

    def tried(case: Case) -> Tried:
        path = tmp_path_factory.mktemp("zip") / "manient.zip"
        sealed = new_sealed()
        finished = sealed.run(
            "attempts",
            zip=sealed.give(case.make(zips.light(zipped), path)),
            photo=sealed.give(samples / "photos" / "thumb_up.jpg"),
        )
        assert finished.code == 0, finished.said
        return Tried(case, finished.facts, finished.said, sealed.processes())

    return tried


@pytest.mark.parametrize("case", REFUSED, ids=lambda case: case.make.__name__)
def test_blender_refuses_and_tells_why(try_out, case):
    tried = try_out(case)
    assert tried.facts["installed"]["enabled"] == []
    said = tried.said + tried.facts["installed"]["said"]
    assert all(word in said for word in case.said), said
    assert_nothing_left(tried)


@pytest.fixture(scope="module", params=TAKEN, ids=lambda case: case.make.__name__)
def tried(request, try_out) -> Tried:
    found = try_out(request.param)
    assert found.facts["installed"]["enabled"], found.said
    return found


def test_the_panel_has_a_sentence(tried):
    shown = tried.facts["panels"]["said"]
    assert_sentence(" ".join(shown), tried.case)
    assert any(panel.startswith("[Capture]") for panel in shown) == tried.case.runs


@pytest.mark.parametrize("command", ["check", "batch"])
def test_the_command_line_has_a_sentence_and_an_exit_code(tried, command):
    found = tried.facts[command]
    assert found["code"] == 1
    assert_sentence(found["out"] + found["err"], tried.case)


def test_the_button_has_a_sentence(tried):
    assert ("button" in tried.facts) == tried.case.runs
    if tried.case.runs:  # Blender cuts long ones
        assert tried.case.said[0].lower() in tried.facts["button"]["said"].lower()


def test_no_traceback_and_nothing_left(tried):
    assert_nothing_left(tried)


def assert_sentence(text: str, case: Case) -> None:
    text = " ".join(text.split()).lower()
    assert all(word.lower() in text for word in case.said), text


def assert_nothing_left(tried: Tried) -> None:
    assert "Traceback" not in tried.said
    assert "Traceback" not in str(tried.facts)
    assert tried.facts["left"] == {"traces": {}, "enabled": []}
    assert tried.processes == []
