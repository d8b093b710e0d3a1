"""Clips as phones, cameras and studios write them: upright, with square pixels, by their time stamps."""

import logging
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from handfit_core.common.errors import InputError
from handfit_core.media.decoding import Reading
from handfit_core.media.exif import upright
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.opening import open_media
from handfit_core.media.source import Wanted
from handfit_core.media.videos import Video
from tests.clips import written_clip

SIZE = 64, 48


def grey(number: int) -> np.ndarray:
    """A picture (48, 64, 3) of that frame, with a bright corner at the top left."""
    picture = np.full((SIZE[1], SIZE[0], 3), 8 + 4 * number, dtype=np.uint8)
    picture[:16, :16] = 255
    return picture


def shown(media) -> list[int | None]:
    """Of each frame the number of the picture that it has; None for one without its own."""
    pictures = [frame.rgb for frame in media.frames()]
    middle = (slice(24, 40), slice(24, 40))
    return [None if rgb is None else round((float(rgb[middle].mean()) - 8) / 4) for rgb in pictures]


@pytest.mark.parametrize(
    ("name", "codec"),
    [
        ("a.mp4", "libx264"),
        ("a.mov", "prores_ks"),
        ("a.mp4", "libsvtav1"),
        ("a.avi", "mjpeg"),
        ("a.mkv", "libx265"),
        ("a.gif", "gif"),
    ],
)
def test_codecs(tmp_path, name, codec):
    media = open_media(written_clip(tmp_path / name, [grey(4 * n) for n in range(12)], codec=codec))
    assert (media.width, media.height, media.fps, media.expected_frames) == (*SIZE, 25.0, 12)
    assert np.abs(np.array(shown(media)) - 4 * np.arange(12)).max() <= 1
    assert media.source.kind == "video"
    with pytest.raises(InputError, match="it has frames 1-12"):
        open_media(tmp_path / name, FrameRange.parse("70-"))


def test_colors_of_a_clip_with_as_many_as_pixels(tmp_path):
    """Odd widths have padding behind each row."""
    rgb = np.zeros((48, 61, 3), dtype=np.uint8)
    rgb[:, :20], rgb[:, 20:40], rgb[:, 40:] = (200, 40, 30), (30, 180, 60), (20, 50, 220)
    with av.open(str(tmp_path / "a.mkv"), "w") as output:
        stream = output.add_stream("ffv1", rate=25)
        stream.width, stream.height, stream.pix_fmt = 61, 48, "yuv444p"
        picture = av.VideoFrame.from_ndarray(rgb, format="rgb24")
        output.mux([*stream.encode(picture), *stream.encode(None)])
    (frame,) = open_media(tmp_path / "a.mkv").frames()
    assert frame.rgb is not None
    np.testing.assert_allclose(frame.rgb.astype(int), rgb, atol=4)


def test_an_animated_webp(tmp_path):
    animation = cv2.Animation()
    animation.frames = [np.full((48, 64, 3), 8 + 4 * n, dtype=np.uint8) for n in (1, 5, 9, 13)]
    animation.durations = np.array([100, 100, 200, 100])
    cv2.imwriteanimation(str(tmp_path / "a.webp"), animation)
    media = Video(tmp_path / "a.webp", Wanted())
    assert (media.fps, media.expected_frames) == (10.0, 5)
    assert shown(media) == [1, 5, 9, None, 13]


def test_frames_that_an_edit_list_hides_are_none(tmp_path):
    path = written_clip(tmp_path / "a.mp4", [grey(n) for n in range(30)], trimmed=12)
    media = open_media(path)
    assert media.expected_frames == 18
    assert shown(media) == list(range(12, 30))


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_display_matrix_is_undone(tmp_path, orientation):
    path = written_clip(tmp_path / "a.mp4", [grey(n) for n in range(3)], orientation=orientation)
    media = open_media(path)
    assert media.source.orientation == orientation
    expected = upright(grey(1), orientation)
    assert (media.height, media.width) == expected.shape[:2]
    rgb = list(media.frames())[1].rgb
    assert rgb is not None
    assert np.abs(rgb.astype(int) - expected).mean() < 6


@pytest.mark.parametrize(
    ("aspect", "size"),
    [((2, 1), (128, 48)), ((1, 2), (64, 96)), ((1, 1000), SIZE), ((1001, 1000), SIZE)],
)
def test_pixels_are_square(tmp_path, aspect, size):
    path = written_clip(tmp_path / "a.mp4", [grey(0)] * 3, aspect=Fraction(*aspect))
    media = open_media(path)
    assert (media.width, media.height) == size
    assert all(frame.rgb is not None and frame.rgb.shape[:2] == size[::-1] for frame in media.frames())


STEADY = list(range(30))


@pytest.mark.parametrize(
    ("times", "expected"),
    [
        # A phone in bad light: half as many pictures in the second half
        ([30, 32, 34, 36], [30, None, 31, None, 32, None, 33]),
        # Of those that come too fast the last one is shown.
        ([30, 30.5, 30.7, 31, 32], [30, 33, 34]),
        ([30, 31.02, 32, 33], [30, None, 32, 33]),
        ([30, 30, 30, 31], [32, 33]),
        ([30, 2000, 2001], [30]),
    ],
)
def test_pictures_lie_at_their_times(tmp_path, times, expected, caplog):
    times = [*STEADY, *times]
    media = open_media(written_clip(tmp_path / "a.mkv", [grey(n) for n in range(len(times))], times=times))
    assert media.fps == pytest.approx(25.0)
    assert shown(media) == [*STEADY, *expected]
    assert caplog.text.count("no picture follows for") == (times[-1] > 1000)


def test_parts_are_the_frames_of_the_whole(tmp_path):
    path = written_clip(tmp_path / "a.mp4", [grey(n) for n in range(30)], times=[1.5 * n for n in range(30)])
    whole = list(open_media(path).frames())
    media = open_media(path)
    parts = [*media.frames(0, 10), *media.frames(10, 10), *media.frames(20)]
    assert [frame.number for frame in parts] == [frame.number for frame in whole]
    for one, other in zip(parts, whole, strict=True):
        assert np.array_equal(one.rgb, other.rgb)
    again = list(media.frames(5, 10))  # from the beginning again
    assert all(np.array_equal(one.rgb, other.rgb) for one, other in zip(again, whole[5:15], strict=True))
    assert whole[9].time == pytest.approx(9 / media.fps)
    some = list(open_media(path, FrameRange.parse("4-20:3")).frames())
    assert [frame.number for frame in some] == [4, 7, 10, 13, 16, 19]
    assert all(np.array_equal(frame.rgb, whole[frame.number - 1].rgb) for frame in some)


def test_a_clip_is_opened_once_and_released(tmp_path, monkeypatch):
    path = written_clip(tmp_path / "a.mp4", [grey(n) for n in range(8)])
    files, opening = [], av.open
    monkeypatch.setattr(
        av, "open", lambda file, *rest, **more: files.append(file) or opening(file, *rest, **more)
    )
    media = open_media(path)
    for times in (1, 2):
        assert shown(media) == list(range(8))
        assert len(files) == times
    media = open_media(path)
    assert not files[-1].closed
    del media  # whoever only asks for the size reads no frames
    assert all(file.closed for file in files)


@pytest.mark.parametrize("sought", [False, True])
def test_single_pictures_are_those_that_are_shown(tmp_path, monkeypatch, sought):
    from dataclasses import replace

    from handfit_core.media import videos

    if sought:
        monkeypatch.setattr(videos, "MEDIA", replace(videos.MEDIA, min_seek_frames=0))
    path = written_clip(
        tmp_path / "a.mp4", [grey(n) for n in range(60)], times=[n + n // 30 for n in range(60)]
    )
    media = open_media(path)
    true = {frame.number: frame.rgb for frame in media.frames()}
    numbers = [1, 2, 3, 31, 40, 61, 70]
    for number, picture in zip(numbers, media.pictures(numbers), strict=True):
        if number == 31:  # on which the one before is shown again
            number = 30
        if number == 70:
            assert picture is None
        else:
            assert np.array_equal(picture, true[number])


@pytest.mark.parametrize(
    ("name", "codec", "sought"),
    [
        ("a.mp4", "libx264", True),
        ("a.mov", "libx265", True),
        ("a.avi", "mpeg4", True),
        ("a.ts", "libx264", False),
        ("a.mpg", "mpeg2video", False),
    ],
)
def test_a_place_in_the_index_is_nearer(tmp_path, monkeypatch, name, codec, sought):
    """What is read from there is what reading on gives; files without an index are read on."""
    seeks: list[int] = []
    seeking = Reading.sought
    monkeypatch.setattr(Reading, "sought", lambda self, number: seeks.append(number) or seeking(self, number))
    times = [n + n // 30 for n in range(60)]
    path = written_clip(
        tmp_path / name,
        [grey(n) for n in range(60)],
        codec=codec,
        times=times if codec != "mpeg2video" else None,
        group=12,
    )
    true = list(open_media(path).frames())
    media = open_media(path)
    for first, count in (10, 3), (15, 6), (29, 10), (52, 3):
        for frame, same in zip(media.frames(first, count), true[first : first + count], strict=True):
            assert (frame.number, frame.time) == (same.number, same.time)
            assert np.array_equal(frame.rgb, same.rgb)
    assert (53 in seeks, bool(seeks)) == (sought, sought)


def test_a_size_that_changes_on_the_way(tmp_path, caplog):
    """Blender shows nothing from there on."""
    joined_clip(tmp_path / "a.mkv", SIZE, (32, 24))
    found = list(open_media(tmp_path / "a.mkv").frames())
    assert [frame.rgb is not None and frame.rgb.shape == (48, 64, 3) for frame in found] == [True] * 5
    assert "change from 64x48 to 32x24 pixels after frame 5; the clip is read up to there" in caplog.text


def joined_clip(path: Path, *sizes: Sequence[int]) -> None:
    """A clip of JPEGs, five of each size."""
    with av.open(str(path), "w", format="matroska") as output:
        stream = output.add_stream("mjpeg", rate=25)
        stream.width, stream.height, stream.pix_fmt = *sizes[0], "yuvj420p"
        for number in range(5 * len(sizes)):
            width, height = sizes[number // 5]
            data = cv2.imencode(".jpg", np.full((height, width, 3), 90, dtype=np.uint8))[1].tobytes()
            packet = av.Packet(data)
            packet.stream, packet.pts, packet.dts = stream, number, number
            packet.time_base = Fraction(1, 25)
            output.mux(packet)


def test_a_clip_that_breaks_off(tmp_path, caplog):
    path = written_clip(tmp_path / "a.mkv", [grey(n) for n in range(40)], codec="mjpeg")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with caplog.at_level(logging.WARNING):
        found = shown(open_media(path))
    assert found == list(range(len(found)))
    assert 10 < len(found) < 30
    assert "breaks off after frame" in caplog.text


def test_what_has_no_pictures(tmp_path):
    with av.open(str(tmp_path / "a.mp4"), "w") as output:
        stream = output.add_stream("aac", rate=44100)
        frame = av.AudioFrame.from_ndarray(
            np.zeros((2, 1024), dtype=np.float32), format="fltp", layout="stereo"
        )
        frame.sample_rate = 44100
        output.mux([*stream.encode(frame), *stream.encode(None)])
    with pytest.raises(InputError, match="no pictures in it, as in a sound"):
        open_media(tmp_path / "a.mp4")
