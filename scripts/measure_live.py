#!/usr/bin/env python3
"""How fast and how well hands are followed live: measured on a stream of MJPEG from 127.0.0.1.

    python scripts/measure_live.py CLIP --minutes 5
    python scripts/measure_live.py CLIP --minutes 5 --hands 2
    python scripts/measure_live.py --truth samples/ground_truth

A process of its own serves the clip, 30 pictures of 640 x 480 a second, over and over, and paints the time
into each picture; with `--hands 2` the clip stands there twice, once mirrored. `--truth` compares the preview
with the full capture, both against labelled pictures (index.json) that are played as frames.
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

from handfit_core.errors import HandfitError, OptionError
from handfit_core.geometry.similarity import align
from handfit_core.hand_model import load_model
from handfit_core.media.opening import open_media
from handfit_core.media.source import Frame
from handfit_core.options import CaptureOptions
from handfit_core.pipeline import capture
from handfit_core.streaming import HandFollower, Live, LiveOptions

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
    parser.add_argument("clip", nargs="?", metavar="CLIP", help="a video of one hand")
    parser.add_argument("--minutes", type=float, default=1.0, metavar="M", help="default: 1")
    parser.add_argument("--hands", type=int, choices=(1, 2), default=1)
    parser.add_argument("--truth", type=Path, metavar="FOLDER", help="labelled pictures, with index.json")
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args(argv)
    try:
        if args.serve:
            serve(pictures(args.clip, args.hands))
            return 0
        if not 0.0 < args.minutes <= MOST_MINUTES:
            raise OptionError(f"--minutes must lie between 0 and {MOST_MINUTES:g}")
        if args.clip:
            report(stream(args.clip, args.hands, 60.0 * args.minutes))
        if args.truth:
            report(truth(args.truth))
    except HandfitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def report(figures: dict[str, Any]) -> None:
    """Print one figure a line."""
    for name, value in figures.items():
        print(f"{name:<36} {value:.4g}" if isinstance(value, float) else f"{name:<36} {value}", flush=True)


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


def serve(shown: list[np.ndarray], fps: float = FPS) -> None:
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
                time.sleep(max(0.0, began + number / fps - time.perf_counter()))
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


def stream(clip: str, hands: int, seconds: float) -> dict[str, Any]:
    """Follow the stream for that long. Raises HandfitError."""
    command = [sys.executable, __file__, clip, "--serve", "--hands", str(hands)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        assert server.stdin is not None
        try:
            port = int(server.stdout.readline())
            with Live(f"http://127.0.0.1:{port}/") as run:
                return _followed(run, hands, seconds)
        finally:
            server.stdin.close()


def _followed(run: Live, hands: int, seconds: float) -> dict[str, Any]:
    """The figures of a run, the two seconds after its first picture left out."""
    latencies, both, memory = [], 0, []
    next(iter(run))  # networks load with it
    begin = time.perf_counter() + 2.0
    received = shown = 0
    while (now := time.perf_counter()) < begin + seconds:
        pose = run.next()
        if pose is None or now < begin:
            received, shown = run.reader.received, run.shown
            continue
        latencies.append(1000.0 * (time.perf_counter() - stamp_of(pose.rgb)))
        both += sum(hand.state == "seen" for hand in pose.hands) >= hands
        if len(latencies) % 300 == 1:
            memory.append(resident_mb())
    came = run.reader.received - received
    return {
        "hands": hands,
        "seconds": seconds,
        "pictures a second": came / seconds,
        "shown, %": 100.0 * (run.shown - shown) / max(came, 1),
        "of these with all hands, %": 100.0 * both / max(len(latencies), 1),
        "latency, median ms": float(np.median(latencies)),
        "latency, 95 % ms": float(np.percentile(latencies, 95.0)),
        "memory, MB first and last": f"{memory[0]:.0f} {memory[-1]:.0f}",
        "memory, MB most": max(memory),
    }


def resident_mb() -> float:
    """Resident memory of this process in MB; NaN where the system does not tell, which Linux alone does."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    except OSError:
        return float("nan")


def truth(folder: Path) -> dict[str, Any]:
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
        np.mean([_pa_mpjpe(1000.0 * found[row], true[row]) for row in common]) for found in (preview, full)
    ]
    return {
        "frames with a hand in both": len(common),
        "of": len(labels),
        "preview, PA-MPJPE mm": float(errors[0]),
        "full capture, PA-MPJPE mm": float(errors[1]),
        "ratio": float(errors[0] / errors[1]),
    }


def _pa_mpjpe(found: np.ndarray, true: np.ndarray) -> float:
    laid = align(found, true, with_scale=True).apply(found)
    return float(np.linalg.norm(laid - true, axis=1).mean())


if __name__ == "__main__":
    sys.exit(main())
