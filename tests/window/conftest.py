"""One real Blender with a window for all tests of a run; see blender_window.py."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.capturing import can_capture
from tests.window.blender_window import ROOT, BlenderCrash, BlenderWindow, installed_profile
from tests.window.inputs import Inputs

CHROOT = os.environ.get("HANDFIT_BLENDER_CHROOT")
CRASHES: list[BlenderCrash] = []
"""After which a scenario was played again"""
MakeWindow = Callable[[tuple[int, int]], BlenderWindow]


def pytest_terminal_summary(terminalreporter) -> None:
    """Show Blender's crashes, which a second try has otherwise hidden."""
    for crash in CRASHES:
        terminalreporter.section("Blender crashed, and its scenario was played again", red=True)
        terminalreporter.line(str(crash))


@pytest.fixture(scope="session")
def make_window(tmp_path_factory) -> Iterator[MakeWindow]:
    """make_window(size) -> a Blender; every scenario gets a new file in it.

    It has the add-on of the zip that HANDFIT_ZIP names, or the checkout's. Screenshots are kept in
    out/window/ where HANDFIT_KEEP_SCREENSHOTS is set.
    """
    if not CHROOT:
        pytest.skip("HANDFIT_BLENDER_CHROOT does not name a chroot with Blender in it")
    if not can_capture():
        pytest.skip("needs a Python with SciPy, OpenCV and MediaPipe in HANDFIT_PYTHON")
    zipped, made = os.environ.get("HANDFIT_ZIP"), []
    profile = installed_profile(CHROOT, Path(zipped), tmp_path_factory.mktemp("user")) if zipped else None
    keep = os.environ.get("HANDFIT_KEEP_SCREENSHOTS")
    screenshots = ROOT / "out" / "window" if keep else tmp_path_factory.mktemp("screenshots")

    def make(size: tuple[int, int]) -> BlenderWindow:
        folder, reachable = tmp_path_factory.mktemp("blender"), tmp_path_factory.getbasetemp()
        made.append(BlenderWindow(str(CHROOT), folder, screenshots, size, reachable, profile))
        return made[-1]

    yield make
    for window in made:
        window.stop()
        CRASHES.extend(filter(None, [window.crash]))


@pytest.fixture(scope="session")
def blender(make_window: MakeWindow) -> BlenderWindow:
    """Blender at an artist's window size."""
    return make_window((1600, 1000))


@pytest.fixture(scope="session")
def small_blender(make_window: MakeWindow) -> BlenderWindow:
    """One with a small window, which is drawn more quickly where there is no graphics card."""
    return make_window((640, 480))


@pytest.fixture
def inputs(tmp_path) -> Inputs:
    """What the scenarios are given, made in a folder of the test's own."""
    return Inputs(tmp_path)
