"""Single frames of a video, read and sought."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from handfit_core.common.errors import InputError
from handfit_core.media import videos
from handfit_core.media.source import Wanted
from handfit_core.media.videos import Video

COUNT = 60


@pytest.fixture(params=["mp4v", "MJPG", "samples"])
def video(request: pytest.FixtureRequest, tmp_path: Path) -> Video:
    if request.param == "samples":  # with frames that are stored in another order than they are seen
        return Video(request.getfixturevalue("samples") / "videos" / "gestures_long.mp4", Wanted())
    path = tmp_path / ("clip.mp4" if request.param == "mp4v" else "clip.avi")
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*request.param), 25.0, (64, 48))
    for number in range(COUNT):
        picture = np.full((48, 64, 3), 20, dtype=np.uint8)
        picture[:, number : number + 4] = 230
        writer.write(picture)
    writer.release()
    return Video(path, Wanted())


def test_frames_are_the_same_read_and_sought(video, monkeypatch):
    true = {frame.number: frame.rgb for frame in video.frames(0, 90) if frame.rgb is not None}
    count = sum(1 for _ in video.frames())
    for min_frames in (10_000, 0):
        monkeypatch.setattr(videos, "MEDIA", replace(videos.MEDIA, min_seek_frames=min_frames))
        for numbers in ([1], [2, 3, 40], [57, 58], [1, count - 1, count]):
            found = list(video.pictures(numbers, count))
            assert len(found) == len(numbers)
            for number, picture in zip(numbers, found, strict=True):
                assert picture is not None
                assert number not in true or np.array_equal(picture, true[number])
    first, behind = video.pictures([count, count + 5], count)
    assert first is not None
    assert behind is None


def test_where_packets_are_no_frames_it_is_read(video, monkeypatch):
    """A take that ends before the video does, a video that has lost packets, times that are no frame's."""
    monkeypatch.setattr(videos, "MEDIA", replace(videos.MEDIA, min_seek_frames=0))
    true = [frame.rgb for frame in video.frames(0, 50)]
    times = videos._times(video._name)
    for told in (times, times[1:], times + 7.0, np.empty(0)):
        monkeypatch.setattr(videos, "_times", lambda _, told=told: told)
        for picture, number in zip(video.pictures([5, 31, 50], 59), (5, 31, 50), strict=True):
            np.testing.assert_array_equal(picture, true[number - 1])


def with_delays(data: bytes, delays: list[tuple[int, int]]) -> bytes:
    """An MP4, its index behind its pictures, whose frames follow each other after other times: (frames,
    factor of the first one's delay)."""
    boxes, at, end = [], 0, len(data)
    for name in (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stts"):
        while data[at + 4 : at + 8] != name:
            at += int.from_bytes(data[at : at + 4], "big")
            assert at < end
        boxes.append(at)
        at += 8
    (size, delay) = (int.from_bytes(data[a : a + 4], "big") for a in (boxes[-1], at + 12))
    table = b"".join(n.to_bytes(4, "big") + (delay * by).to_bytes(4, "big") for n, by in delays)
    new = bytearray(data[: at + 4] + len(delays).to_bytes(4, "big") + table + data[boxes[-1] + size :])
    for box in boxes:
        old = int.from_bytes(new[box : box + 4], "big")
        new[box : box + 4] = (old + 16 + len(table) - size).to_bytes(4, "big")
    return bytes(new)


@pytest.mark.parametrize(("delays", "steady"), [([(40, 1)], True), ([(20, 1), (20, 2)], False)])
def test_a_changing_rate_is_noticed(tmp_path, delays, steady):
    path = tmp_path / "clip.mp4"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 30.0, (64, 48))
    for number in range(40):
        writer.write(np.full((48, 64, 3), 6 * number, dtype=np.uint8))
    writer.release()
    path.write_bytes(with_delays(path.read_bytes(), delays))
    media = Video(path, Wanted())
    if steady:
        media.check_steady()
        assert media.fps == pytest.approx(30.0)
        return
    with pytest.raises(InputError, match="frame rate changes"):
        media.check_steady()
