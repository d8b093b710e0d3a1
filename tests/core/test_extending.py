"""What docs/extending.md shows, made from the page alone: installed, found by its name, used."""

import csv
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest

from handfit_core import Take
from tests.conftest import ROOT

PAGE = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")


def install(heading: str, folder: Path) -> None:
    """Write the module and the entry points of one section into a folder of Python's path."""
    section = PAGE.split(f"## {heading}\n")[1].split("\n## ")[0]
    code, project = (re.search(rf"```{kind}\n(.*?)```", section, re.DOTALL) for kind in ("python", "toml"))
    assert code is not None
    assert project is not None
    name = re.match(r'"""(\w+)\.py', code[1])
    assert name is not None
    (folder / f"{name[1]}.py").write_text(code[1], encoding="utf-8")
    info = folder / f"{name[1]}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name[1]}\nVersion: 1.0\n")
    groups = tomllib.loads(project[1])["project"]["entry-points"]
    lines = []
    for group, points in groups.items():
        lines += [f"[{group}]", *(f"{n} = {p}" for n, p in points.items())]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n")


def run(folder, *arguments):
    command = [sys.executable, "-m", "handfit_core", *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), str(ROOT)])}
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder, env=environment, timeout=300)
    assert done.returncode == 0, done.stderr
    return done


def test_a_detector(tmp_path):
    install("A detector", tmp_path)
    for number, place in enumerate(((200, 240), (260, 240), (320, 250)), 1):
        picture = np.zeros((480, 640, 3), dtype=np.uint8)
        cv2.circle(picture, place, 20, (255, 255, 255), -1)
        cv2.imwrite(str(tmp_path / f"spot.{number:04d}.png"), picture)
    output = tmp_path / "spot.npz"
    done = run(tmp_path, "capture", "spot.%04d.png", "--detector", "bright-spot", "-o", output)
    (hand,) = Take.load(output).hands
    assert hand.side == "right"
    assert hand.detected.all()
    assert hand.doubtful is None
    assert hand.expected_error is not None
    assert np.isnan(hand.expected_error).all(), "the calibration is of our own detector's points"
    assert "likely error not known" in done.stderr
    assert "good" not in done.stderr
    assert hand.keypoints_2d.mean(axis=1) == pytest.approx(
        np.array([[200, 240], [260, 240], [320, 250]]), abs=1
    )
    assert "bright-spot" in run(tmp_path, "capture", "--help").stdout


def test_a_solver(tmp_path):
    install("A solver", tmp_path)
    pictures, output = ROOT / "samples" / "rendered_hand" / "hand.%04d.jpg", tmp_path / "flat.npz"
    run(tmp_path, "capture", pictures, "--frames", "1-2", "--solver", "flat", "-o", output)
    take = Take.load(output)
    (hand,) = take.hands
    assert take.solver == "flat"
    assert not hand.hand_pose.any()
    np.testing.assert_allclose(hand.transl[:, 2], 0.5)


def test_a_reader_of_labelled_pictures(tmp_path):
    install("A reader of labelled pictures", tmp_path)
    sample = ROOT / "samples" / "rendered_hand"
    (hand,) = Take.load(sample / "truth.take.npz").hands
    folder = tmp_path / "labelled"
    folder.mkdir()
    with open(folder / "points.csv", "w", newline="", encoding="utf-8") as stream:
        for i in (0, 5):
            name = f"hand.{i + 1:04d}.jpg"
            shutil.copy(sample / name, folder)
            csv.writer(stream).writerow([name, *hand.keypoints_2d[i].ravel()])
    run(tmp_path, "evaluate", folder, "--solvers", "raw", "-o", tmp_path / "report")
    with open(tmp_path / "report" / "table.csv", newline="", encoding="utf-8") as stream:
        rows = {row["method"]: row for row in csv.DictReader(stream)}
    assert float(rows["raw-image"]["detection_rate"]) == 100.0
    assert 0.0 < float(rows["raw-image"]["error_2d"]) < 10.0


def test_a_trackers_points(tmp_path):
    install("A tracker's points", tmp_path)
    (hand,) = Take.load(ROOT / "samples" / "rendered_hand" / "truth.take.npz").hands
    joints = 100.0 * hand.joints_3d * [1.0, -1.0, -1.0]
    frames = [{"hands": [{"glove_id": 7, "side": hand.side, "joints": points}]} for points in joints.tolist()]
    (tmp_path / "a.json").write_text(json.dumps({"frames": frames}))
    said = run(tmp_path, "info", tmp_path / "a.json").stdout
    assert "format   glove" in said
    assert f"points in space: {hand.side} hand in {len(frames)} frames" in said


def test_a_trackers_points_in_the_users_folder(tmp_path, monkeypatch):
    install("A tracker's points", tmp_path)
    folder = tmp_path / "data" / "layouts"
    folder.mkdir(parents=True)
    (tmp_path / "my_tracker.py").rename(folder / "studio_glove.py")
    shutil.rmtree(tmp_path / "my_tracker-1.0.dist-info")
    (folder / "broken.py").write_text("1 / 0")
    monkeypatch.setenv("HANDFIT_DATA", str(tmp_path / "data"))
    (hand,) = Take.load(ROOT / "samples" / "rendered_hand" / "truth.take.npz").hands
    joints = (100.0 * hand.joints_3d[0]).tolist()
    frames = [{"hands": [{"glove_id": 7, "side": hand.side, "joints": joints}]}]
    (tmp_path / "a.json").write_text(json.dumps({"frames": frames}))
    done = run(tmp_path, "info", tmp_path / "a.json", "--reader", "studio-glove")
    assert f"points in space: {hand.side} hand in 1 frames" in done.stdout
    assert "broken" in run(tmp_path, "info", tmp_path / "a.json").stderr
