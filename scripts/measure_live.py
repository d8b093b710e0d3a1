#!/usr/bin/env python3
"""Measure speed and accuracy of the live preview, as one table.

    python scripts/measure_live.py --minutes 5 --truth samples/ground_truth
    python scripts/measure_live.py CLIP --minutes 5

A process of its own serves the clip as MJPEG from 127.0.0.1, 30 pictures of 640 x 480 a second, over and
over, and paints the time into each picture; for two hands it stands there twice, once mirrored. `--truth`
compares the preview with the full capture, both against labelled pictures (index.json) that are played as
frames.
"""

from __future__ import annotations

import argparse
import http.server
import itertools
import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any, Final

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does

import cv2
import numpy as np

from handfit_core.capturing.live.streaming import HandFollower, Live, LiveOptions
from handfit_core.capturing.options import CaptureOptions
from handfit_core.capturing.pipeline import capture
from handfit_core.common.errors import HandfitError, OptionError
from handfit_core.evaluate.metrics import similarity_aligned_distances
from handfit_core.hand_model import load_model
from handfit_core.media.opening import open_media
from handfit_core.media.source import Frame

Row = tuple[str, str, float]
"""Name of a figure, the limit that it should keep, and its value"""

CLIP: Final = str(ROOT / "samples" / "rendered_hand" / "hand.%04d.jpg")
SIZE: Final = (640, 480)
FPS: Final = 30.0
MOST_MINUTES: Final = 15.0
MOST_PICTURES: Final = 900
"""of the clip, kept as pictures; 30 seconds"""
BLOCK: Final = 10
"""pixels a side of one bit of the time"""
BITS: Final = 40
"""of a time in units of 0.1 ms"""


def main(argv: list[str] | None = None) -> int:
    """Measure as the arguments say; returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("clip", nargs="?", default=CLIP, metavar="CLIP", help="of one hand (default: ours)")
    parser.add_argument("--minutes", type=float, default=1.0, metavar="M", help="of each stream (default: 1)")
    parser.add_argument("--truth", type=Path, metavar="FOLDER", help="labelled pictures, with index.json")
    parser.add_argument("--serve", type=int, metavar="HANDS", help=argparse.SUPPRESS)
    args = parser.parse_args(argv)
    try:
        if args.serve:
            serve(pictures(args.clip, args.serve))
            return 0
        if not 0.0 < args.minutes <= MOST_MINUTES:
            raise OptionError(f"--minutes must lie between 0 and {MOST_MINUTES:g}")
        print(f"{'':<40} {'wanted':>10} {'measured':>10}")
        for hands in (1, 2):
            report(stream(args.clip, hands, 60.0 * args.minutes))
        if args.truth:
            report(truth(args.truth))
    except HandfitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def report(rows: list[Row]) -> None:
    """Print a row a line."""
    for what, wanted, value in rows:
        print(f"{what:<40} {wanted:>10} {value:>10.3g}", flush=True)


def pictures(clip: str, hands: int) -> list[np.ndarray]:
    """The clip's pictures (480, 640, 3) uint8 BGR, whole and centred; with two hands, beside their mirror
    images. Raises InputError."""
    found = []
    width = SIZE[0] // hands
    for frame in itertools.islice(open_media(clip).frames(), MOST_PICTURES):
        if frame.rgb is None:
            continue
        scale = min(width / frame.rgb.shape[1], SIZE[1] / frame.rgb.shape[0])
        small = cv2.resize(frame.rgb, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        one = np.full((SIZE[1], width, 3), 96, dtype=np.uint8)
        y, x = (SIZE[1] - small.shape[0]) // 2, (width - small.shape[1]) // 2
        one[y : y + small.shape[0], x : x + small.shape[1]] = small
        whole = one if hands == 1 else np.concatenate([one, one[:, ::-1]], axis=1)
        found.append(cv2.cvtColor(whole, cv2.COLOR_RGB2BGR))
    return found


def stamped(bgr: np.ndarray, seconds: float) -> np.ndarray:
    """A picture with the time painted into its top rows, as bits."""
    bgr = bgr.copy()
    ticks = int(seconds * 1e4) % (1 << BITS)
    bits = np.array([ticks >> bit & 1 for bit in range(BITS)], dtype=np.uint8) * 255
    bgr[:BLOCK, : BLOCK * BITS] = np.kron(bits, np.ones((BLOCK, BLOCK), dtype=np.uint8))[..., None]
    return bgr


def stamp_of(rgb: np.ndarray) -> float:
    """The seconds that were painted into a picture."""
    middles = np.arange(BITS) * BLOCK + BLOCK // 2
    return sum(1 << bit for bit, value in enumerate(rgb[BLOCK // 2, middles, 1]) if value > 127) / 1e4


def serve(shown: list[np.ndarray]) -> None:
    """Serve pictures as a stream to one client after another until stdin closes; prints the port."""

    class Stream(http.server.BaseHTTPRequestHandler):
        def log_message(self, format: str, *args: Any) -> None:
            pass

        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
            self.end_headers()
            began = time.perf_counter()
            there_and_back = itertools.cycle([*shown, *shown[::-1]])
            for number, bgr in enumerate(there_and_back):
                time.sleep(max(0.0, began + number / FPS - time.perf_counter()))
                jpeg = cv2.imencode(".jpg", stamped(bgr, time.perf_counter()))[1].tobytes()
                head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
                try:
                    self.wfile.write(head.encode() + jpeg + b"\r\n")
                except OSError:
                    return

    cv2.setNumThreads(1)
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Stream)
    server.daemon_threads = True
    print(server.server_port, flush=True)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    sys.stdin.read()


def stream(clip: str, hands: int, seconds: float) -> list[Row]:
    """Follow the stream for that long. Raises HandfitError."""
    command = [sys.executable, __file__, clip, "--serve", str(hands)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        assert server.stdin is not None
        try:
            port = int(server.stdout.readline())
            with Live(f"http://127.0.0.1:{port}/") as run:
                return _followed(run, hands, seconds)
        finally:
            server.stdin.close()


def _followed(run: Live, hands: int, seconds: float) -> list[Row]:
    """The figures of a run; its first two seconds, in which hands are found, count for the longest frame
    alone."""
    latencies, both, memory, longest = [], 0, [], 0.0
    next(iter(run))
    begin = time.perf_counter() + 2.0
    received = shown = 0
    while (now := time.perf_counter()) < begin + seconds or not latencies:
        pose = run.next()
        if now < begin:
            received, shown = run.reader.received, run.shown
        if pose is None:
            continue
        longest = max(longest, 1000.0 * (time.perf_counter() - max(now, pose.time)))
        if now < begin:
            continue
        latencies.append(1000.0 * (time.perf_counter() - stamp_of(pose.rgb)))
        both += sum(hand.state == "seen" for hand in pose.hands) >= hands
        memory.append(resident_mb())
    came, tenth = run.reader.received - received, max(1, len(memory) // 10)
    name = "one hand" if hands == 1 else "two hands"
    return [
        (f"{name}: pictures a second", f"{FPS:g}", came / seconds),
        (f"{name}: shown, %", ">= 95" if hands == 1 else ">= 80", 100.0 * (run.shown - shown) / max(came, 1)),
        (f"{name}: all of them seen, %", "", 100.0 * both / max(len(latencies), 1)),
        (f"{name}: latency, median ms", "<= 60", float(np.median(latencies))),
        (f"{name}: latency, 95 % ms", "<= 120", float(np.percentile(latencies, 95.0))),
        (f"{name}: longest frame, ms", "<= 100", longest),
        (f"{name}: memory, growth MB", "<= 50", max(memory) - max(memory[:tenth])),
    ]


def resident_mb() -> float:
    """Resident memory of this process in MB; NaN where the system does not tell, which Linux alone does."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    except OSError:
        return float("nan")


def truth(folder: Path) -> list[Row]:
    """The mean PA-MPJPE in mm of the preview and of the full capture, on the pictures of one hand that both
    have. Raises HandfitError."""
    labels = json.loads((folder / "index.json").read_text("utf-8"))
    files = [str(folder / each["file"]) for each in labels]
    media = open_media(files)
    take = capture(files)
    preview: dict[int, np.ndarray] = {}
    with HandFollower(LiveOptions(CaptureOptions())) as follower:
        for row, frame in enumerate(media.frames()):
            pose = follower.follow(Frame(row + 1, row / FPS, frame.rgb))
            for hand in pose.hands:
                if hand.side == labels[row]["hand"] and hand.state == "seen":
                    vectors = (each[None] for each in (hand.global_orient, hand.hand_pose, hand.transl))
                    preview[row] = load_model(None, hand.side).keypoints(hand.betas, *vectors)[0]
    full = {
        row: track.joints_3d[row]
        for row, label in enumerate(labels)
        for track in take.hands
        if track.side == label["hand"] and track.present[row]
    }
    common = sorted(preview.keys() & full.keys())
    true = [np.array(label["joints_3d_mm"]) for label in labels]
    errors = [
        np.mean([similarity_aligned_distances(1000.0 * found[row], true[row]).mean() for row in common])
        for found in (preview, full)
    ]
    return [
        ("labelled frames with a hand in both", f"{len(labels)}", float(len(common))),
        ("preview, PA-MPJPE mm", "", float(errors[0])),
        ("full capture, PA-MPJPE mm", "", float(errors[1])),
        ("ratio", "<= 1.25", float(errors[0] / errors[1])),
    ]


if __name__ == "__main__":
    sys.exit(main())
