"""scripts/measure_speed.py and scripts/measure_batch.py measure what they say."""

import pytest

from scripts import measure_speed


@pytest.mark.usefixtures("landmark_model")
def test_measures_the_sample(capsys):
    assert measure_speed.main(["--frames", "1-2", "--slow", "fast-per-frame", "--rounds", "1"]) == 0
    lines = capsys.readouterr().out.splitlines()
    for name in ("fast-per-frame", "fast, one frame", "fast, 256 frames", "detection", "whole capture"):
        assert any(line.startswith(name) for line in lines)


def test_photos_and_empty_tasks(capsys):
    pytest.importorskip("loky")
    from scripts.measure_batch import main

    assert main(["--count", "2", "--tasks", "20"]) == 0
    text = capsys.readouterr().out
    assert all(name in text for name in ("captures alone", "--jobs 1", "--jobs 2"))
    assert [line.split()[0] for line in text.splitlines()[-2:]] == ["2", "20"]
