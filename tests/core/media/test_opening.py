import logging
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from handfit_core.errors import InputError
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.opening import open_media, sequence_numbers
from handfit_core.media.pictures import read_picture
from tests.bombs import clip
from tests.core.media.test_exif import photo, tiff_block


def write(path: Path, pixels: np.ndarray) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(cv2.imencode(path.suffix, pixels)[1].tobytes())
    return path


def grey(value: int, height: int = 12, width: int = 20) -> np.ndarray:
    return np.full((height, width, 3), value, dtype=np.uint8)


@pytest.fixture
def video(tmp_path: Path) -> Path:
    clip(tmp_path / "clip.mp4", frames=12)
    return tmp_path / "clip.mp4"


def numbers(source, frames: str | None = None) -> list[int]:
    media = open_media(source, FrameRange.parse(frames) if frames else None)
    found = [f.number for f in media.frames()]
    assert media.expected_frames == len(found)
    return found


def test_photo(tmp_path: Path) -> None:
    path = write(tmp_path / "a.png", np.dstack([grey(0)[..., 0], grey(0)[..., 0], grey(200)[..., 0]]))
    media = open_media(path)
    (frame,) = media.frames()
    assert (media.source.kind, media.width, media.height, media.fps) == ("photo", 20, 12, 24.0)
    assert frame.number == 1
    assert frame.rgb is not None
    np.testing.assert_array_equal(frame.rgb[0, 0], [200, 0, 0])  # RGB, not BGR
    assert media.source.name == "a"
    assert list(media.source.files) == [str(path.resolve())]


@pytest.mark.parametrize(
    ("pixels", "expected"),
    [
        (np.full((8, 8), 77, np.uint8), [77, 77, 77]),
        (np.full((8, 8), 77 * 257, np.uint16), [77, 77, 77]),
        (np.full((8, 8, 3), (10 * 257, 20 * 257, 30 * 257), np.uint16), [30, 20, 10]),
        (np.full((8, 8, 4), (10, 20, 30, 255), np.uint8), [30, 20, 10]),
        (np.full((8, 8, 4), (10, 20, 30, 0), np.uint8), [128, 128, 128]),
        (np.full((8, 8, 4), (0, 100, 255, 51), np.uint8), [153, 122, 102]),
        (np.full((8, 8, 4), (0, 0, 65535, 65535), np.uint16), [255, 0, 0]),
    ],
    ids=["grey", "grey16", "rgb16", "opaque", "transparent", "half", "rgba16"],
)
def test_depths_and_channels(tmp_path: Path, pixels: np.ndarray, expected: list[int]) -> None:
    rgb, orientation = read_picture(write(tmp_path / "a.png", pixels))
    assert orientation == 1
    assert rgb.dtype == np.uint8
    np.testing.assert_array_equal(rgb, np.broadcast_to(np.array(expected, np.uint8), (8, 8, 3)))


def test_pictures_are_decoded_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for n in (1, 2, 3):
        write(tmp_path / f"a.{n}.png", grey(n))
    decoded: list[int] = []
    decode = cv2.imdecode
    monkeypatch.setattr(cv2, "imdecode", lambda *args: decoded.append(1) or decode(*args))
    media = open_media(tmp_path)
    first = [f.rgb for f in media.frames()]
    assert len(decoded) == 3  # the first was needed for the size
    again = [f.rgb for f in media.frames()]
    assert len(decoded) == 6
    np.testing.assert_array_equal(np.array(first), np.array(again))


def test_exif_orientation_is_undone(tmp_path: Path) -> None:
    media = open_media(photo(tmp_path / "phone.jpg", tiff_block(6, "<"), 20, 12))
    assert (media.width, media.height, media.source.orientation) == (12, 20, 6)
    (frame,) = media.frames()
    assert frame.rgb is not None
    assert frame.rgb.shape == (20, 12, 3)


@pytest.mark.parametrize("pattern", ["shot.%04d.png", "shot.####.png", "shot.*.png", "shot.%d.png"])
def test_patterns_use_the_numbers_in_the_names(tmp_path: Path, pattern: str) -> None:
    for n in (99, 100, 101, 103):
        write(tmp_path / f"shot.{n:04d}.png", grey(n))
    write(tmp_path / "other.0099.png", grey(1))
    (tmp_path / "shot.notes.txt").write_text("x")
    source = str(tmp_path / pattern)
    assert numbers(source) == [99, 100, 101, 103]
    assert numbers(source, "100-103:3") == [100, 103]
    media = open_media(source)
    assert media.source.kind == "sequence"
    assert media.source.name == "shot"
    assert [round(f.time * 24) for f in media.frames()] == [0, 1, 2, 4]


def test_number_of_a_pattern_need_not_be_the_last(tmp_path: Path) -> None:
    folder = tmp_path / "shots [final]"
    for n in (1001, 1002):
        write(folder / f"hand_{n}_v2.png", grey(n % 255))
    assert numbers(str(folder / "hand_%04d_v2.png"), "1001-1002") == [1001, 1002]
    assert numbers(str(folder / "hand_1002_v%d.png")) == [2]
    assert numbers(str(folder / "hand_*.png")) == [1, 2]  # a glob says nothing of numbers


def test_numbers_that_the_user_names_may_have_gaps_but_no_doubles(tmp_path: Path) -> None:
    for name in ("shot.0001.png", "shot.0500.png"):
        write(tmp_path / name, grey(1))
    assert numbers(str(tmp_path / "shot.%04d.png")) == [1, 500]
    write(tmp_path / "shot.1.png", grey(1))
    assert numbers(str(tmp_path / "shot.%04d.png")) == [1, 2, 3]  # frame 1 twice: counted instead


def test_photos_named_by_the_time_are_no_frames(tmp_path: Path) -> None:
    for name in ("PXL_20240501_120001234", "PXL_20240501_120101234", "PXL_20240501_120201234"):
        write(tmp_path / f"{name}.png", grey(1))
    assert numbers(tmp_path) == [1, 2, 3]
    assert sequence_numbers(sorted(tmp_path.iterdir())) is None


def test_folder_and_list(tmp_path: Path) -> None:
    for name in ("b10.png", "b9.png", "b11.png"):
        write(tmp_path / name, grey(1))
    assert numbers(tmp_path) == [9, 10, 11]
    assert numbers([tmp_path / "b11.png", tmp_path / "b9.png"]) == [9, 11]
    write(tmp_path / "zebra.png", grey(1))
    assert numbers(tmp_path) == [1, 2, 3, 4]  # no longer one numbered sequence
    assert open_media([tmp_path / "zebra.png"]).source.kind == "photo"


def test_video(video: Path) -> None:
    media = open_media(video)
    frames = list(media.frames())
    assert (media.fps, media.width, media.height) == (25.0, 64, 48)
    assert [f.number for f in frames] == list(range(1, 13))
    assert frames[5].time == pytest.approx(5 / 25)
    levels = [float(f.rgb.mean()) for f in frames if f.rgb is not None]
    np.testing.assert_allclose(levels, [20 * i for i in range(12)], atol=4)
    assert numbers(video, "3-8:2") == [3, 5, 7]
    picked = list(open_media(video, FrameRange.parse("7")).frames())
    assert picked[0].rgb is not None
    assert float(picked[0].rgb.mean()) == pytest.approx(120, abs=4)


def test_truncated_video_warns(video: Path, caplog: pytest.LogCaptureFixture, tmp_path: Path) -> None:
    # An .avi keeps its index at the end but can be read from the front.
    whole = tmp_path / "clip.avi"
    writer = cv2.VideoWriter(str(whole), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (64, 48))
    rng = np.random.default_rng(0)
    for _ in range(60):
        writer.write(rng.integers(0, 255, (48, 64, 3), dtype=np.uint8))
    writer.release()
    data = whole.read_bytes()
    whole.write_bytes(data[: int(len(data) * 0.6)])
    with caplog.at_level(logging.WARNING, "handfit"):
        found = [f.number for f in open_media(whole).frames()]
    assert 10 <= len(found) < 60
    assert "breaks off after frame" in caplog.text


def test_unreadable_picture_in_a_sequence_is_an_empty_frame(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for n in (1, 2, 3):
        write(tmp_path / f"a{n}.png", grey(1))
    (tmp_path / "a2.png").write_bytes(b"not a picture")
    with caplog.at_level(logging.WARNING, "handfit"):
        frames = list(open_media(tmp_path).frames())
    assert [f.rgb is None for f in frames] == [False, True, False]
    assert "frame 2" in caplog.text


def bad_inputs(folder: Path) -> dict[str, tuple[Path | list[Path], str]]:
    (folder / "empty.jpg").write_bytes(b"")
    (folder / "empty.mp4").write_bytes(b"")
    (folder / "text.jpg").write_text("this is a text")
    (folder / "text.mp4").write_text("this is a text")
    (folder / "text.xyz").write_text("this is a text")
    (folder / "nothing").mkdir()
    good = cv2.imencode(".png", grey(3))[1].tobytes()
    (folder / "cut.png").write_bytes(good[:20])
    return {
        "missing": (folder / "missing.jpg", "no such file"),
        "zero bytes": (folder / "empty.jpg", "empty"),
        "zero bytes video": (folder / "empty.mp4", "empty"),
        "not a picture": (folder / "text.jpg", "not a picture"),
        "not a video": (folder / "text.mp4", "not a video"),
        "unknown kind": (folder / "text.xyz", "neither a picture nor a video"),
        "no pictures": (folder / "nothing", "no pictures"),
        "damaged": (folder / "cut.png", "not a picture"),
        "no match": (folder / "x.%04d.png", "no file matches"),
        "spaces": (Path(" "), "' ': there is no such file"),
        "a line break": (folder / "a\nb.jpg", r"a\\nb.jpg': there is no such file"),
        "no such user": (Path("~nobody of that name/a.jpg"), "no such file"),
        "zero": (Path("a\0b.jpg"), r"'a\\x00b.jpg': there is no such file"),
        "surrogate": (Path("a\ud800b.jpg"), r"'a\\ud800b.jpg': there is no such file"),
        "too long": (folder / ("x" * 300), "cannot be opened|no such file"),
        "too long in a list": ([folder / "cut.png", folder / ("x" * 300)], "cannot be opened|no such file"),
        "missing in a list": ([folder / "cut.png", folder / "gone.png"], "no such file"),
        "empty list": ([], "no pictures"),
    }


def test_bad_input_is_one_line(tmp_path: Path) -> None:
    for case, (source, words) in bad_inputs(tmp_path).items():
        with pytest.raises(InputError, match=words) as caught:
            open_media(source)
        assert "\n" not in str(caught.value), case
        assert len(str(caught.value)) < 600, case


def test_mixed_sizes_are_refused(tmp_path: Path) -> None:
    write(tmp_path / "a1.png", grey(1))
    write(tmp_path / "a2.png", grey(1, 30, 30))
    with pytest.raises(InputError, match="one size"):
        list(open_media(tmp_path).frames())


def test_range_outside(tmp_path: Path, video: Path) -> None:
    write(tmp_path / "s" / "a1.png", grey(1))
    write(tmp_path / "s" / "a2.png", grey(1))
    with pytest.raises(InputError, match="its frames are 1-2"):
        open_media(tmp_path / "s", FrameRange.parse("7-9"))
    with pytest.raises(InputError, match="it has frames 1-12"):
        open_media(video, FrameRange.parse("70-"))


def test_names_that_are_not_ascii(tmp_path: Path) -> None:
    assert numbers(write(tmp_path / "手 übung.png", grey(1))) == [1]


@pytest.mark.parametrize("cut", [1, 60])
@pytest.mark.parametrize("suffix", ["png", "xyz"])
def test_jpeg_2000_never_reaches_its_decoder(tmp_path: Path, cut: int, suffix: str) -> None:
    """OpenCV crashes on damaged ones, by whatever name they come."""
    whole = cv2.imencode(".jp2", np.zeros((48, 64, 3), np.uint8))[1].tobytes()
    path = tmp_path / f"a.{suffix}"
    path.write_bytes(whole[:-cut])
    with pytest.raises(InputError, match=r"not a picture|neither a picture"):
        open_media(path)


@pytest.mark.skipif(sys.platform != "linux", reason="only there are names any bytes")
def test_a_video_whose_name_is_no_text_never_reaches_opencv(tmp_path: Path) -> None:
    """Which ends the process on such names."""
    path = tmp_path / "\udcff.mp4"
    clip(tmp_path / "good.mp4")
    (tmp_path / "good.mp4").rename(path)
    with pytest.raises(InputError, match="rename the file"):
        open_media(path)
