"""The zip in a real Blender: its command line installs and removes it, its window captures with it.

What `--command manient` does in there is in test_command.py.
"""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

import pytest

from tests.installed.sealed import ROOT, Sealed, without_network
from tests.window.blender_window import BlenderWindow, shader_cache

CHROOT = os.environ.get("HANDFIT_BLENDER_CHROOT")
ADDON = "bl_ext.user_default.manient"
HARNESS = ("inside", "scenarios", "start_blender.sh")
OPEN_HAND_VERTICES = 1810
BLENDERS_OWN = (
    "cache/blender/gl-shader-cache/*",
    "cache/thumbnails/*",
    "profile/config/platform_support.txt",
    "profile/config/userpref.blend",
    "profile/extensions/.cache/compat.dat",
    "profile/extensions/.local/lib/python3.13/site-packages/",
    "profile/extensions/.user/user_default/",
    "profile/extensions/user_default/.blender_ext/cache/",
    "tmp/pulse-*/",
    "tmp/quit.blend",
)
"""What Blender and its window leave, whatever was installed: caches, preferences, empty folders"""

pytestmark = pytest.mark.skipif(
    not CHROOT, reason="HANDFIT_BLENDER_CHROOT does not name a chroot with Blender in it"
)


@dataclass(frozen=True)
class Life:
    """What was found from installing to removing; of commands their exit code and output."""

    base: Path
    validated: tuple[int, str]
    installed: tuple[int, str]
    unpacked: list[str]
    played: dict
    left_behind: list[str]
    log: str
    removed: tuple[int, str]
    asked_again: tuple[int, str]
    left: list[str]
    processes: list[str]


class InstalledWindow(BlenderWindow):
    """The window of a Blender with a profile of its own, without network and without the repository."""

    def __init__(self, sealed: Sealed, wrapper: list[str], screenshots: Path) -> None:
        super().__init__(CHROOT or "", sealed.base / "window", screenshots)
        self._sealed, self._wrapper = sealed, wrapper
        self._harness = sealed.base / "harness" / "tests" / "window"
        for name in HARNESS:
            source, target = ROOT / "tests" / "window" / name, self._harness / name
            target.parent.mkdir(parents=True, exist_ok=True)
            (shutil.copytree if source.is_dir() else shutil.copy)(source, target)

    def _command(self) -> list[str]:
        more = {"MANIENT_ADDON": ADDON, "MESA_SHADER_CACHE_DIR": str(shader_cache())}
        settings = [f"{name}={value}" for name, value in self._sealed.environment(more).items()]
        start = self._start_script(self._harness)
        return [*without_network(), *self._wrapper, "env", "-i", *settings, *start]

    def _environment(self) -> dict[str, str]:
        return dict(os.environ)


@pytest.fixture(scope="module")
def life(new_sealed, zipped: Path, samples: Path, tmp_path_factory) -> Life:
    sealed = new_sealed()
    bind = f"{sealed.base}:{shader_cache()}"
    entering = ["-u", "HANDFIT_PYTHON", f"CHROOT_BIND={bind}", "CHROOT_SEALED=1"]
    chroot = [str(ROOT / "scripts" / "chroot_blender.sh"), str(Path(CHROOT or "").resolve())]
    wrapper = ["env", *entering, *chroot]
    zip_file = sealed.give(zipped)
    photo = sealed.give(samples / "photos" / "thumb_up.jpg")

    def blender(*arguments: str) -> tuple[int, str]:
        return sealed.call(["blender", *arguments], wrapper)

    validated = blender("--command", "extension", "validate", zip_file)
    installed = blender("--command", "extension", "install-file", "-r", "user_default", "--enable", zip_file)
    unpacked = sealed.left()
    kept = os.environ.get("HANDFIT_KEEP_SCREENSHOTS")
    screenshots = ROOT / "out" / "window" if kept else tmp_path_factory.mktemp("screenshots")
    window = InstalledWindow(sealed, wrapper, screenshots)
    try:
        played = window.play("installed.photo_by_the_button", timeout=240, source=photo).value
        window.play("panels.preferences")
        left_behind, log = window.quit(), window.log()
    finally:
        window.stop()
    removed = blender("--command", "extension", "remove", "manient")
    asked_again = blender("--command", "manient", "check")
    return Life(
        sealed.base,
        validated,
        installed,
        unpacked,
        played,
        left_behind,
        log,
        removed,
        asked_again,
        sealed.left(),
        sealed.processes(),
    )


def test_blender_validates_and_installs_it(life):
    assert life.validated[0] == 0, life.validated[1]
    assert life.installed[0] == 0, life.installed[1]
    assert any("/site-packages/handfit_core/" in name for name in life.unpacked)
    assert any("/site-packages/cv2/" in name for name in life.unpacked)


def test_a_photo_is_captured_by_pressing_the_button(life):
    played = life.played
    assert played["addons"] == [ADDON]
    (hand,) = played["hands"]
    assert (hand["side"], hand["frames"], hand["detected"]) == ("left", 1, 1)
    assert (hand["mesh"], hand["camera"] is not None) == (OPEN_HAND_VERTICES, True)
    assert hand["keys"] > 0
    assert played["workers"] == 1
    assert "Cube" in played["begun_with"]
    assert played["in_the_way"] == []


def test_all_of_it_came_from_the_profile(life):
    files = [name for name in life.played["files"] if name != "None"]
    assert len(files) > 50
    profile = life.base / "profile" / "extensions"
    assert [name for name in files if not Path(name).is_relative_to(profile)] == []


def test_quitting_leaves_no_process(life):
    assert life.left_behind == []
    assert life.processes == []
    assert "Traceback" not in life.log


def test_removing_leaves_no_file(life):
    assert life.removed[0] == 0, life.removed[1]
    foreign = [name for name in life.left if not any(fnmatch(name, own) for own in BLENDERS_OWN)]
    assert foreign == []


def test_its_command_is_gone(life):
    assert life.asked_again[0] != 0
    assert "manient" in life.asked_again[1]
