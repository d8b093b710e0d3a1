"""Runs inside the real Blender: waits for requests of blender_window.py and plays scenarios.

A request is FOLDER/request-N.json, {"scenario": "module.function", "arguments": {...}}; the answer is
FOLDER/result-N.json, {"error"}, which is empty where all went well. A scenario is a generator function
scenarios/MODULE.py: FUNCTION(stage, **arguments), driven by a timer of Blender's main loop, so that the
window lives on while it waits. It yields seconds to wait (0: one turn of the main loop), and asserts what
must have happened.
"""

from __future__ import annotations

import ctypes
import importlib
import json
import os
import signal
import sys
from pathlib import Path
from traceback import TracebackException

import bpy

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[2]
INSTALLED = "MANIENT_ADDON" in os.environ
"""Whether the add-on is that of the user's profile, which must not find the repository's modules"""
sys.path[:0] = [*([] if INSTALLED else [str(ROOT)]), str(HERE), str(HERE.parent)]

from meter import Meter  # noqa: E402
from stage import Stage  # noqa: E402

POLL = 0.02
"""seconds between looks for a request"""


class Driver:
    """Plays one scenario after the other."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.number = 1
        self.scenario = None
        profile = Path(bpy.utils.user_resource("EXTENSIONS")) / "user_default" / "manient"
        self.meter = Meter(profile if INSTALLED else ROOT / "blender_manient")
        self.stage = Stage(folder / "screenshots", self.meter)

    def tick(self) -> float:
        """The timer's function: seconds until it wants to be called again."""
        try:
            if self.scenario is None:
                return self._look_for_request()
            return next(self.scenario) or 0.0
        except StopIteration:
            self._answer("")
        except BaseException as error:
            shown = TracebackException.from_exception(error, limit=-4, capture_locals=True)
            for frame in shown.stack:
                frame.locals = {name: value[:200] for name, value in frame.locals.items()}
            self._answer("".join(shown.format()))
        return 0.0

    def _look_for_request(self) -> float:
        path = self.folder / f"request-{self.number}.json"
        if not path.exists():
            return POLL
        request = json.loads(path.read_text(encoding="utf-8"))
        if request["scenario"] == "quit":
            # Not from within a timer's call: quitting frees the timers.
            self.number += 1
            self.scenario = self._quit()
            return 0.0
        module, _, name = request["scenario"].rpartition(".")
        function = getattr(importlib.import_module(f"scenarios.{module}"), name)
        self.scenario = self._played(function, request["arguments"])
        return 0.0

    def _played(self, function, arguments):
        yield from self.stage.reset()
        self.stage.draw_smoothly(on=function.__module__ == "scenarios.pictures")
        self.meter.start()
        yield from function(self.stage, **arguments)
        yield from self.stage.screenshot(f"{function.__module__}-{function.__name__}")

    def _quit(self):
        bpy.context.preferences.view.use_save_prompt = False
        with self.stage.override():
            bpy.ops.wm.quit_blender("EXEC_DEFAULT")
        yield 60.0

    def _answer(self, error: str) -> None:
        self.scenario = None
        self.meter.stop()
        if error:
            self.stage.screenshot_now(f"failed-{self.number}")
        path = self.folder / f"result-{self.number}.json"
        temporary = path.with_suffix(".part")
        temporary.write_text(json.dumps({"error": error}), encoding="utf-8")
        temporary.replace(path)
        self.number += 1


def report_every_crash() -> None:
    """Have Blender write its backtrace for every signal of a crash; by itself it does for SIGSEGV alone."""
    libc = ctypes.CDLL(None)
    libc.signal.restype = ctypes.c_void_p
    libc.signal.argtypes = (ctypes.c_int, ctypes.c_void_p)
    writes_backtrace = libc.signal(signal.SIGSEGV, None)
    for number in (signal.SIGSEGV, signal.SIGFPE, signal.SIGABRT, signal.SIGBUS, signal.SIGILL):
        libc.signal(number, writes_backtrace)


def main() -> None:
    """Begin to look for requests once the window is up."""
    bpy.context.preferences.view.show_splash = False
    report_every_crash()
    driver = Driver(Path(sys.argv[sys.argv.index("--") + 1]))
    bpy.app.timers.register(driver.tick, first_interval=0.1, persistent=True)


main()
