"""One real Blender with a window for all tests of a run; see blender_window.py."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.window.blender_window import ROOT, BlenderCrash, BlenderWindow, installed_profile
from tests.window.inputs import RENDERED_HAND, write_clip, write_long_take

CHROOT = os.environ.get("HANDFIT_BLENDER_CHROOT")
CRASHES: list[BlenderCrash] = []
"""After which a scenario was played again"""


def pytest_terminal_summary(terminalreporter) -> None:
    """Show Blender's crashes, which a second try has otherwise hidden."""
    if CRASHES:
        terminalreporter.section(f"Blender crashed: {len(CRASHES)}, each followed by a second try", red=True)
        for crash in CRASHES:
            terminalreporter.line(str(crash))


@pytest.fixture(scope="session")
def screenshots(tmp_path_factory) -> Path:
    """Where pictures of the screen are kept: out/window/ where HANDFIT_KEEP_SCREENSHOTS is set."""
    if os.environ.get("HANDFIT_KEEP_SCREENSHOTS"):
        return ROOT / "out" / "window"
    return tmp_path_factory.mktemp("screenshots")


@pytest.fixture(scope="session")
def profile(tmp_path_factory) -> Path | None:
    """A user's folder with the zip that HANDFIT_ZIP names; without it, windows have the checkout's add-on."""
    if not CHROOT:
        pytest.skip("HANDFIT_BLENDER_CHROOT does not name a chroot with Blender in it")
    zipped = os.environ.get("HANDFIT_ZIP")
    return installed_profile(CHROOT, Path(zipped), tmp_path_factory.mktemp("user")) if zipped else None


@pytest.fixture(scope="session")
def blender(tmp_path_factory, screenshots, profile) -> Iterator[BlenderWindow]:
    """Blender at an artist's window size; every scenario gets a new file in it."""
    yield from _window(tmp_path_factory, screenshots, profile, (1600, 1000))


@pytest.fixture(scope="session")
def small_blender(tmp_path_factory, screenshots, profile) -> Iterator[BlenderWindow]:
    """One with a small window, which is drawn more quickly where there is no graphics card."""
    yield from _window(tmp_path_factory, screenshots, profile, (640, 480))


@pytest.fixture
def own_blender(tmp_path_factory, screenshots, profile) -> Iterator[BlenderWindow]:
    """A Blender for one test alone."""
    yield from _window(tmp_path_factory, screenshots, profile, (640, 480))


def _window(
    tmp_path_factory, screenshots: Path, profile: Path | None, size: tuple[int, int]
) -> Iterator[BlenderWindow]:
    folder, reachable = tmp_path_factory.mktemp("blender"), tmp_path_factory.getbasetemp()
    window = BlenderWindow(str(CHROOT), folder, screenshots, size, reachable, profile)
    yield window
    window.stop()
    CRASHES.extend(window.crashes)


@pytest.fixture(scope="session")
def rendered_hand() -> Path:
    """The bundled image sequence, for tests that capture."""
    python = os.environ.get("HANDFIT_PYTHON", sys.executable)
    code = "import cv2, mediapipe, scipy"
    if subprocess.run([python, "-c", code], capture_output=True, check=False).returncode != 0:
        pytest.skip("needs a Python with SciPy, OpenCV and MediaPipe in HANDFIT_PYTHON")
    return RENDERED_HAND


@pytest.fixture
def photo(rendered_hand, tmp_path) -> Path:
    """One picture with a right hand, in a folder of its own."""
    return Path(shutil.copy(rendered_hand / "hand.0001.jpg", tmp_path / "hand.jpg"))


@pytest.fixture(scope="session")
def make_clip(rendered_hand, tmp_path_factory):
    """make_clip(frames, blank_from=None) -> a video of the bundled hand, to and fro; its frames from
    `blank_from` on show nothing."""
    python = os.environ.get("HANDFIT_PYTHON", sys.executable)
    made: dict[tuple, Path] = {}

    def make(frames: int, blank_from: int | None = None) -> Path:
        key = (frames, blank_from)
        if key not in made:
            made[key] = tmp_path_factory.mktemp("clip") / f"clip-{frames}.mp4"
            write_clip(python, made[key], frames, blank_from)
        return made[key]

    return make


@pytest.fixture(scope="session")
def make_long_take(tmp_path_factory):
    """make_long_take(frames) -> a take file of two hands: again and again the same hundred frames."""
    made: dict[int, Path] = {}

    def make(frames: int) -> Path:
        if frames not in made:
            made[frames] = write_long_take(tmp_path_factory.mktemp("long") / "long.take.npz", frames)
        return made[frames]

    return make
