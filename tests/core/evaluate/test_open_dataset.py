"""Which reader a folder gets, and what is said where none fits."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from handfit_core.common.errors import DatasetError, OptionError, PlugInError
from handfit_core.evaluate.datasets import READERS, open_dataset
from handfit_core.evaluate.labels import Reader
from tests.core.evaluate.dataset_files import touch, write_json


def test_a_folder_that_fits_nothing_is_told_every_layout(tmp_path: Path) -> None:
    touch(tmp_path / "holiday.jpg")
    with pytest.raises(DatasetError) as caught:
        open_dataset(tmp_path)
    message = str(caught.value)
    assert "\n" not in message
    for words in (
        "index.json", "training/rgb/00000000.jpg", "train/ABF10/meta/0000.pkl",
        "anno_training.pickle", "my_annotation.txt_3D.txt", "my_Grasp13D.txt",
    ):  # fmt: skip
        assert words in message


@pytest.mark.parametrize(
    ("kind", "file"),
    [
        ("freihand", "evaluation_xyz.json"),
        ("ho3d", "evaluation/AP10/meta/0000.pkl"),
        ("rhd", "training/color/00000.png"),
        ("egodexter", "data/Rotunda/color/image_00000_color.png"),
    ],
)
def test_a_part_of_a_layout_is_enough_to_name_what_is_missing(tmp_path: Path, kind: str, file: str) -> None:
    """Recognised or named, the message is the same: one reader's, with its layout."""
    touch(tmp_path / file)
    messages = []
    for asked in (None, kind):
        with pytest.raises(DatasetError) as caught:
            open_dataset(tmp_path, asked)
        messages.append(str(caught.value))
    assert messages[0] == messages[1]
    assert "\n" not in messages[0]
    assert "is missing; expected" in messages[0]


def test_options_that_do_not_exist(tmp_path: Path) -> None:
    write_json(tmp_path / "index.json", [])
    with pytest.raises(OptionError, match="there is no data set kind 'stb'; choose one of plain, rhd"):
        open_dataset(tmp_path, "stb")
    with pytest.raises(OptionError, match="a plain data set has no splits"):
        open_dataset(tmp_path, split="training")
    with pytest.raises(DatasetError, match="there is no such folder"):
        open_dataset(tmp_path / "index.json")


@pytest.mark.parametrize("kind", [None, "toy"])
def test_what_fails_in_a_plug_in_names_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, kind: str | None
) -> None:
    reader = Reader("", lambda _: 1 / 0, lambda _: 1 / 0)  # recognises, read
    monkeypatch.setitem(READERS._offered, "toy", EntryPoint("toy", "toys:TOY", READERS._group))
    monkeypatch.setitem(READERS._parts, "toy", reader)
    with pytest.raises(PlugInError, match=r"^the data set kind toy of toys failed \(ZeroDivisionError"):
        open_dataset(tmp_path, kind)
