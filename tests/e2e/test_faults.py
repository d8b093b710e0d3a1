"""A real batch that is killed at random moments and started again ends as one that was left alone.

`HANDFIT_KILLS=30` kills as often as docs/batch.md says.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

pytest.importorskip("bpy", reason="needs one of the bpy wheels")
if sys.platform != "linux":
    pytest.skip("processes are looked for in Linux's /proc", allow_module_level=True)

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "scripts" / "batch_fit.py"
KILLS = int(os.environ.get("HANDFIT_KILLS", "3"))
INPUTS = 12
LIMIT = 600


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


@pytest.mark.slow
def test_a_batch_killed_at_random_moments_ends_as_if_it_was_not(take_file, tmp_path):
    takes = [take_file(f"wave{number}", frames=5 + number) for number in range(INPUTS)]
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
