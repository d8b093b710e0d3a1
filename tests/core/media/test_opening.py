import logging
import re
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from handfit_core.common.errors import InputError
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.opening import numbered_like, open_media, sequence_numbers
from handfit_core.media.pictures import read_picture
from handfit_core.tasks.inputs import expand
from tests.bombs import clip
from tests.core.media.test_exif import photo, tiff_block


def write(path: Path, pixels: np.ndarray | None = None) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(cv2.imencode(path.suffix, grey(1) if pixels is None else pixels)[1].tobytes())
    return path


def grey(value: int, height: int = 12, width: int = 20) -> np.ndarray:
    return np.full((height, width, 3), value, dtype=np.uint8)


def numbers(source, frames: str | None = None) -> list[int]:
    media = open_media(source, FrameRange.parse(frames) if frames else None)
    found = [f.number for f in media.frames()]
    assert media.expected_frames == len(found)
    return found


def test_photo(tmp_path):
    path = write(tmp_path / "a.png", np.full((12, 20, 3), (0, 0, 200), np.uint8))
    media = open_media(path)
    (frame,) = media.frames()
    assert (media.source.kind, media.width, media.height, media.fps) == ("photo", 20, 12, 24.0)
    assert (media.source.name, list(media.source.files)) == ("a", [str(path.resolve())])
    assert frame.number == 1
    np.testing.assert_array_equal(frame.rgb[0, 0], [200, 0, 0])  # RGB, not BGR


@pytest.mark.parametrize(
    ("pixels", "expected"),
    [
        (np.full((8, 8), 77 * 257, np.uint16), [77, 77, 77]),
        (np.full((8, 8, 3), (10 * 257, 20 * 257, 30 * 257), np.uint16), [30, 20, 10]),
        (np.full((8, 8, 4), (10, 20, 30, 0), np.uint8), [128, 128, 128]),
        (np.full((8, 8, 4), (0, 100, 255, 51), np.uint8), [153, 122, 102]),
        (np.full((8, 8, 4), (0, 0, 65535, 65535), np.uint16), [255, 0, 0]),
    ],
    ids=["grey16", "rgb16", "transparent", "half", "rgba16"],
)
def test_depths_and_channels(tmp_path, pixels, expected):
    rgb, orientation = read_picture(write(tmp_path / "a.png", pixels))
    assert orientation == 1
    assert rgb.dtype == np.uint8
    np.testing.assert_array_equal(rgb, np.broadcast_to(np.array(expected, np.uint8), (8, 8, 3)))


def test_pictures_are_decoded_once(tmp_path, monkeypatch):
    for n in (1, 2, 3):
        write(tmp_path / f"a.{n}.png", grey(n))
    decoded: list[int] = []
    decode = cv2.imdecode
    monkeypatch.setattr(cv2, "imdecode", lambda *args: decoded.append(1) or decode(*args))
    media = open_media(tmp_path)
    for times in (1, 2):  # the first was needed for the size
        assert [f.rgb[0, 0, 0] for f in media.frames() if f.rgb is not None] == [1, 2, 3]
        assert len(decoded) == 3 * times


def test_exif_orientation_is_undone(tmp_path):
    media = open_media(photo(tmp_path / "phone.jpg", tiff_block(6), 20, 12))
    assert (media.width, media.height, media.source.orientation) == (12, 20, 6)
    assert [f.rgb.shape for f in media.frames() if f.rgb is not None] == [(20, 12, 3)]


@pytest.mark.parametrize("pattern", ["shot.%04d.png", "shot.####.png", "shot.*.png", "shot.%d.png"])
def test_patterns_use_the_numbers_in_the_names(tmp_path, pattern):
    for n in (99, 100, 101, 103):
        write(tmp_path / f"shot.{n:04d}.png", grey(n))
    write(tmp_path / "other.0099.png")
    (tmp_path / "shot.notes.txt").write_text("x")
    source = str(tmp_path / pattern)
    assert numbers(source) == [99, 100, 101, 103]
    assert numbers(source, "100-103:3") == [100, 103]
    media = open_media(source)
    assert media.source.kind == "sequence"
    assert media.source.name == "shot"
    assert [round(f.time * 24) for f in media.frames()] == [0, 1, 2, 4]


def test_number_of_a_pattern_need_not_be_the_last(tmp_path):
    folder = tmp_path / "shots [final]"
    for n in (1001, 1002):
        write(folder / f"hand_{n}_v2.png", grey(n % 255))
    assert numbers(str(folder / "hand_%04d_v2.png"), "1001-1002") == [1001, 1002]
    assert numbers(str(folder / "hand_1002_v%d.png")) == [2]
    assert numbers(str(folder / "hand_*.png")) == [1, 2]  # a glob says nothing of numbers


def test_numbers_of_frames(tmp_path):
    """Numbers that the user names may have gaps but no doubles; a folder's are those of one sequence; a time
    is no number."""
    for name in ("shot.0001.png", "shot.0500.png"):
        write(tmp_path / "gap" / name)
    assert numbers(str(tmp_path / "gap" / "shot.%04d.png")) == [1, 500]
    write(tmp_path / "gap" / "shot.1.png")
    assert numbers(str(tmp_path / "gap" / "shot.%04d.png")) == [1, 2, 3]
    for time in ("120001234", "120101234", "120201234"):
        write(tmp_path / "times" / f"PXL_20240501_{time}.png")
    assert numbers(tmp_path / "times") == [1, 2, 3]
    assert sequence_numbers(sorted((tmp_path / "times").iterdir())) is None
    folder = tmp_path / "folder"
    for name in ("b10.png", "b9.png", "b11.png"):
        write(folder / name)
    assert numbers(folder) == [9, 10, 11]
    assert numbers([folder / "b11.png", folder / "b9.png"]) == [9, 11]
    other = write(folder / "手 übung.png")
    assert numbers(folder) == [9, 10, 11]
    assert numbers([*folder.iterdir()]) == [1, 2, 3, 4]
    assert open_media([other]).source.kind == "photo"


SERIES: dict[str, tuple[str, list[int], str]] = {
    "masks": (
        "f_0001.png f_0001_mask.png f_0002.png f_0002_mask.png",
        [1, 2],
        "first of the longest is read, f_0001.png to f_0002.png; 2 files are left out: "
        "f_0001_mask.png to f_0002_mask.png (2)",
    ),
    "a cover": ("cover.png f_1.png f_2.png f_3.png", [1, 2, 3], "1 file is left out: cover.png"),
    "two formats": ("f_1.jpg f_2.jpg f_2.png f_3.jpg", [1, 2, 3], "1 file is left out: f_2.png"),
    "more photos than frames": ("a.png b.png c.png f_1.png f_2.png", [1, 2, 3, 4, 5], ""),
    "other kinds": (
        "f_1.png f_2.png a.cr2 b.cr2 c.txt .hidden take.npz",
        [1, 2],
        "3 files are left out: 2 .cr2, 1 .txt",
    ),
    "signed": ("f_-002.png f_-001.png f_0000.png f_0001.png", [-2, -1, 0, 1], ""),
    "signed, without a mark": ("f-001.png f0000.png f0001.png", [-1, 0, 1], ""),
    "a dash": ("f-001.png f-002.png f-003.png", [1, 2, 3], ""),
    "odd names": ("[v2] 100%done #3 手_1.png [v2] 100%done #3 手_2.png", [1, 2], ""),
}


@pytest.mark.parametrize(("names", "expected", "said"), SERIES.values(), ids=SERIES)
def test_one_series_of_a_folder_is_read(tmp_path, caplog, names, expected, said):
    """In a folder whose name could be a pattern; a batch groups as a capture does."""
    folder = tmp_path / "100%d [v2] #3 手"
    for name in re.findall(r"\S.*?\.\w+(?= |$)", names):
        if name.endswith(("png", "jpg")):
            write(folder / name)
        else:
            (folder / name).touch()
    with caplog.at_level(logging.WARNING, "handfit"):
        assert numbers(folder) == expected
    assert [record.message.endswith(said) and str(folder) in record.message for record in caplog.records] == (
        [True] if said else []
    )
    batch = [each.source for each in expand(str(folder))]
    assert [len(each) for each in batch] == ([1] * 5 if "c.png" in names else [len(expected)])


def test_patterns_with_odd_signs(tmp_path):
    folder = tmp_path / "50%done [a] #1"
    for name in ("take #3 100%done_-001.png", "take #3 100%done_0000.png", "[b]_7.png", "%04d.png"):
        write(folder / name)
    assert numbers(folder / "take #3 100%done_%04d.png") == [-1, 0]
    assert numbers(folder / "take #3 100%done_####.png", "0-3") == [0]
    assert numbers(folder / "[b]_*.png") == [1]
    assert open_media(folder / "%04d.png").source.kind == "photo"
    assert [n for n, _ in numbered_like(folder / "take #3 100%done_0000.png")] == [-1, 0]


def test_pictures_and_ranges_that_do_not_fit(tmp_path, caplog):
    for number, size in ((1, 12), (2, 12), (3, 30), (4, 12)):
        write(tmp_path / f"a{number}.png", grey(1, size))
    (tmp_path / "a2.png").write_bytes(b"not a picture")
    with caplog.at_level(logging.WARNING, "handfit"):
        assert [f.rgb is None for f in open_media(tmp_path).frames()] == [False, True, True, False]
    assert "a2.png: this is a text; choose a photo or a video; frame 2 is left empty" in caplog.text
    assert "is 20 x 30 pixels, and the first picture 20 x 12; frame 3 is left empty" in caplog.text
    with pytest.raises(InputError, match="its frames are 1-4"):
        open_media(tmp_path, FrameRange.parse("7-9"))


BAD: dict[str, tuple[list[str], str]] = {
    "missing": (["missing.jpg"], "no such file"),
    "zero bytes": (["empty.jpg"], "empty"),
    "not a video": (["text.mp4"], "text.mp4: this is a text"),
    "unknown kind": (["text.xyz"], "text.xyz: this is a text"),
    "no pictures": (["nothing"], "no pictures"),
    "damaged": (["cut.png"], "a PNG picture that is cut off"),
    "a video in a folder": (["clips"], "no pictures in it, but 1 .mp4"),
    "no match": (["x.%04d.png"], "no file matches"),
    "a line break": (["a\nb.jpg"], r"a\\nb.jpg': there is no such file"),
    "surrogate": (["a\ud800b.jpg"], r"'a\\ud800b.jpg': there is no such file"),
    "too long in a list": (["cut.png", "x" * 300], "cannot be opened|no such file"),
    "missing in a list": (["cut.png", "gone.png"], "no such file"),
    "empty list": ([], "no pictures"),
}


@pytest.mark.parametrize(("source", "words"), BAD.values(), ids=BAD)
def test_bad_input_is_one_line(source, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("empty.jpg").touch()
    for name in ("text.jpg", "text.mp4", "text.xyz"):
        Path(name).write_text("this is a text")
    Path("nothing").mkdir()
    Path("clips").mkdir()
    Path("clips/a.mp4").touch()
    Path("cut.png").write_bytes(cv2.imencode(".png", grey(3))[1].tobytes()[:20])
    with pytest.raises(InputError, match=words) as caught:
        open_media(source[0] if len(source) == 1 else source)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 600


@pytest.mark.skipif(sys.platform != "linux", reason="only there are names any bytes")
def test_a_video_whose_name_is_no_text_is_read(tmp_path):
    path = tmp_path / "\udcff.mp4"
    clip(tmp_path / "good.mp4", frames=5)
    (tmp_path / "good.mp4").rename(path)
    assert len(list(open_media(path).frames())) == 5
