"""A clip in chunks of frames, which are detected independently and then joined.

The hands of a chunk depend on its frames alone, and what joining adds at a seam depends on both chunks. So a
clip's hands are the same whichever threads and machines have detected its chunks, and in whatever order.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from handfit_core.detect.clips import TRACKING, ClipFinder, PastFrames, PastJpegs
from handfit_core.detect.correction.corrected import with_side_judged
from handfit_core.detect.detector import DetectorSettings, InChunks, Region
from handfit_core.detect.keypoints import Detections
from handfit_core.detect.matching import is_same_hand
from handfit_core.detect.networks import Networks
from handfit_core.detect.regions import detect_frame
from handfit_core.detect.shot_boundary import Thumbnail
from handfit_core.detect.tracker import TrackedHand, extend_track
from handfit_core.media.read_ahead import read_ahead
from handfit_core.media.source import Frame, Media


@dataclass(frozen=True, eq=False)
class Chunk:
    """The hands in consecutive frames of a clip."""

    numbers: list[int]
    """Numbers of the chunk's frames in the source: `chunk_frames` of them, fewer at the clip's end"""
    frames: list[tuple[Detections, ...]]
    tracked: list[TrackedHand]
    """The hands that are followed in the chunk's last frame"""
    counts: list[int]
    """The number of hands that were seen at once, for each frame in which palms were detected in the whole
    picture"""
    cuts: list[int]
    """Rows of the chunk's frames that begin another shot, counted from 0"""
    first: Thumbnail | None
    last: Thumbnail | None
    """Thumbnail of the chunk's last readable picture, as `first` is of its first one; None where no picture
    can be read"""
    misses: int = 0
    """Number of the frames of `counts` in which another hand is likely beside those that were found"""

    @classmethod
    def of(cls, finder: ClipFinder, numbers: list[int]) -> Chunk:
        """Make a chunk of what a finder has found in the frames of these numbers."""
        first, last = (finder.thumbnails[0], finder.thumbnails[-1]) if finder.thumbnails else (None, None)
        seen = finder.frames, finder.tracked, finder.counts, finder.cuts
        return cls(numbers, *seen, first, last, finder.misses)


class ClipDetector(InChunks[Chunk]):
    """Finds the hands of one clip with MediaPipe's networks. Use it as a context manager.

    Raises LandmarkModelError when the model file is missing or damaged.
    """

    def __init__(self, media: Media, settings: DetectorSettings, regions: Sequence[Region] = ()) -> None:
        """Open the networks for a clip; `regions` are boxes in which a person sees hands."""
        self.media = media
        self._settings, self._regions = settings, regions
        self._networks = Networks(settings.landmark_model, quality=settings.quality)

    def close(self) -> None:
        """Give the networks' threads and memory back, and let go of the file."""
        self._networks.close()
        self.media.close()

    def single_threaded(self) -> None:
        """Run the networks in one thread, since other threads detect other chunks."""
        self._networks.threads = 1

    def chunk(self, index: int, on_frame: Callable[[int], None], should_stop: Callable[[], bool]) -> Chunk:
        """Detect the hands of the chunk with that index, as `InChunks.chunk` says."""
        rows = index * self.media.chunk_frames, self.media.chunk_frames
        named = self.media.numbers(*rows)
        regions = [r for r in self._regions if r.frame is None or r.frame in named]
        whole_past = any(region.frame is not None for region in regions)
        finder = ClipFinder(self._settings, self._networks, whole_past=whole_past)
        numbers: list[int] = []
        with closing(read_ahead(self.media.frames(*rows))) as frames:
            for frame in frames:
                if should_stop():
                    break
                detect_frame(finder, frame, regions, first=index == 0 and not numbers)
                numbers.append(frame.number)
                on_frame(len(numbers))
        finder.finish()
        return Chunk.of(finder, numbers)

    def joined(self, chunks: Sequence[Chunk]) -> tuple[Detections, list[int]]:
        """Join the chunks of a clip: return the hands of all its frames, with their sides judged, and the
        rows that begin another shot.

        At every seam, hands that end one chunk and do not begin the next are tracked into it, and hands that
        begin a chunk and do not end the one before are tracked back.
        """
        frames = [frame for chunk in chunks for frame in chunk.frames]
        starts = np.cumsum([0, *(len(chunk.frames) for chunk in chunks)]).tolist()
        cuts = [start + row for start, chunk in zip(starts, chunks, strict=False) for row in chunk.cuts]
        cuts += [
            start
            for start, (before, after) in zip(starts[1:], pairwise(chunks), strict=False)
            if before.last is not None and after.first is not None and after.first.is_cut_from(before.last)
        ]
        reader = _FrameReader(self.media)
        carried: list[TrackedHand] = []
        for start, end, (before, after) in zip(starts[1:], starts[2:], pairwise(chunks), strict=False):
            going, carried = [*before.tracked, *carried], []
            if start in cuts or before.last is None or after.first is None:
                continue  # another shot, or a chunk without readable frames
            new = [
                TrackedHand.of(hand, self._settings.threshold)
                for hand in after.frames[0]
                if not any(is_same_hand(hand, other.last) for other in going)
            ]
            for tracked in new:
                past = reader.back_from(start, whole=bool(tracked.last.shown.all()), cuts=cuts)
                for row, rgb in past:
                    if rgb is not None and not extend_track(self._networks, tracked, rgb, row, frames):
                        break
            carried = [t for t in going if not any(is_same_hand(t.last, hand) for hand in after.frames[0])]
            for row in range(start, end):
                if not carried or row in cuts:
                    carried = []
                    break
                rgb = reader.picture(row)
                if rgb is not None:
                    carried = [t for t in carried if extend_track(self._networks, t, rgb, row, frames)]
        return with_side_judged(Detections.of(frames)), sorted(cuts)


class _FrameReader:
    """Reads single frames of a clip once more, most of them in order."""

    def __init__(self, media: Media) -> None:
        self._media = media
        self._frames: Iterator[Frame] | None = None
        self._next = 0
        self._past = PastFrames()

    def picture(self, row: int) -> np.ndarray | None:
        """Return the picture (H, W, 3) uint8 RGB of the clip's frame with that index; None where it cannot be
        read."""
        if self._next - len(self._past) <= row < self._next:
            return list(self._past.backwards())[self._next - 1 - row]
        if self._frames is None or not self._next <= row <= self._next + TRACKING.backtrack_frames:
            self._past.clear()
            self._frames, self._next = self._media.frames(row, sys.maxsize), row
        while self._next <= row:
            frame = next(self._frames, None)
            self._past.append(None if frame is None else frame.rgb)
            self._next += 1
        return next(self._past.backwards())

    def back_from(
        self, row: int, *, whole: bool, cuts: Sequence[int]
    ) -> Iterator[tuple[int, np.ndarray | None]]:
        """Yield the rows before that one with their pictures, the last row first, back to where the shot
        begins, but no more than memory holds. With `whole` the pictures are kept as JPEGs, so that more of
        them fit."""
        begin = max((cut for cut in cuts if cut < row), default=0)
        past: PastFrames = PastJpegs()
        if whole:
            for frame in self._media.frames(begin, row - begin):
                past.append(frame.rgb)
        else:
            begin = max(begin, row - TRACKING.backtrack_frames)
            for here in range(begin, row):
                self.picture(here)
            past = self._past
        yield from zip(range(row - 1, begin - 1, -1), past.backwards(), strict=False)
