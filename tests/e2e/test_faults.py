"""A real batch that is killed at random moments and started again ends as one that was left alone; a video
that kills the process that captures is the only thing that fails.

`HANDFIT_KILLS=30` kills as often as docs/batch.md says.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import signal
import struct
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("bpy", reason="needs one of the bpy wheels")
if sys.platform != "linux":
    pytest.skip("processes are looked for in Linux's /proc", allow_module_level=True)

from handfit_core.geometry.camera import Intrinsics
from handfit_core.media.source import Source
from tests.capturing import needs_capture
from tests.takes import take_of, track_of

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "scripts" / "batch_fit.py"
KILLS = int(os.environ.get("HANDFIT_KILLS", "3"))
INPUTS = 12
LIMIT = 600
PYTHON = os.environ.get("HANDFIT_PYTHON", sys.executable)
KEY_FRAME = b"\x9d\x01\x2a"
"""What stands before a VP8 key frame's width and height: RFC 6386, 9.1"""


@pytest.fixture
def takes(tmp_path) -> list[Path]:
    """Takes of different motions, as inputs that need no Python that captures."""
    folder = tmp_path / "takes"
    folder.mkdir()
    made = []
    for number in range(INPUTS):
        frames = 5 + number
        t = np.linspace(0, 1, frames)
        pose = np.tile(np.tile([0.0, 0.0, 0.1 + 0.05 * number], 15), (frames, 1)) * t[:, None]
        camera = Intrinsics.assumed(320, 240)
        orient = np.stack([0.3 + t, t * 0, t], -1)
        hand = track_of("right", orient, pose, np.tile([0.0, 0.0, 0.6], (frames, 1)), camera)
        source = Source("photo", (str(folder / "gone.png"),))
        take = take_of([hand], camera, 320, 240, source=source)
        made.append(take.save(folder / f"wave{number}.take.npz"))
    return made


def start(inputs: list[Path], output: Path) -> subprocess.Popen[str]:
    command = [sys.executable, SCRIPT, *inputs, "-o", output, "--format", "blend,glb,bvh", "--no-sheet"]
    return subprocess.Popen(
        list(map(str, [*command, "--jobs", "2"])),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "FAULTS": str(output)},
    )


def processes_of(output: Path) -> list[int]:
    """All that were started for these results."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if f"FAULTS={output}".encode() in (path / "environ").read_bytes().split(b"\0"):
                found.append(int(path.name))
    return found


def hashes(output: Path) -> dict[str, str]:
    """Of all results but .blend files: those hold addresses in memory, and are never the same twice."""
    names = (p for p in output.glob("*/*") if p.suffix in (".npz", ".glb", ".bvh"))
    return {p.relative_to(output).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in names}


def records(output: Path) -> dict[Path, tuple[int, int]]:
    """Which record of what is finished is there, and since when."""
    found = ((path, path.stat()) for path in output.glob("*/*.json"))
    return {path: (stat.st_ino, stat.st_mtime_ns) for path, stat in found}


def test_a_batch_killed_at_random_moments_ends_as_if_it_was_not(takes, tmp_path):
    calm, out = tmp_path / "calm", tmp_path / "out"
    running = start(takes, calm)
    said, _ = running.communicate(timeout=LIMIT)
    assert running.returncode == 0, said
    chance = random.Random(18)
    finished: dict[Path, tuple[int, int]] = {}
    for number in range(KILLS):
        running = start(takes, out)
        time.sleep(chance.uniform(1.0, 12.0))
        if number % 3 == 2:  # one of its processes first
            others = [pid for pid in processes_of(out) if pid != running.pid] or [running.pid]
            with suppress(ProcessLookupError):
                os.kill(chance.choice(others), signal.SIGKILL)
            time.sleep(chance.uniform(0.0, 2.0))
        running.kill()
        running.communicate()
        finished = records(out) | finished
        assert finished == records(out), "what is finished is not done again"
    for _ in range(2):
        running = start(takes, out)
        said, _ = running.communicate(timeout=LIMIT)
        assert running.returncode == 0, said
    deadline = time.monotonic() + LIMIT
    while processes_of(out):
        assert time.monotonic() < deadline
        time.sleep(0.1)
    assert len(hashes(out)) == 3 * INPUTS
    assert hashes(out) == hashes(calm)
    assert {path: finished[path] for path in finished} == {path: records(out)[path] for path in finished}
    assert not [path for path in out.rglob(".*") if path.name != ".."]
    entries = json.loads((out / "report.json").read_text(encoding="utf-8"))["inputs"]
    assert [entry["status"] for entry in entries] == ["ok"] * INPUTS


@pytest.fixture
def crashing_video(tmp_path) -> Path:
    """A small VP8 file whose first key frame claims more columns than the container: OpenCV's FFmpeg ends by
    SIGSEGV in it."""
    path = tmp_path / "crashing.webm"
    code = (
        "import cv2, sys, numpy as np\n"
        "vp8 = cv2.VideoWriter.fourcc(*'VP80')\n"
        "video = cv2.VideoWriter(sys.argv[1], cv2.CAP_FFMPEG, vp8, 12, (124, 216))\n"
        "assert video.isOpened()\n"
        "for shade in range(26):\n"
        "    video.write(np.full((216, 124, 3), 9 * shade, np.uint8))\n"
        "video.release()\n"
    )
    subprocess.run([PYTHON, "-c", code, path], check=True, timeout=LIMIT, capture_output=True)
    data = bytearray(path.read_bytes())
    dimensions = data.index(KEY_FRAME) + len(KEY_FRAME)
    data[dimensions : dimensions + 4] = struct.pack("<HH", 4096, 216)
    path.write_bytes(data)
    read = (
        "import sys\n"
        "from handfit_core.media.opening import open_media\n"
        "for frame in open_media(sys.argv[1]).frames(): pass\n"
    )
    alone = subprocess.run([PYTHON, "-c", read, path], cwd=ROOT, timeout=LIMIT, capture_output=True)
    if alone.returncode >= 0:
        pytest.skip("this OpenCV does not crash on the video that its pinned version crashes on")
    return path


@needs_capture
def test_a_video_that_kills_the_process_that_captures_fails_alone(crashing_video, tmp_path):
    good, out = ROOT / "samples" / "rendered_hand" / "hand.0001.jpg", tmp_path / "out"
    running = start([crashing_video, good], out)
    said, _ = running.communicate(timeout=LIMIT)
    assert running.returncode == 1, said
    assert "Traceback" not in said
    entries = json.loads((out / "report.json").read_text(encoding="utf-8"))["inputs"]
    crashed, done = entries
    assert (crashed["name"], crashed["status"]) == ("crashing", "failed")
    assert "the process that captured it died 3 times; the input is damaged" in crashed["error"]
    assert [attempt["kind"] for attempt in crashed["attempts"]] == ["WorkerDied"] * 3
    assert (done["status"], done["attempts"]) == ("ok", [])
    assert {Path(name).suffix for name in done["files"]} == {".npz", ".blend", ".glb", ".bvh"}
    assert not processes_of(out)
    assert not list(out.glob(".part-*"))
