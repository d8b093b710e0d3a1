"""The window never freezes, and the hand follows the mouse.

Machines are shared and noisy, so that nothing is held against a clock: two things of one run are compared,
and the quietest of up to three runs counts.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable

CLIP = 60
"""frames"""
LONGEST_CALL = 2.4
"""redraws of the small window without a graphics card"""
LONGEST_PART = 0.12
"""of building ten thousand frames: Blender copies the whole action, and writes an undo step of 1.4 million
keys, in one go each"""
SLICED = 2.0
"""what building in slices takes, over building at once"""
TEN_TIMES_THE_FRAMES = 15.0
"""what ten times as many frames take; a hundred where some step looks at all frames for each frame"""
LATENCY = 2.4
"""redraws"""
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
    def redraws() -> float:
        blocked = small_blender.play("capture.clip", source=make_clip(CLIP), shot="small").blocked
        redraw = statistics.median(small_blender.play("redraws.timed").value)
        print(_shown(blocked), f"redraw {redraw:.0f} ms")
        return blocked["longest_call_ms"] / redraw

    assert quietest(redraws, LONGEST_CALL) < LONGEST_CALL


def test_ten_thousand_frames_are_built_in_slices(small_blender, make_long_take, photo):
    def share_of_limits() -> float:
        take = make_long_take(10_000)
        played = small_blender.play("long_take.built_in_slices", timeout=180, take=take, source=photo).value
        at_once = small_blender.play("long_take.imported", take=take).blocked["longest_call_ms"]
        measured = played["measured"]
        print(_shown(measured), played["seconds"], played["idle"], f"at once {at_once:.0f} ms")
        assert len(played["keys"]) == 3
        assert played["fractions"] > 20
        whole = sum(total for _, _, total in measured["calls"].values())
        return max(measured["longest_call_ms"] / whole / LONGEST_PART, whole / at_once / SLICED)

    assert quietest(share_of_limits, 1.0) < 1.0


def test_a_long_take_is_imported_as_quickly_as_its_parts(small_blender, make_long_take):
    def growth() -> float:
        short, long = (
            small_blender.play("long_take.imported", take=make_long_take(frames)).blocked["longest_call_ms"]
            for frames in (1000, 10_000)
        )
        print(f"1000 frames in {short:.0f} ms, 10 000 in {long:.0f} ms")
        return long / short

    assert quietest(growth, TEN_TIMES_THE_FRAMES) < TEN_TIMES_THE_FRAMES


def test_the_hand_follows_the_mouse(small_blender, make_clip):
    def redraws() -> float:
        played = small_blender.play("refine.live_latency", source=make_clip(CLIP), timeout=180).value
        latency, redraw = statistics.median(played["latencies_ms"]), statistics.median(played["redraw_ms"])
        print(f"mouse to hand {latency:.0f} ms (median), a redraw {redraw:.0f} ms")
        assert len(played["latencies_ms"]) > 30
        return latency / redraw

    assert quietest(redraws, LATENCY) < LATENCY


def _shown(blocked: dict) -> str:
    longest = sorted(blocked["calls"].items(), key=lambda item: -item[1][1])[:5]
    return (
        f"longest gap {blocked['longest_gap_ms']:.0f} ms; longest calls (number, longest, sum) {longest}; "
        f"slow parts {blocked['slow_parts']}"
    )
