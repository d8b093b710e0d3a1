#!/usr/bin/env python3
"""Measure how long the add-on keeps Blender's window, in the window of a real Blender under Xvfb.

    sudo HANDFIT_BLENDER_CHROOT=DIR HANDFIT_PYTHON=PYTHON python scripts/window_benchmark.py [RUNS]

DIR is from make_blender_chroot.sh; PYTHON has the core's requirements. Each thing is measured RUNS times (5),
all of them in turns, beside a redraw of the same window: without a graphics card that is the slowest of
all, and it tells how fast the machine is and how busy. Milliseconds.
"""

from __future__ import annotations

import os
import statistics
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from tests.window.blender_window import BlenderWindow
from tests.window.inputs import RENDERED_HAND, write_clip, write_long_take

SIZE = (640, 480)
CLIP = 60
"""frames"""
LONG_CLIP = 1500
LONG = 10_000
"""frames of a take"""
REDRAW = "a redraw of the window"


def main() -> int:
    """Print the table; returns the exit code."""
    chroot = os.environ.get("HANDFIT_BLENDER_CHROOT")
    if not chroot:
        print("window_benchmark.py: HANDFIT_BLENDER_CHROOT must name a Blender chroot", file=sys.stderr)
        return 2
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        window = BlenderWindow(chroot, folder / "run", folder / "shots", SIZE, reachable=folder)
        try:
            measured = measure(window, folder, runs)
        finally:
            window.stop()
    width = max(map(len, measured))
    print(f"{'':{width}}  median       range  redraws")
    redraw = statistics.median(measured[REDRAW])
    for what, times in measured.items():
        median = statistics.median(times)
        print(f"{what:{width}}  {median:6.0f}  {min(times):4.0f}-{max(times):<5.0f}  {median / redraw:7.1f}")
    return 0


def measure(window: BlenderWindow, folder: Path, runs: int) -> dict[str, list[float]]:
    """What was measured -> its milliseconds."""
    clip, long_clip = folder / "clip.mp4", folder / "long-clip.mp4"
    for path, frames in ((clip, CLIP), (long_clip, LONG_CLIP)):
        write_clip(os.environ.get("HANDFIT_PYTHON", sys.executable), path, frames)
    take = write_long_take(folder / "long.take.npz", LONG)

    def in_slices() -> dict[str, float]:
        source = RENDERED_HAND / "hand.0001.jpg"
        measured = window.play("long_take.built_in_slices", 180.0, take=take, source=source).value["measured"]
        whole = sum(total for _, _, total in measured["calls"].values())
        return {
            f"{LONG} frames, two hands: longest call": measured["longest_call_ms"],
            f"{LONG} frames, two hands: all calls": whole,
        }

    def at_once() -> dict[str, float]:
        blocked = window.play("long_take.imported", take=take).blocked
        return {f"{LONG} frames, two hands: imported at once": blocked["longest_call_ms"]}

    def capture() -> dict[str, float]:
        blocked = window.play("capture.clip", source=clip, shot="small").blocked
        return {f"capture of {CLIP} frames: longest call": blocked["longest_call_ms"]}

    def escape() -> dict[str, float]:
        played = window.play("capture.cancelled", source=long_clip).value
        return {"Esc to the last frame looked at": 1000 * played["last_frame_s"]}

    def drag() -> dict[str, float]:
        played = window.play("refine.live_latency", 180.0, source=clip).value
        return {"mouse to hand in Edit Keypoints": statistics.median(played["latencies_ms"])}

    def redraw() -> dict[str, float]:
        return {REDRAW: statistics.median(window.play("redraws.timed").value)}

    things: list[Callable[[], dict[str, float]]] = [redraw, capture, escape, drag, in_slices, at_once]
    found: dict[str, list[float]] = {}
    for _ in range(runs):
        for thing in things:
            for what, milliseconds in thing().items():
                found.setdefault(what, []).append(milliseconds)
    return found


if __name__ == "__main__":
    sys.exit(main())
