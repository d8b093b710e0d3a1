"""scripts/measure_speed.py, measure_batch.py and measure_live.py measure what they say."""

import re

import pytest

from scripts import measure_live, measure_speed


@pytest.mark.slow
@pytest.mark.usefixtures("landmark_model")
def test_measures_the_sample(capsys):
    assert measure_speed.main(["--frames", "1-2", "--slow", "fast-per-frame", "--rounds", "1"]) == 0
    lines = capsys.readouterr().out.splitlines()
    names = (
        "fast-per-frame|fast, one frame|fast, 256 frames|MediaPipe's VIDEO|detection|capture|capture, draft"
    )
    for name in names.split("|"):
        assert any(line.startswith(f"{name}  ") for line in lines), name


@pytest.mark.slow
def test_photos_and_empty_tasks(capsys):
    pytest.importorskip("loky")
    from scripts.measure_batch import main

    assert main(["--count", "2", "--tasks", "20"]) == 0
    text = capsys.readouterr().out
    assert all(name in text for name in ("captures alone", "--jobs 1", "--jobs 2"))
    assert [line.split()[0] for line in text.splitlines()[-2:]] == ["2", "20"]


@pytest.mark.slow
@pytest.mark.usefixtures("landmark_model")
def test_live_run(capsys):
    assert measure_live.main(["--minutes", "0.02"]) == 0
    rows = [re.split(r"\s{2,}", line) for line in capsys.readouterr().out.splitlines()]
    figures = {row[0]: float(row[-1]) for row in rows[1:]}
    for hands in ("one hand", "two hands"):
        assert 0.0 < figures[f"{hands}: latency, median ms"] < 60_000.0
        assert 0.0 < figures[f"{hands}: shown, %"] <= 110.0
