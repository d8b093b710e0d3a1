"""A batch by the workers of a Dask cluster, with the real Blender in them."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("bpy", reason="needs one of the bpy wheels")
pytest.importorskip("distributed", reason="needs distributed, of handfit-core[farm]")

ROOT = Path(__file__).resolve().parents[2]
TAKE = ROOT / "samples" / "rendered_hand" / "truth.take.npz"
TIMEOUT = 1200


@pytest.mark.skipif(sys.platform == "win32", reason="not tried there")
def test_two_workers_and_again(tmp_path, monkeypatch):
    monkeypatch.setenv("HANDFIT_PYTHON", sys.executable)
    takes = [tmp_path / f"{name}.take.npz" for name in ("one", "two")]
    for take in takes:
        take.write_bytes(TAKE.read_bytes())
    out = tmp_path / "out"

    def run(*words: object) -> subprocess.CompletedProcess[str]:
        script = [
            sys.executable,
            ROOT / "scripts" / "batch_fit.py",
            *words,
            "--cluster",
            "local",
            "--jobs",
            2,
        ]
        command = list(map(str, script))
        return subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=TIMEOUT)

    done = run(*takes, "-o", out, "--format", "glb", "--no-sheet")
    assert done.returncode == 0, done.stderr
    entries = json.loads((out / "report.json").read_text(encoding="utf-8"))["inputs"]
    assert [(entry["name"], entry["status"]) for entry in entries] == [("one", "ok"), ("two", "ok")]
    seals = {name: (out / name / "done.json").read_bytes() for name in ("one", "two")}
    assert all((out / name / f"{name}.glb").stat().st_size for name in seals)
    again = run("work", out)
    assert again.returncode == 0, again.stderr
    assert {name: (out / name / "done.json").read_bytes() for name in seals} == seals, "done once"


@pytest.mark.skipif(not hasattr(os, "killpg"), reason="there nobody looks whether a parent is still there")
def test_a_batch_that_is_killed_takes_its_client_along(tmp_path):
    import psutil

    (tmp_path / "hang.take.npz").write_bytes(TAKE.read_bytes())
    log, peer = tmp_path / "log", ROOT / "tests" / "core" / "farm" / "peers.py"
    words = ["hang.take.npz", "-o", "out", "--cluster", "local", "--jobs", "1", "--python", sys.executable]
    program = ["--command", shlex.join([sys.executable, str(peer)])]
    batch = subprocess.Popen(
        [sys.executable, str(ROOT / "scripts" / "batch_fit.py"), *words, *program],
        cwd=tmp_path,
        env={**os.environ, "PEER_LOG": str(log)},
    )
    until = time.monotonic() + TIMEOUT
    while not (log.exists() and "child" in log.read_text()):
        assert batch.poll() is None
        assert time.monotonic() < until
        time.sleep(0.1)
    started = psutil.Process(batch.pid).children(recursive=True)
    batch.kill()
    batch.wait()
    assert len(started) > 3, "the client, a worker, and what does the task"
    assert not psutil.wait_procs(started, timeout=TIMEOUT)[1]
