"""What of a folder is an input."""

from __future__ import annotations

from pathlib import Path

import pytest

from handfit_core.tasks.inputs import expand, paired
from handfit_core.tasks.record import Record, Result


@pytest.mark.parametrize("text", ["{}", "{}/*"])
def test_what_a_flat_batch_has_put_beside_its_inputs_is_no_input(tmp_path, text):
    for name in ("shot.0001.jpg", "shot.0002.jpg"):
        (tmp_path / name).write_bytes(name.encode())
    before = expand(text.format(tmp_path))
    assert [len(each.source) for each in before] == [2], "one sequence"
    for suffix in (".sheet.jpg", ".preview.png", ".export.json"):
        (tmp_path / f"shot{suffix}").write_bytes(b"ours")
    Record("key", Result("shot", "shot")).write(tmp_path / "shot.json")
    assert expand(text.format(tmp_path)) == before
    (named,) = expand(str(tmp_path / "shot.sheet.jpg"))
    assert named.source, "who names one means it"


def test_clips_of_one_name_are_two_views(tmp_path):
    names = "x_a.mp4 x_b.MOV x_a.jpg y_A.mxf y_B.mxf z_a.mp4 z_b.mp4 z_c.mp4 only_a.mp4 a.mp4".split()
    for name in names:
        (tmp_path / name).touch()
    found = {each.name: each for each in paired(expand(str(tmp_path)))}
    views = {name: (Path(each.source[0]).name, Path(each.view).name) for name, each in found.items()}
    assert views == {
        "x": ("x_a.mp4", "x_b.MOV"),
        "y": ("y_A.mxf", "y_B.mxf"),
        "z": ("z_a.mp4", "z_b.mp4"),
        "x_a": ("x_a.jpg", ""),
        "only_a": ("only_a.mp4", ""),
        "a": ("a.mp4", ""),
    }
    assert [name for name, each in found.items() if each.error] == ["z"]
    assert "z_c.mp4: a capture has two views" in found["z"].error
    for text in ("x_a.mp4", "x_b.MOV"):
        assert paired(expand(str(tmp_path / text))) == [found["x"]], "a farm's task may name one of them"
