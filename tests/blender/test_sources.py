"""Which files a path of the panel stands for."""

from __future__ import annotations

from pathlib import Path

import pytest

bpy = pytest.importorskip("bpy", reason="needs one of the bpy wheels")

from blender_manient.operators.capture import new_job  # noqa: E402
from blender_manient.panels.capture import MANIENT_PT_capture  # noqa: E402
from blender_manient.panels.source import MANIENT_PT_source  # noqa: E402
from blender_manient.session import shared_worker, source_info  # noqa: E402
from handfit_core.errors import InputError, OptionError  # noqa: E402
from tests.drawn import drawn  # noqa: E402


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


def test_a_picture_size_that_no_file_tells_is_asked_for(registered, monkeypatch, tmp_path):
    monkeypatch.setattr(shared_worker, "capture_sentence", lambda: "")
    path, settings = tmp_path / "hands.json", bpy.context.scene.manient
    path.write_text("{}")
    settings.source = str(path)
    info = source_info.of(settings)
    assert "Width" not in drawn(MANIENT_PT_source).said

    info.unsized, info.fps = True, 30.0
    source = drawn(MANIENT_PT_source)
    assert "How large are its pictures? The file does not say Width Height" in source.said
    assert source.loud == "Width Height"
    assert {"Capture", "Capture Frame 1"} <= set(drawn(MANIENT_PT_capture).grey)
    assert source_info.footage(settings, info) is None
    with pytest.raises(OptionError, match="width and height"):
        new_job(bpy.context, only_frame=False)

    settings.picture_size = (640, 480)
    assert drawn(MANIENT_PT_source).loud == ""
    assert "Capture" not in drawn(MANIENT_PT_capture).grey
    assert source_info.footage(settings, info).width == 640
    assert new_job(bpy.context, only_frame=False).options.picture_size == (640, 480)
    (tmp_path / "others.json").write_text("{}")
    settings.source = str(tmp_path / "others.json")
    assert tuple(settings.picture_size) == (0, 0), "a size belongs to one source"


def test_video(tmp_path):
    path = tmp_path / "clip.MP4"
    path.write_bytes(b"video")
    assert source_info.resolve(str(path), as_sequence=True).kind == "video"


@pytest.mark.parametrize("name", ["x" * 5000, "[" * 100_000, "a\0b", "~nobody-of-this-name/x.png"])
def test_a_name_that_no_file_can_have_is_a_sentence(name):
    with pytest.raises(InputError, match="choose"):
        source_info.resolve(name, as_sequence=False)
