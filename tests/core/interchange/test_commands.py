"""`convert`, whatever the file is called."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from handfit_core.__main__ import main
from handfit_core.interchange import commands
from handfit_core.interchange.opening import read_recording
from tests.told import told


@pytest.mark.parametrize(
    ("name", "writer", "again"),
    [
        ("w.csv", "points-table", True),
        ("w.CSV", "points-table", True),
        ("w.bvh", "bvh", True),
        ("w.dat", "points-table", False),
        ("w", "points-table", False),
        ("w", "bvh", False),
    ],
)
def test_what_has_its_formats_ending_is_read_again(
    name: str, writer: str, again: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Others are written unread: a reader goes by the ending, too."""
    opened: list[Path] = []

    def noticed(path: Path, *rest: Any) -> Any:
        opened.append(path)
        return read_recording(path, *rest)

    told().take.save(tmp_path / "a.take.npz")
    monkeypatch.setattr(commands, "read_recording", noticed)
    given = ["convert", str(tmp_path / "a.take.npz"), "-o", str(tmp_path / name), "--to", writer]
    assert main([*given, "--progress", "none"]) == 0
    assert (tmp_path / name).stat().st_size > 0
    assert bool(opened) == again
