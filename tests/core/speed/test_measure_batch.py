"""scripts/measure_batch.py: what can be measured without Blender, and what it is told."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="it measures what Linux tells")


def test_empty_tasks_are_done_and_skipped(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from scripts.measure_batch import main

    output = tmp_path / "costs.json"
    assert main(["--only", "empty", "--tasks", "20", "-o", str(output)]) == 0
    text = capsys.readouterr().out
    assert [line.split()[0] for line in text.splitlines()[-2:]] == ["2", "20"]
    few, many = json.loads(output.read_text())["empty"]
    assert (few["tasks"], many["tasks"]) == (2, 20)
    assert many["skipping"] < many["doing"], "what is sealed is not done again"


def test_a_part_that_there_is_not(capsys: pytest.CaptureFixture[str]) -> None:
    from scripts.measure_batch import main

    assert main(["--only", "speed"]) == 1
    assert "there is no part 'speed'; choose from cost," in capsys.readouterr().err
