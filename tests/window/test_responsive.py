"""The window never freezes, and the hand follows the mouse.

Machines are shared and noisy: each is measured up to three times, and the quietest run counts.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable

CLIP = 60
"""frames"""
LONGEST_CALL_MS = 50.0
LONGEST_LONG_CALL_MS = 150.0
"""For ten thousand frames: Blender copies the whole action, and writes an undo step of 1.4 million keys, in
one go each"""
LONGEST_BUILD_MS = 2000.0
LATENCY_MS = 50.0
RUNS = 3


def quietest(measure: Callable[[], float], limit: float) -> float:
    """The least of up to RUNS measurements; no more than are needed to stay below the limit."""
    least = float("inf")
    for _ in range(RUNS):
        least = min(least, measure())
        if least < limit:
            break
    return least


def test_main_thread_is_free_during_a_capture(small_blender, make_clip):
    def longest() -> float:
        blocked = small_blender.play("capture.clip", source=make_clip(CLIP), shot="small").blocked
        print(_shown(blocked))
        return blocked["longest_call_ms"]

    assert quietest(longest, LONGEST_CALL_MS) < LONGEST_CALL_MS


def test_ten_thousand_frames_are_built_in_slices(small_blender, long_take, photo):
    def share_of_limits() -> float:
        arguments = {"take": long_take, "source": photo}
        played = small_blender.play("long_take.built_in_slices", timeout=180, **arguments).value
        measured = played["measured"]
        print(_shown(measured), played["seconds"], played["idle"])
        assert len(played["keys"]) == 3
        assert played["fractions"] > 20
        whole = sum(total for _, _, total in measured["calls"].values())
        return max(whole / LONGEST_BUILD_MS, measured["longest_call_ms"] / LONGEST_LONG_CALL_MS)

    assert quietest(share_of_limits, 1.0) < 1.0


def test_ten_thousand_frames_are_imported_in_two_seconds(small_blender, long_take):
    def longest() -> float:
        return small_blender.play("long_take.imported", take=long_take).blocked["longest_call_ms"]

    assert quietest(longest, LONGEST_BUILD_MS) < LONGEST_BUILD_MS


def test_the_hand_follows_the_mouse(small_blender, make_clip):
    def median() -> float:
        played = small_blender.play("refine.live_latency", source=make_clip(CLIP), timeout=180).value
        latency, redraw = statistics.median(played["latencies_ms"]), statistics.median(played["redraw_ms"])
        print(f"mouse to hand {latency:.0f} ms (median); a redraw without a graphics card {redraw:.0f} ms")
        assert len(played["latencies_ms"]) > 30
        return latency

    assert quietest(median, LATENCY_MS) < LATENCY_MS


def _shown(blocked: dict) -> str:
    longest = sorted(blocked["calls"].items(), key=lambda item: -item[1][1])[:5]
    return (
        f"longest gap {blocked['longest_gap_ms']:.0f} ms; longest calls (number, longest, sum) {longest}; "
        f"slow parts {blocked['slow_parts']}"
    )
