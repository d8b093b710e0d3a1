"""The real Blender on a screen of its own, seen from pytest: starts it, asks it to play scenarios."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(__file__).resolve().parent
IN_CHROOT = str(ROOT / "scripts" / "chroot_blender.sh")
START_TIMEOUT = 120.0
"""seconds until Blender must answer: compiling shaders without a graphics card takes its time"""
QUIT_TIMEOUT = 30.0
INSTALLED = "bl_ext.user_default.manient"
"""The add-on's name where the zip has brought it"""
SIGNS_OF_DEFECTS = ("Traceback (most recent call last)", "unknown operator", "rna_ui")
"""What Blender prints where the add-on is wrong"""
ADDON_FRAME = re.compile(r'File ".*/(blender_manient|handfit_core|user_default/manient)/')
"""A line of a crash's Python backtrace that is the add-on's, the repository's or the installed one"""


class WindowFailure(AssertionError):
    """A scenario failed, or Blender died."""


class BlenderCrash(WindowFailure):
    """A signal ended Blender."""


class BlenderWindow:
    """One Blender with its window; restarted when it has died.

    Its add-on is the repository's; with a `profile`, the one that is installed in that user's folder, and
    captures with what was installed. Its logs and answers are kept in `folder`, which lies in `reachable`;
    what scenarios are given to read must lie there as well, or in the repository, the samples or
    $CHROOT_BIND.
    """

    def __init__(
        self,
        chroot: str,
        folder: Path,
        screenshots: Path,
        size: tuple[int, int] = (1600, 1000),
        reachable: Path | None = None,
        profile: Path | None = None,
    ):
        self._chroot = chroot
        self._base = folder
        self._reachable = reachable or folder
        self._profile = profile
        self._kept = screenshots
        self._size = size
        self._process: subprocess.Popen[bytes] | None = None
        self._starts = 0
        self._number = 0
        self._folder = folder
        self.crash: BlenderCrash | None = None
        """After which a scenario was played again; conftest.py shows it at the end of the run"""

    def play(self, scenario: str, timeout: float = 400.0, **arguments: Any) -> None:
        """Play scenarios.MODULE.FUNCTION; WindowFailure with its traceback where it fails.

        Where a signal ends Blender while no Python of the add-on's runs, the scenario gets a second
        Blender, once in a run: in two of many runs Debian's 4.3.2 died in code of its own, of a pointer or
        a glyph cache that nobody could find the add-on to have touched.
        """
        try:
            self._play(scenario, timeout, arguments)
        except BlenderCrash as crash:
            if ADDON_FRAME.search(str(crash)) or self.crash:
                raise
            self.crash = crash
            self._play(scenario, timeout, arguments)

    def _play(self, scenario: str, timeout: float, arguments: dict[str, Any]) -> None:
        if self._process is None or self._process.poll() is not None:
            self._start()
        printed = len(self._printed())
        if error := self._ask(scenario, timeout, arguments):
            raise WindowFailure(f"{error}\n{self.log()}")
        news = self._printed()[printed:]
        if any(sign in news for sign in SIGNS_OF_DEFECTS):
            # What goes wrong in a panel's draw() or a timer is printed with every redraw, and nothing more.
            once = "\n".join(dict.fromkeys(news.splitlines()))
            raise WindowFailure(f"{scenario} made Blender print\n{once}")

    def quit(self) -> list[str]:
        """Quit Blender as an artist does; the command lines of processes that it left behind."""
        assert self._process is not None
        self._write_request("quit", {})
        self._process.wait(QUIT_TIMEOUT)
        self._process = None
        return (self._folder / "left_behind").read_text(encoding="utf-8").splitlines()

    def stop(self) -> None:
        """End everything that was started."""
        if self._process is not None and self._process.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
        self._process = None

    def log(self) -> str:
        """The last lines that Blender printed."""
        return "\n".join(["Blender's last lines:", *self._printed().splitlines()[-30:]])

    def _printed(self) -> str:
        path = self._folder / "log"
        return path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""

    def _start(self) -> None:
        self._starts += 1
        self._number = 0
        self._folder = self._base / f"blender-{self._starts}"
        self._folder.mkdir(parents=True)
        start = [str(HERE / "start_blender.sh"), str(self._folder), *map(str, self._size)]
        with (self._folder / "log").open("wb") as log:
            self._process = subprocess.Popen(
                [IN_CHROOT, self._chroot, *start],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=self._environment(),
                start_new_session=True,
            )

    def _environment(self) -> dict[str, str]:
        # Compiled shaders are kept: without a graphics card they take minutes.
        shaders = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "handfit-window-shaders"
        shaders.mkdir(parents=True, exist_ok=True)
        bind = ":".join(filter(None, [str(self._reachable), str(shaders), os.environ.get("CHROOT_BIND")]))
        found = {**os.environ, "CHROOT_BIND": bind, "MESA_SHADER_CACHE_DIR": str(shaders)}
        if self._profile is None:
            return {"HANDFIT_PYTHON": sys.executable, **found}
        found.pop("HANDFIT_PYTHON", None)
        return {**found, "BLENDER_USER_RESOURCES": str(self._profile), "MANIENT_ADDON": INSTALLED}

    def _ask(self, scenario: str, timeout: float, arguments: dict[str, Any]) -> str:
        """What went wrong, or nothing."""
        assert self._process is not None
        self._write_request(scenario, arguments)
        path = self._folder / f"result-{self._number}.json"
        end = time.monotonic() + timeout + (START_TIMEOUT if self._number == 1 else 0.0)
        while not path.exists():
            if self._process.poll() is not None:
                raise self._death(scenario, self._process.returncode)
            if time.monotonic() > end:
                self.stop()
                raise WindowFailure(f"{scenario} was not through after {timeout:g} s\n{self.log()}")
            time.sleep(0.02)
        self._kept.mkdir(parents=True, exist_ok=True)
        for picture in (self._folder / "screenshots").glob("*.png"):
            shutil.copy(picture, self._kept / picture.name)
        return json.loads(path.read_text(encoding="utf-8"))["error"]

    def _death(self, scenario: str, code: int) -> WindowFailure:
        """With Blender's own backtrace where it has written one."""
        report = self._folder / "crash"
        crash = report.read_text(encoding="utf-8", errors="replace") if report.exists() else ""
        kind = BlenderCrash if code < 0 or code > 128 else WindowFailure
        return kind(f"Blender ended with {code} in {scenario}\n{self.log()}\n{crash}")

    def _write_request(self, scenario: str, arguments: dict[str, Any]) -> None:
        self._number += 1
        path = self._folder / f"request-{self._number}.json"
        temporary = path.with_suffix(".part")
        request = {"scenario": scenario, "arguments": arguments}
        temporary.write_text(json.dumps(request, default=str), encoding="utf-8")
        temporary.replace(path)


def installed_profile(chroot: str, zipped: Path, folder: Path) -> Path:
    """A new user's folder below `folder`, into which Blender's own command line has installed the zip."""
    profile = folder / "profile"
    profile.mkdir()
    install = ["extension", "install-file", "-r", "user_default", "--enable", str(zipped)]
    bind = {"BLENDER_USER_RESOURCES": str(profile), "CHROOT_BIND": f"{profile}:{zipped.parent}"}
    subprocess.run(
        [IN_CHROOT, chroot, "blender", "--command", *install],
        check=True,
        timeout=START_TIMEOUT,
        env={**os.environ, **bind},
    )
    return profile
