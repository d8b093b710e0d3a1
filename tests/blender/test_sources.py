"""Which files a path of the panel stands for."""

from __future__ import annotations

from pathlib import Path

import pytest

bpy = pytest.importorskip("bpy", reason="needs one of the bpy wheels")

from blender_manient.operators.capture import new_request  # noqa: E402
from blender_manient.panels.capture import MANIENT_PT_capture  # noqa: E402
from blender_manient.session import source_info  # noqa: E402
from handfit_core.common.errors import InputError, OptionError  # noqa: E402
from tests.drawn import drawn  # noqa: E402


@pytest.fixture
def numbered(tmp_path) -> list[Path]:
    files = [tmp_path / f"shot_{n:03}.png" for n in (7, 8, 9, 10)]
    for file in files:
        file.write_bytes(b"picture")
    return files


def resolved(path, as_sequence: bool = False):
    found = source_info.resolve(str(path), as_sequence=as_sequence)
    return found.kind, found.files


def test_pictures_are_a_photo_or_a_sequence(numbered, tmp_path):
    """Neighbours of other names and kinds and unnumbered ones do not count."""
    everything = tuple(map(str, numbered))
    assert resolved(numbered[1]) == ("photo", everything[1:2])
    assert resolved(tmp_path) == ("sequence", everything)
    for name in ("shot_011.jpg", "shot_012b.png", "other_013.png", "shot_.png"):
        (tmp_path / name).write_bytes(b"picture")
    assert resolved(numbered[1], as_sequence=True) == ("sequence", everything)
    assert source_info.resolve(everything[1], as_sequence=True).numbers == [7, 8, 9, 10]
    assert source_info.numbered_siblings(tmp_path / "shot_.png") == []
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    assert resolved("//shot_008.png") == ("photo", everything[1:2])
    alone = tmp_path / "alone"
    alone.mkdir()
    numbered[0].rename(alone / "a.png")
    assert resolved(alone) == ("photo", (str(alone / "a.png"),))


def test_clips_and_hands_of_another_program(tmp_path):
    frames = tmp_path / "openpose"
    frames.mkdir()
    (frames / "clip_000000_keypoints.json").write_text("{}")
    (tmp_path / "hands.points.json").write_text("{}")
    (tmp_path / "clip.MP4").write_bytes(b"video")
    for name, kind in (("clip.MP4", "video"), ("hands.points.json", "data"), ("openpose", "data")):
        assert resolved(tmp_path / name, as_sequence=True)[0] == kind


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("", "Choose a photo"),
        ("gone.png", "not there any more"),
        ("notes.md", "this is a text"),
        ("a.take.npz", "Import > Hand Take"),
        ("empty", "No pictures"),
        ("x" * 5000, "choose"),
        ("a\0b", "choose"),
        ("~nobody-of-this-name/x.png", "choose"),
    ],
)
def test_what_cannot_be_captured_is_said_with_a_remedy(tmp_path, make_take, monkeypatch, name, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "notes.md").write_text("text")
    make_take().take.save(tmp_path / "a.take.npz")
    with pytest.raises(InputError, match=said):
        source_info.resolve(name, as_sequence=False)


def test_a_picture_size_that_no_file_tells_is_asked_for(registered, tmp_path):
    path, settings = tmp_path / "hands.json", bpy.context.scene.manient
    path.write_text("{}")
    settings.source = str(path)
    info = source_info.of(settings)
    assert "Width" not in drawn(MANIENT_PT_capture).said

    info.unsized, info.fps = True, 30.0
    source = drawn(MANIENT_PT_capture)
    assert "How large are its pictures? The file does not say Width Height" in source.said
    assert source.loud == "Width Height"
    assert {"Capture", "Capture Frame 1"} <= set(drawn(MANIENT_PT_capture).grey)
    assert source_info.footage(settings, info) is None
    with pytest.raises(OptionError, match="width and height"):
        new_request(bpy.context, only_frame=False)

    settings.picture_size = (640, 480)
    assert drawn(MANIENT_PT_capture).loud == ""
    assert "Capture" not in drawn(MANIENT_PT_capture).grey
    assert source_info.footage(settings, info).width == 640
    assert new_request(bpy.context, only_frame=False).options.picture_size == (640, 480)
    (tmp_path / "others.json").write_text("{}")
    settings.source = str(tmp_path / "others.json")
    assert tuple(settings.picture_size) == (0, 0), "a size belongs to one source"
