"""A clip in chunks: joined without a seam, the same from any number of threads."""

import os
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from handfit_core.capturing.detection import detect_frames
from handfit_core.capturing.options import CaptureOptions
from handfit_core.common.arrays import arrays_of
from handfit_core.detect import chunks, sharing
from handfit_core.detect.chunks import Chunk
from handfit_core.detect.detector import DETECTORS, Detected
from handfit_core.detect.shot_boundary import Thumbnail
from handfit_core.media import pictures, source
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.opening import open_media
from handfit_core.media.pictures import read_picture
from tests.core.detect.clips import SAMPLE, picture, write_two_hands

pytestmark = pytest.mark.usefixtures("landmark_model")

DRAFT = CaptureOptions(FrameRange(31, 90), quality="draft")
"""Frames of the clip in which the second hand comes and goes"""


@pytest.fixture(scope="module", autouse=True)
def short_chunks() -> Iterator[None]:
    """Chunks of 24 frames, so that a short clip has seams."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (source, sharing):
            patch.setattr(module, "MEDIA", replace(source.MEDIA, chunk_frames=24))
        yield


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("clip") / "two.mp4"
    write_two_hands(path)
    return path


def assert_same(a: Detected, b: Detected) -> None:
    """Bit for bit."""
    assert (a.numbers, a.most_seen) == (b.numbers, b.most_seen)
    arrays = arrays_of(b.hands)
    assert arrays_of(a.hands).keys() == arrays.keys()
    for name, array in arrays.items():
        np.testing.assert_array_equal(getattr(a.hands, name), array)


def counts_of(found: Detected) -> np.ndarray:
    """(T,) hands in each frame."""
    return np.bincount(found.hands.frame, minlength=len(found.numbers))


@pytest.fixture(scope="module")
def alone(clip: Path) -> Detected:
    return detect_frames(open_media(clip, DRAFT.frames), replace(DRAFT, processes=1))


def test_hands_are_tracked_over_seams(alone):
    counts = counts_of(alone)
    assert counts.min() == 1
    there = np.array([40 <= i < 80 for i in range(30, 90)])
    assert (counts == 1 + there).mean() > 0.95
    assert alone.cuts == ()
    assert alone.most_seen == 2


def test_any_number_of_threads_finds_the_same(clip, alone):
    progress: list[int] = []
    found = detect_frames(open_media(clip, DRAFT.frames), replace(DRAFT, processes=3), progress.append)
    assert_same(found, alone)
    assert progress == sorted(set(progress))
    assert progress[-1] == 60
    some = [replace(DRAFT, frames=FrameRange(31, 90, 2), processes=n) for n in (1, 2)]
    parts = [detect_frames(open_media(clip, each.frames), each) for each in some]
    assert parts[0].numbers == list(range(31, 91, 2))
    assert_same(*parts)


@pytest.mark.parametrize("claimed", [0, 30, 1000])
def test_a_header_that_is_wrong_about_the_length(clip, alone, claimed):
    media = open_media(clip, DRAFT.frames)
    # Chunks stay as long as they are.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(type(media), "chunk_frames", media.chunk_frames)
        media.expected_frames = claimed
        assert_same(detect_frames(media, replace(DRAFT, processes=2)), alone)


def test_runs_are_even_and_bounded():
    def dealt(chunks: int, threads: int) -> list[int]:
        """The first chunks of the runs."""
        return [next(iter(run)) for run in islice(sharing._runs(chunks, threads), 8)]

    assert dealt(6, 2) == [0, 3]
    assert dealt(10, 2) == [0, 4, 8, 9]
    assert dealt(4, 4) == [0, 1, 2, 3]
    assert dealt(100, 2) == list(range(0, 32, 4))
    assert dealt(0, 2) == list(range(8))


def test_an_error_in_another_thread_is_raised_here(tmp_path, monkeypatch):
    def read(path: Path, **options: Any) -> tuple[np.ndarray, int]:
        if path.name == "a.0040.png":
            raise MemoryError(path.name)
        return read_picture(path, **options)

    for i in range(50):
        cv2.imwrite(str(tmp_path / f"a.{i:04}.png"), np.zeros((64, 64, 3), dtype=np.uint8))
    monkeypatch.setattr(pictures, "read_picture", read)
    with pytest.raises(MemoryError, match=r"a\.0040\.png"):
        detect_frames(open_media(tmp_path), CaptureOptions(processes=3))


def test_stopping_keeps_the_frames_before_the_first_gap(clip, alone):
    stopped = False

    def on_frame(done: int) -> None:
        nonlocal stopped
        stopped = done > 30

    options = replace(DRAFT, processes=2)
    found = detect_frames(open_media(clip, DRAFT.frames), options, on_frame, lambda: stopped)
    assert found.numbers == list(range(31, len(found.numbers) + 31))
    assert 0 < len(found.numbers) < 60
    assert np.array_equal(found.hands.keypoints[0], alone.hands.keypoints[0])


def test_another_shot_starts_anew(tmp_path):
    """The hand is where one was before, and is no continuation of it."""
    other = cv2.imread(str(SAMPLE / "hand.0001.jpg"))
    assert other is not None
    shots = [picture(0)[..., ::-1]] * 6, [255 - other[::-1]] * 5, [picture(3)[:, ::-1, ::-1]] * 6
    for i, bgr in enumerate(frame for shot in shots for frame in shot):
        cv2.imwrite(str(tmp_path / f"a.{i:04}.png"), bgr)
    found = detect_frames(open_media(tmp_path), CaptureOptions(processes=1))
    assert found.cuts == (6, 11)
    assert counts_of(found)[:6].tolist() == [1] * 6
    assert counts_of(found)[11:].tolist() == [1] * 6


def test_motion_and_light_are_no_shot_boundaries():
    thumbnails = [Thumbnail.of(picture(number)) for number in range(24)]
    thumbnails.append(Thumbnail.of(np.clip(picture(23) * 1.5 + 30, 0, 255).astype(np.uint8)))
    assert not any(b.is_cut_from(a) for a, b in pairwise(thumbnails))
    assert Thumbnail.of(255 - picture(1)).is_cut_from(thumbnails[0])


def test_how_many_threads(monkeypatch):
    cases = (1, 1000, 1), (5, 1000, 5), (5, 25, 2), (5, 24, 1), (3, 0, 3)
    for asked, frames, expected in cases:
        assert sharing.thread_count(asked, frames) == expected
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    for cores, expected in ((1, 1), (2, 2), (5, 5), (64, sharing.MAX_THREADS)):
        monkeypatch.setattr(os, "sched_getaffinity", lambda _, cores=cores: range(cores), raising=False)
        assert sharing.thread_count(None, 10_000) == expected
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    assert sharing.thread_count(None, 10_000) == 3


def test_other_threads_use_the_named_detector(clip, monkeypatch):
    class Blind(chunks.ClipDetector):
        def chunk(self, index: int, *_: object) -> Chunk:
            numbers = [7 + index] * (self.media.chunk_frames if index < 2 else 1)
            return Chunk(numbers, [()] * len(numbers), [], [3], [], None, None, int(index < 2))

    blind = replace(DETECTORS.get("direct"), clip=Blind)
    monkeypatch.setitem(DETECTORS._parts, "direct", blind)
    found = detect_frames(open_media(clip), CaptureOptions(processes=3))
    assert (sorted(set(found.numbers)), found.most_seen, found.missed) == ([7, 8, 9], 3, True)
