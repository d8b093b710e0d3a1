"""Buttons that take one another's place, so that what stops something stands where it was started.

The second click of a double click must not press the button that has just come under the mouse: it is grey
until it was seen for longer than a double click takes, by the artist's own setting.
"""

from __future__ import annotations

import math
import time
from typing import Final

import bpy

from ..common import screen

_EXTRA_SECONDS: Final = 0.15
"""seconds beyond those of a double click"""

_drawn: dict[str, tuple[str, float]] = {}
"""Place -> the button that was drawn in it last, and since when"""


def is_pressable(place: str, button: str) -> bool:
    """Whether a button that a panel draws can be pressed: where it has replaced another one, only after a
    moment, when the panel is drawn again."""
    now = time.monotonic()
    before, since = _drawn.get(place, (button, -math.inf))
    if before != button:
        since = now
        if not bpy.app.background:
            bpy.app.timers.register(screen.redraw_sidebars, first_interval=1.1 * _delay())
    _drawn[place] = button, since
    return now - since >= _delay()


def _delay() -> float:
    return bpy.context.preferences.inputs.mouse_double_click_time / 1000.0 + _EXTRA_SECONDS


def unregister() -> None:
    """Forget what was drawn."""
    _drawn.clear()
