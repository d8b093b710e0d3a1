"""Which files a path of the panel stands for."""

from __future__ import annotations

from pathlib import Path

import pytest

bpy = pytest.importorskip("bpy", reason="needs one of the bpy wheels")

from blender_manient import source_info  # noqa: E402
from handfit_core.errors import InputError  # noqa: E402


@pytest.fixture
def numbered(tmp_path) -> list[Path]:
    files = [tmp_path / f"shot_{n:03}.png" for n in (7, 8, 9, 10)]
    for file in files:
        file.write_bytes(b"picture")
    return files


def test_one_picture_is_a_photo_unless_it_is_said_to_be_a_sequence(numbered):
    alone = source_info.resolve(str(numbered[1]), as_sequence=False)
    assert (alone.kind, alone.files) == ("photo", (str(numbered[1]),))
    clip = source_info.resolve(str(numbered[1]), as_sequence=True)
    assert (clip.kind, clip.files) == ("sequence", tuple(map(str, numbered)))
    assert clip.numbers == [7, 8, 9, 10]


def test_a_folder_is_a_sequence_and_with_one_picture_a_photo(numbered, tmp_path):
    assert source_info.resolve(str(tmp_path), as_sequence=False).kind == "sequence"
    for file in numbered[1:]:
        file.unlink()
    assert source_info.resolve(str(tmp_path), as_sequence=False).files == (str(numbered[0]),)


def test_neighbours_of_other_names_kinds_and_unnumbered_ones_do_not_count(numbered, tmp_path):
    for name in ("shot_011.jpg", "shot_012b.png", "other_013.png", "shot_.png"):
        (tmp_path / name).write_bytes(b"picture")
    assert source_info.numbered_siblings(numbered[0]) == numbered
    assert source_info.numbered_siblings(tmp_path / "shot_.png") == []


def test_a_path_relative_to_the_blend_file_is_understood(numbered, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    assert source_info.resolve("//shot_008.png", as_sequence=False).files == (str(numbered[1]),)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("", "Choose a photo"),
        ("gone.png", "not there any more"),
        ("notes.txt", "neither"),
        (".", "No pictures"),
    ],
)
def test_what_cannot_be_captured_is_said_with_a_remedy(tmp_path, name, said):
    (tmp_path / "notes.txt").write_text("text")
    with pytest.raises(InputError, match=said):
        source_info.resolve(str(tmp_path / name) if name else "", as_sequence=False)


def test_hands_of_another_program(tmp_path, make_take):
    path = tmp_path / "hands.points.json"
    path.write_text("{}")
    assert source_info.resolve(str(path), as_sequence=False) == source_info.SourceFiles("data", (str(path),))
    frames = tmp_path / "openpose"
    frames.mkdir()
    (frames / "clip_000000_keypoints.json").write_text("{}")
    assert source_info.resolve(str(frames), as_sequence=False).kind == "data"
    take = make_take().take.save(tmp_path / "a.take.npz")
    with pytest.raises(InputError, match="Import > Hand Take"):
        source_info.resolve(str(take), as_sequence=False)


def test_video(tmp_path):
    path = tmp_path / "clip.MP4"
    path.write_bytes(b"video")
    assert source_info.resolve(str(path), as_sequence=True).kind == "video"


@pytest.mark.parametrize("name", ["x" * 5000, "[" * 100_000, "a\0b", "~nobody-of-this-name/x.png"])
def test_a_name_that_no_file_can_have_is_a_sentence(name):
    with pytest.raises(InputError, match="choose"):
        source_info.resolve(name, as_sequence=False)
