"""How long the add-on keeps Blender's main thread.

A redraw of the whole window takes long without a graphics card, whatever the add-on does; so two things
are measured. *Calls*: every time Blender's main thread enters code of the add-on (modal, draw, timers,
handlers, callbacks: all of them), until it leaves it again. *Gaps*: the time between turns of the main
loop, which counts redraws, undo steps and dependency updates as well. Time in which the thread could not run
because other processes had the processors does not count: it says how busy the machine is.
"""

from __future__ import annotations

import sys
import threading
import time
import types
from pathlib import Path

import bpy

TOOL = sys.monitoring.PROFILER_ID
EVENTS = sys.monitoring.events
STARTS = (EVENTS.PY_START, EVENTS.PY_RESUME, EVENTS.PY_THROW)
ENDS = (EVENTS.PY_RETURN, EVENTS.PY_YIELD, EVENTS.PY_UNWIND)
NOT_SWITCHED_OFF = (EVENTS.PY_THROW, EVENTS.PY_UNWIND)
SLOW = 30.0
"""milliseconds"""
BEAT = 0.002
"""seconds between turns of the main loop that are asked for"""


class Meter:
    """Between start() and stop(), times what keeps the main thread. Milliseconds."""

    def __init__(self, package: Path):
        self._package = str(package)
        self._main = threading.main_thread().ident
        self._schedule = Path(f"/proc/self/task/{threading.main_thread().native_id}/schedstat")
        self._running = False

    def start(self) -> None:
        """Begin to measure."""
        self.reset()
        self._running = True
        sys.monitoring.use_tool_id(TOOL, "main thread meter")
        for event in STARTS:
            sys.monitoring.register_callback(TOOL, event, self._entered(event))
        for event in ENDS:
            sys.monitoring.register_callback(TOOL, event, self._left(event))
        sys.monitoring.set_events(TOOL, sum(STARTS) + sum(ENDS))
        bpy.app.timers.register(self._beat, persistent=True)

    def reset(self) -> None:
        """Forget what was measured."""
        self._stack: list[tuple[types.CodeType, float]] = []
        self._began = 0.0
        self.slow: list[tuple[int, str]] = []
        self.calls: dict[str, list[float]] = {}
        self.gaps: list[float] = []
        self._last_beat: float | None = None

    def stop(self) -> dict:
        """End; what was measured, see `report`."""
        report = self.report()
        if self._running:
            self._running = False
            sys.monitoring.set_events(TOOL, 0)
            sys.monitoring.free_tool_id(TOOL)
            if bpy.app.timers.is_registered(self._beat):
                bpy.app.timers.unregister(self._beat)
        return report

    def report(self) -> dict:
        """{"longest_call", "longest_call_ms", "longest_gap_ms", "calls": {name: [count, longest, total]},
        "slow_parts": [(ms, name)] of functions that took long within calls}."""
        longest = {name: max(times) for name, times in self.calls.items()}
        name = max(longest, key=lambda n: longest[n], default="")
        return {
            "longest_call": name,
            "longest_call_ms": longest.get(name, 0.0),
            "longest_gap_ms": max(self.gaps, default=0.0),
            "calls": {n: [len(t), max(t), sum(t)] for n, t in self.calls.items()},
            "slow_parts": sorted(self.slow, reverse=True)[:10],
        }

    def _clock(self) -> float:
        """Milliseconds in which the main thread ran or waited for something of its own."""
        queued = int(self._schedule.read_bytes().split()[1])
        return 1e3 * time.perf_counter() - 1e-6 * queued

    def _beat(self) -> float:
        now = self._clock()
        if self._last_beat is not None:
            self.gaps.append(now - self._last_beat)
        self._last_beat = now
        return BEAT

    def _entered(self, event):
        def entered(code, *_):
            if not code.co_filename.startswith(self._package):
                return None if event in NOT_SWITCHED_OFF else sys.monitoring.DISABLE
            if threading.get_ident() == self._main:
                self._stack.append((code, time.perf_counter()))
                if len(self._stack) == 1:
                    self._began = self._clock()
            return None

        return entered

    def _left(self, event):
        def left(code, *_):
            if not code.co_filename.startswith(self._package):
                return None if event in NOT_SWITCHED_OFF else sys.monitoring.DISABLE
            if threading.get_ident() == self._main and self._stack:
                entered, began = self._stack.pop()
                name = f"{Path(entered.co_filename).stem}.{entered.co_qualname}"
                if not self._stack:
                    self.calls.setdefault(name, []).append(self._clock() - self._began)
                elif (took := 1000.0 * (time.perf_counter() - began)) > SLOW:
                    self.slow.append((round(took), name))
            return None

        return left
