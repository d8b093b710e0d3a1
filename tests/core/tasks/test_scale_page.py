"""The job files of docs/scale.md, as they stand there, run by what is installed."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT

PAGE = (ROOT / "docs" / "scale.md").read_text(encoding="utf-8")
PATIENCE = 300.0


def job_file(heading: str) -> str:
    """The code below a heading."""
    found = re.search(rf"^### {heading}\n.*?^```\w+\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    assert found is not None
    return found[1]


@pytest.fixture
def shop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with inputs, in which `python` is this one, with captures that take no time."""
    (tmp_path / "shots").mkdir()
    for name in ("a", "b"):
        (tmp_path / "shots" / f"{name}.jpg").write_bytes(name.encode())
    programs = tmp_path / "programs"
    programs.mkdir()
    python = programs / "python"
    # In the place of `-m handfit_core batch`
    python.write_text(f'#!/bin/sh\nshift 3\nexec "{sys.executable}" -m tests.core.tasks.fakes "$@"\n')
    python.chmod(0o755)
    monkeypatch.setenv("PATH", f"{programs}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", f"{ROOT}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(*words: str | Path, **variables: str) -> None:
    done = subprocess.run(
        list(map(str, words)),
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        env={**os.environ, **variables},
    )
    assert done.returncode == 0, done.stdout + done.stderr


def all_done(shop: Path) -> bool:
    records = [json.loads((shop / f"results/{name}/{name}.json").read_text()) for name in ("a", "b")]
    return all(record["result"]["status"] == "ok" for record in records)


needs_shell = pytest.mark.skipif(sys.platform == "win32", reason="needs a shell")


@pytest.mark.slow
@needs_shell
def test_slurms_script(shop: Path) -> None:
    (shop / "job.sh").write_text(job_file("SLURM"))
    (shop / "clips.txt").write_text("shots/a.jpg\nshots/b.jpg\n")
    for number in "12":
        run("bash", "job.sh", SLURM_ARRAY_TASK_ID=number)
    assert all_done(shop)


@pytest.mark.slow
@needs_shell
def test_open_job_description(shop: Path) -> None:
    if importlib.util.find_spec("openjd") is None:
        pytest.skip("Open Job Description's own tool is not here; pip install openjd-cli")
    (shop / "hands.yaml").write_text(job_file("Open Job Description").replace("/mnt/show", str(shop)))
    run(sys.executable, "-m", "openjd", "run", "hands.yaml")
    assert all_done(shop)


@pytest.mark.slow
@needs_shell
def test_snakemake(shop: Path) -> None:
    if (program := os.environ.get("HANDFIT_SNAKEMAKE") or shutil.which("snakemake")) is None:
        pytest.skip("snakemake is not here")
    (shop / "hands.smk").write_text(job_file("Snakemake"))
    run(program, "-s", "hands.smk", "--cores", "2", "--keep-going")
    assert all_done(shop)
