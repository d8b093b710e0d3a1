"""Armatures that follow a change after a short rest, in slices of a timer, while the window stays free."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import bpy

from handfit_core.common.errors import HandfitError
from handfit_core.common.slices import slice_clock

from ..common.block_reference import BlockReference

_TICK = 1 / 60
"""Seconds between two looks while something is to be done"""


class Follower:
    """An armature that follows changes."""

    def __init__(self, armature: bpy.types.Object) -> None:
        self.armature = BlockReference.of("objects", armature)
        self.changed: float | None = time.monotonic()
        """The moment of `time.monotonic` at which a change was last seen that is not followed yet; None where
        all are followed"""
        self.steps: Iterator[float] | None = None

    def has_rested(self, seconds: float) -> bool:
        """True if the last change that is not followed yet was at least so many seconds ago."""
        return self.changed is not None and time.monotonic() - self.changed >= seconds


class Followers(dict[int, Any]):
    """The armatures that follow one kind of change, by their session_uid; one timer goes on with all."""

    def __init__(
        self,
        go_on: Callable[[Any, bpy.types.Object, Callable[[], bool]], None],
        fail: Callable[[bpy.types.Object, HandfitError | ReferenceError], None],
        is_following: Callable[[bpy.types.Object], bool] = lambda _armature: True,
    ) -> None:
        """Follow nobody yet. `go_on` does something for an armature until the given clock says that the slice
        is over, and is called again while the follower has a change. `fail` is told of what it raises.
        `is_following`: whether an armature is one of them still."""
        super().__init__()
        self._go_on, self._fail, self._is_following = go_on, fail, is_following
        self.step = self._step
        """The timer's function, always the same object, by which Blender finds it again"""

    def _step(self) -> float | None:
        """Go on for some milliseconds. Returns after how many seconds to look again; None where nothing is to
        be done."""
        if bpy.app.is_job_running("RENDER"):
            return 6 * _TICK
        is_over = slice_clock()
        windows = bpy.context.window_manager.windows
        for uid, follower in list(self.items()):
            armature = follower.armature.find()
            if armature is None or not self._is_following(armature):
                del self[uid]
                continue
            try:
                with bpy.context.temp_override(window=bpy.context.window or windows[0]):  # timers have none
                    self._go_on(follower, armature, is_over)
            except (HandfitError, ReferenceError) as error:
                follower.steps = follower.changed = None
                self._fail(armature, error)
        return _TICK if any(follower.changed is not None for follower in self.values()) else None

    def wake(self) -> None:
        """Start the timer where something is to be done."""
        if not bpy.app.timers.is_registered(self.step):
            bpy.app.timers.register(self.step, first_interval=0.0, persistent=True)
