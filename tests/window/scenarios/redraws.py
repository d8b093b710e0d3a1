"""How long the window takes to draw itself, which is what everything else is held against."""

from __future__ import annotations

import time


def timed(stage, count=10):
    """Milliseconds of a few turns of the main loop in which the view is drawn."""
    times = []
    for _ in range(count):
        stage.area().tag_redraw()
        began = time.perf_counter()
        yield 0.0
        yield 0.0
        times.append(1000 * (time.perf_counter() - began))
    return times
