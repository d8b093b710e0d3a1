"""The user's rigs: which fits, and what becomes of files that are none."""

from __future__ import annotations

import contextlib
from dataclasses import replace

import pytest

from handfit_core.common.errors import HandModelError, OptionError
from handfit_core.common.skeleton import NUM_JOINTS, SIDES
from handfit_core.retarget.hand_map import HandMap, empty_map, to_preset
from handfit_core.retarget.saved_rigs import (
    fitting_rig,
    forget_rig,
    rigs_folder,
    save_rig,
    saved_rigs,
)

LEFT, RIGHT = (HandMap(side, tuple(f"{side}{j}" for j in range(NUM_JOINTS))) for side in SIDES)
PALM = replace(LEFT, palm=("", "", "palm3", "palm4"))


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("HANDFIT_DATA", str(tmp_path / "data"))


def test_the_most_specific_rig_that_fits():
    assert saved_rigs() == ({}, ())
    save_rig("Plain", [LEFT, RIGHT])
    save_rig("Left", [LEFT])
    save_rig("Palm", [PALM])
    both = {*LEFT.named, *RIGHT.named, "root"}
    assert fitting_rig(both, "left").name == fitting_rig(both, "right").name == "Plain"
    assert fitting_rig({*PALM.named}, "left").name == "Palm"
    assert fitting_rig({*LEFT.named}, "left").name == "Left"
    assert fitting_rig({*LEFT.named}, "right") is None
    assert fitting_rig({*LEFT.named} - {"left7"}, "left") is None
    forget_rig("Palm")
    save_rig("Left", [PALM])
    assert fitting_rig({*PALM.named}, "left").of("left") == PALM


def test_other_files_are_left_out_and_named():
    save_rig("Good", [LEFT])
    handless = to_preset([empty_map("left")])
    files = {"words.json": b"words", "huge.json": b" " * 1_000_001, "none.json": handless.encode()}
    for name, data in {**files, "notes.txt": b"", ".hidden.json": b""}.items():
        (rigs_folder() / name).write_bytes(data)
    (rigs_folder() / "folder.json").mkdir()
    named = [*files, "folder.json"]
    with contextlib.suppress(OSError):  # Windows does not let everybody
        (rigs_folder() / "link.json").symlink_to(rigs_folder() / "gone")
        named.append("link.json")
    rigs, troubles = saved_rigs()
    assert [*rigs] == ["Good"]
    assert len(troubles) == len(named)
    assert all(any(name in trouble for trouble in troubles) for name in named)


@pytest.mark.parametrize(
    "name", ["", "  ", ".", "..", "../x", "a/b", "a\\b", "a:b", "nul", "COM1.x", "x" * 61]
)
def test_names_that_no_file_should_have_are_refused(name):
    with pytest.raises(OptionError, match="give the rig a name"):
        save_rig(name, [LEFT])
    assert not rigs_folder().exists()


def test_names_and_tables():
    assert save_rig(" Ünser Held (2.1) ", [LEFT]).name == "Ünser Held (2.1).json"
    assert [*saved_rigs()[0]] == ["Ünser Held (2.1)"]
    with pytest.raises(HandModelError, match="no bone stands for the left hand"):
        save_rig("None", [empty_map("left")])
