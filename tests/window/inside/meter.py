"""How long the add-on keeps Blender's main thread.

A redraw of the whole window takes long without a graphics card, whatever the add-on does; so what is timed
are *calls*: every time Blender's main thread enters code of the add-on (modal, draw, timers, handlers,
callbacks: all of them), until it leaves it again. Time in which the thread could not run because other
processes had the processors does not count: it says how busy the machine is.
"""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path

TOOL = sys.monitoring.PROFILER_ID
EVENTS = sys.monitoring.events
STEPS = dict.fromkeys((EVENTS.PY_START, EVENTS.PY_RESUME, EVENTS.PY_THROW), 1)
STEPS |= dict.fromkeys((EVENTS.PY_RETURN, EVENTS.PY_YIELD, EVENTS.PY_UNWIND), -1)
"""By how much each event changes the number of functions that run"""
NOT_SWITCHED_OFF = (EVENTS.PY_THROW, EVENTS.PY_UNWIND)


class Meter:
    """Between start() and stop(), times what keeps the main thread. `calls`: name -> milliseconds of each."""

    def __init__(self, package: Path):
        self._package = str(package)
        self._main = threading.main_thread().ident
        self._schedule = Path(f"/proc/self/task/{threading.main_thread().native_id}/schedstat")
        self.reset()

    def start(self) -> None:
        """Begin to measure."""
        self.reset()
        sys.monitoring.use_tool_id(TOOL, "main thread meter")
        for event, step in STEPS.items():
            sys.monitoring.register_callback(TOOL, event, self._noted(event, step))
        sys.monitoring.set_events(TOOL, sum(STEPS))

    def reset(self) -> None:
        """Forget what was measured."""
        self._depth, self._began, self._name = 0, 0.0, ""
        self.calls: dict[str, list[float]] = {}

    def stop(self) -> None:
        """End."""
        if sys.monitoring.get_tool(TOOL):
            sys.monitoring.set_events(TOOL, 0)
            sys.monitoring.free_tool_id(TOOL)

    @property
    def longest(self) -> float:
        """Milliseconds of the longest call."""
        return max((max(times) for times in self.calls.values()), default=0.0)

    def _clock(self) -> float:
        """Milliseconds in which the main thread ran or waited for something of its own."""
        queued = int(self._schedule.read_bytes().split()[1])
        return 1e3 * time.perf_counter() - 1e-6 * queued

    def _noted(self, event: int, step: int):
        def noted(code, *_):
            if not code.co_filename.startswith(self._package):
                return None if event in NOT_SWITCHED_OFF else sys.monitoring.DISABLE
            if threading.get_ident() == self._main and (step > 0 or self._depth):
                if step > 0 and not self._depth:
                    self._began = self._clock()
                    self._name = f"{Path(code.co_filename).stem}.{code.co_qualname}"
                self._depth += step
                if not self._depth:
                    self.calls.setdefault(self._name, []).append(self._clock() - self._began)
            return None

        return noted
