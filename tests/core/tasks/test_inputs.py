"""What of a folder is an input."""

from __future__ import annotations

import pytest

from handfit_core.tasks.inputs import expand
from handfit_core.tasks.record import Result, write_record


@pytest.mark.parametrize("text", ["{}", "{}/*"])
def test_what_a_flat_batch_has_put_beside_its_inputs_is_no_input(tmp_path, text):
    for name in ("shot.0001.jpg", "shot.0002.jpg"):
        (tmp_path / name).write_bytes(name.encode())
    before = expand(text.format(tmp_path))
    assert [len(each.source) for each in before] == [2], "one sequence"
    for suffix in (".sheet.jpg", ".preview.png", ".export.json"):
        (tmp_path / f"shot{suffix}").write_bytes(b"ours")
    write_record(tmp_path / "shot.json", "key", Result("shot", "shot"), {})
    assert expand(text.format(tmp_path)) == before
    (named,) = expand(str(tmp_path / "shot.sheet.jpg"))
    assert named.source, "who names one means it"
