"""The second step of a batch, with a program in Blender's place that dies, hangs or fails as a take's name
says."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.__main__ import main
from handfit_core.media.source import Source
from tests.core.tasks.fakes import CAMERA
from tests.takes import take_of, track_of

BLENDER = """
import json, os, sys, time
from pathlib import Path
given = json.loads(sys.stdin.readline())
print("Blender says hello", flush=True)
for line in sys.stdin:
    take = json.loads(line)
    folder, name = Path(take["folder"]), take["name"]
    with Path("begun.txt").open("a") as begun:
        begun.write(f"{name}\\n")
    if name == "dies" or (name == "trips" and not (folder / "tripped").exists()):
        (folder / "tripped").touch()
        os._exit(9)
    if name == "hangs":
        time.sleep(600)
    answer = {"made": {}, "warnings": [given["said"]], "character": None, "error": ""}
    if name == "fails":
        answer["error"] = "it cannot be written"
    else:
        for fmt in take["formats"]:
            answer["made"][fmt] = {f"{name}.{fmt}": (folder / f"{name}.{fmt}").write_text(fmt)}
    print("exported: " + json.dumps(answer), flush=True)
"""


@pytest.fixture
def batch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """batch(names, formats, *words) -> the exit code, and what the report says of takes of these names."""
    monkeypatch.chdir(tmp_path)
    hand = track_of("right", np.zeros((1, 3)), np.zeros((1, 45)), np.array([[0.0, 0.0, 0.4]]), CAMERA)
    take = take_of([hand], CAMERA, 640, 480, source=Source("photo", ("gone.png",)))

    def run(names: str, formats: list[str], *words: str) -> tuple[int, dict[str, Any]]:
        files = [str(take.save(tmp_path / f"{name}.take.npz")) for name in names.split()]
        given = {"said": "a warning", "model": None}
        asked = {"command": [sys.executable, "-c", BLENDER], "environment": {}, "given": given}
        exports = json.dumps({**asked, "formats": formats, "key": "one"})
        line = ["batch", *files, "-o", "out", "--no-sheet", "--jobs", "2", "--exports", exports, *words]
        code = main(line)
        entries = json.loads(Path("out/report.json").read_text())["inputs"]
        return code, {entry["name"]: entry for entry in entries}

    return run


def test_who_kills_blender_fails_alone(batch: Any) -> None:
    code, found = batch("a dies trips hangs fails b", ["x"], "--timeout", "8")
    assert code == 1
    errors = {name: entry["error"] for name, entry in found.items() if entry["status"] == "failed"}
    assert errors == {
        "dies": "Blender crashed twice while it made files of it; try again with --debug",
        "hangs": "to make files of it took longer than 8 seconds (--timeout)",
        "fails": "it cannot be written",
    }
    for name in ("a", "trips", "b"):
        entry = found[name]
        assert (entry["status"], entry["warnings"]) == ("ok", ["a warning"])
        assert entry["files"] == [f"{name}/{name}.take.npz", f"{name}/{name}.x"]
    begun = Path("begun.txt").read_text().split()
    assert {name: begun.count(name) for name in set(begun)} == {
        **dict.fromkeys(("a", "b", "fails", "hangs"), 1),
        **dict.fromkeys(("dies", "trips"), 2),
    }


def test_what_is_there_is_not_made_again(batch: Any) -> None:
    assert batch("a b", ["x"])[0] == 0
    Path("out/b/b.x").unlink()
    code, found = batch("a b", ["x", "y"])
    assert (code, found["b"]["files"]) == (0, ["b/b.take.npz", "b/b.x", "b/b.y"])
    record = json.loads(Path("out/a/a.export.json").read_text())
    assert record["formats"] == {"x": ["a.x"], "y": ["a.y"]}
    assert sorted(Path("begun.txt").read_text().split()) == ["a", "a", "b", "b"]
    assert batch("a b", ["x"])[0] == 0
    assert len(Path("begun.txt").read_text().split()) == 4
