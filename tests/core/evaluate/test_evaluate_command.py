"""`python -m handfit_core evaluate` as its users run it, on the bundled sample and its exact truth."""

from __future__ import annotations

import csv
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from handfit_core import Take
from handfit_core.__main__ import main
from tests.conftest import ROOT

SAMPLE = ROOT / "samples" / "rendered_hand"


pytestmark = pytest.mark.usefixtures("landmark_model")


@pytest.fixture
def labelled(tmp_path: Path) -> Path:
    """Six frames of the bundled sample as a data set in the plain form: two stills and a clip of four."""
    truth = Take.load(SAMPLE / "truth.take.npz")
    track, k = truth.hands[0], truth.intrinsics
    folder = tmp_path / "labelled"
    folder.mkdir()
    pictures = []
    for place, i in enumerate([0, 12, 3, 4, 5, 6]):
        name = f"{i}.jpg"
        shutil.copy(SAMPLE / truth.source.files[i], folder / name)
        item = {
            "file": name,
            "hand": track.side,
            "joints_3d_mm": (1000 * track.joints_3d[i]).tolist(),
            "keypoints_2d_px": track.keypoints_2d[i].tolist(),
            "K": [[k.fx, 0, k.cx], [0, k.fy, k.cy], [0, 0, 1]],
        }
        if place >= 2:
            item |= {"clip": "wave", "time": (i - 3) / truth.fps}
        pictures.append(item)
    (folder / "index.json").write_text(json.dumps(pictures))
    return folder


def run(*arguments: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "handfit_core", "evaluate", *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, timeout=600, env=environment)


def table(report: Path) -> dict[str, dict[str, str]]:
    with open(report / "table.csv", newline="", encoding="utf-8") as stream:
        return {row["method"]: row for row in csv.DictReader(stream)}


def test_a_report_with_numbers_that_follow_from_the_truth(labelled: Path, tmp_path: Path) -> None:
    report = tmp_path / "report"
    (labelled / "12.jpg").unlink()
    (labelled / "0.jpg").write_bytes((labelled / "0.jpg").read_bytes()[:50])
    result = run(labelled, "--solvers", "raw,fused", "paper-a-plus", "-o", report, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "paper-a-plus" in result.stdout  # the table, for people in a terminal
    for words in (str(report / "index.html"), "picture cannot be read: 1", "missing: 1"):
        assert words in result.stderr
    rows = table(report)
    assert list(rows) == [
        *("null-centroid", "null-mean-pose", "raw-image", "raw-world", "fused", "paper-a-plus")
    ]
    for method in ("raw-image", "raw-world", "fused", "paper-a-plus"):
        assert float(rows[method]["detection_rate"]) == 100.0
        assert float(rows[method]["handedness"]) == 100.0
        # Of a rendered hand about 170 mm long.
        assert 2.0 < float(rows[method]["pa_mpjpe"]) < 20.0
    assert float(rows["paper-a-plus"]["fit_ms"]) > 0.0
    assert rows["raw-image"]["fit_ms"] in ("", "nan")
    assert (report / "index.html").is_file()


def test_the_papers_protocol_as_json(labelled: Path, tmp_path: Path) -> None:
    result = run(labelled, "--solvers", "raw", "--protocol", "paper", "--progress", "json", cwd=tmp_path)
    events = [json.loads(line) for line in result.stdout.splitlines()]
    assert {e["stage"] for e in events if e["event"] == "progress"} == {"detect", "fit", "score"}
    done = events[-1]
    assert done["event"] == "done"
    assert Path(done["output"]) == Path("out/evaluation/labelled-paper/index.html")
    assert (tmp_path / done["output"]).is_file()
    assert done["pictures"] == 6
    assert 0.0 < done["summaries"]["raw-image"]["epe"] < 50.0
    assert np.isfinite(done["summaries"]["null-centroid"]["auc"])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "nowhere"),
        (["labelled", "--solvers", "paper-x"], "no solver 'paper-x'"),
        (["labelled", "--kind", "freihand"], "evaluation_xyz.json"),
    ],
)
def test_errors_are_one_sentence(
    labelled: Path,
    arguments: list[str],
    message: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(labelled.parent)
    assert main(["evaluate", *arguments]) == 1
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert message in line


def test_what_reports_lack_is_said_before_anything_is_fitted(
    labelled: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)  # as where it is not installed
    monkeypatch.chdir(labelled)
    assert main(["evaluate", str(labelled)]) == 1
    error = capsys.readouterr().err
    assert "report needs pandas, which this Python lacks" in error
    assert not (labelled / "out").exists()
