"""scripts/measure_batch.py measures what it says."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

pytest.importorskip("loky")


def test_photos_and_empty_tasks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from scripts.measure_batch import main

    output = tmp_path / "costs.json"
    assert main(["--count", "2", "--tasks", "20", "-o", str(output)]) == 0
    text = capsys.readouterr().out
    assert [line.split()[0] for line in text.splitlines()[-2:]] == ["2", "20"]
    numbers = json.loads(output.read_text())
    assert set(numbers["photos"]) == {"count", "captures alone", "--jobs 1", "--jobs 2"}
    assert [each["tasks"] for each in numbers["empty"]] == [2, 20]
