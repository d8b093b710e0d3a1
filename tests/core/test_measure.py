"""scripts/measure_speed.py and scripts/measure_batch.py measure what they say."""

from __future__ import annotations

import numpy as np
import pytest

from scripts import measure_speed


def test_takes_turns_in_every_round(monkeypatch):
    now, log = [0.0], []

    def takes(name: str, seconds: float):
        def call() -> None:
            log.append(name)
            now[0] += seconds

        return call

    monkeypatch.setattr(measure_speed.time, "perf_counter", lambda: now[0])
    timed = {"slow": (takes("slow", 2.0), 1), "fast": (takes("fast", 1.0), 100)}
    seconds = measure_speed.paired_times(timed, 2)
    assert log == ["slow", "fast"] * 3
    np.testing.assert_allclose(seconds, [[2.0, 1.0]] * 2)
    seconds[1] *= 10.0  # the machine is slower for a while
    _, slow, fast = measure_speed.table("title", timed, seconds).splitlines()
    assert slow.split() == ["slow", "1.1e+04", "1", "(1", "to", "1)"]
    assert fast.split() == ["fast", "55", "200", "(200", "to", "200)"]


@pytest.mark.usefixtures("landmark_model")
def test_measures_the_sample(capsys):
    assert measure_speed.main(["--frames", "1-2", "--slow", "fast-per-frame", "--rounds", "1"]) == 0
    lines = capsys.readouterr().out.splitlines()
    for name in ("fast-per-frame", "fast, one frame", "fast, 256 frames", "detection", "whole capture"):
        assert any(line.startswith(name) for line in lines)
    assert 50 < float(lines[-1].split()[-2]) < 5000


def test_photos_and_empty_tasks(capsys):
    pytest.importorskip("loky")
    from scripts.measure_batch import main

    assert main(["--count", "2", "--tasks", "20"]) == 0
    text = capsys.readouterr().out
    assert all(name in text for name in ("captures alone", "--jobs 1", "--jobs 2"))
    assert [line.split()[0] for line in text.splitlines()[-2:]] == ["2", "20"]
