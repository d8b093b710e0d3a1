"""A batch whose captures are done by the workers of a Dask cluster, and its exports by Blender."""

from __future__ import annotations

import json
import subprocess
import sys
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
    words = [*takes, "-o", out, "--format", "glb", "--no-sheet", "--scheduler", "local", "--jobs", 2]
    command = list(map(str, [sys.executable, ROOT / "scripts" / "batch_fit.py", *words]))
    results = ()
    for _ in range(2):
        done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=TIMEOUT)
        assert done.returncode == 0, done.stderr
        entries = json.loads((out / "report.json").read_text(encoding="utf-8"))["inputs"]
        assert [(entry["name"], entry["status"]) for entry in entries] == [("one", "ok"), ("two", "ok")]
        records = [(path, path.stat().st_mtime_ns) for path in sorted(out.glob("*/*.json"))]
        assert results in ((), records), "done once"
        results = records
    assert all((out / name / f"{name}.glb").stat().st_size for name in ("one", "two"))
