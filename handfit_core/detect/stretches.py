"""A clip in stretches of so many frames, each looked at for itself by whoever comes to it, then joined.

What is found in a stretch depends on its frames alone, and what is added where two of them meet depends on
both: so a clip's hands are the same whichever processes looked at its stretches, and in whatever order.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import islice, pairwise
from typing import Self

import numpy as np

from handfit_core.detect.clips import LOOK_BACK, ClipFinder, Followed, Packed, Past, goes_on
from handfit_core.detect.correction.corrected import with_side_judged
from handfit_core.detect.cuts import Glance
from handfit_core.detect.keypoints import HandDetection, hands_from_arrays, hands_to_arrays
from handfit_core.detect.looks import same_hand
from handfit_core.detect.networks import Networks
from handfit_core.detect.opening import settings_of
from handfit_core.detect.regions import looked_at
from handfit_core.media.frame_range import STRETCH
from handfit_core.media.read_ahead import read_ahead
from handfit_core.media.source import Frame, Media
from handfit_core.options import CaptureOptions


@dataclass(frozen=True, eq=False)
class Stretch:
    """What was found in consecutive frames of a clip."""

    numbers: list[int]
    """of the frames that there are: fewer than `STRETCH` at the clip's end"""
    frames: list[tuple[HandDetection, ...]]
    followed: list[Followed]
    """Hands that were still followed at its end"""
    counts: list[int]
    """How many hands were seen at once, where that was looked for"""
    cuts: list[int]
    """Rows that begin another shot"""
    first: Glance | None
    last: Glance | None
    """What its first and last readable pictures look like; None: there are none"""

    @classmethod
    def found_by(cls, finder: ClipFinder, numbers: list[int]) -> Stretch:
        """What was found in the frames of these numbers."""
        first, last = (finder.glances[0], finder.glances[-1]) if finder.glances else (None, None)
        return cls(numbers, finder.frames, finder.followed, finder.counts, finder.cuts, first, last)


def stretches_to_arrays(stretches: Sequence[Stretch]) -> dict[str, np.ndarray]:
    """What was found in S stretches, as `.npz` files and messages can hold it: `sizes` (S, 4) says how many
    frames, followed hands, counts and cuts each has, the others have the rows of all, one after the other."""
    whole = [s for s in stretches if s.first is not None and s.last is not None]
    glances = [[look.pixels for look in (s.first, s.last) if look is not None] for s in whole]
    sizes = [(len(s.numbers), len(s.followed), len(s.counts), len(s.cuts)) for s in stretches]
    return hands_to_arrays([h for s in stretches for h in (*s.frames, [f.last for f in s.followed])]) | {
        "sizes": np.array(sizes, dtype=np.int64).reshape(-1, 4),
        "numbers": np.array([n for s in stretches for n in s.numbers], dtype=np.int64),
        "velocity": np.array([f.velocity for s in stretches for f in s.followed]).reshape(-1, 2),
        "seen": np.array([n for s in stretches for n in s.counts], dtype=np.int64),
        "cuts": np.array([n for s in stretches for n in s.cuts], dtype=np.int64),
        "looked": np.array([s.first is not None for s in stretches], dtype=bool),
        "glances": np.array(glances, dtype=np.uint8) if whole else np.zeros((0, 2, 0, 0, 3), np.uint8),
    }


def stretches_from_arrays(arrays: Mapping[str, np.ndarray], threshold: float) -> list[Stretch]:
    """The inverse of `stretches_to_arrays`. Raises KeyError, IndexError, TypeError and ValueError where they
    do not fit together."""
    rows = {name: iter(arrays[name].tolist()) for name in ("numbers", "seen", "cuts")}
    velocities, glances = iter(arrays["velocity"]), iter(arrays["glances"])
    hands = iter(hands_from_arrays(arrays))
    found = []
    for sizes, looked in zip(arrays["sizes"].tolist(), arrays["looked"], strict=True):
        frames, followed, counts, cuts = sizes
        numbers = list(islice(rows["numbers"], frames))
        there = list(islice(hands, frames))
        ends = next(hands, None)
        if ends is None or (len(numbers), len(ends)) != (frames, followed):
            raise ValueError("its rows do not fit together")
        moving = zip(ends, islice(velocities, followed), strict=True)
        first, last = map(Glance, next(glances, ())) if looked else (None, None)
        found.append(
            Stretch(
                numbers,
                there,
                [Followed.of(hand, threshold, velocity) for hand, velocity in moving],
                list(islice(rows["seen"], counts)),
                list(islice(rows["cuts"], cuts)),
                first,
                last,
            )
        )
    return found


class ClipDetector:
    """Finds the hands of one clip with MediaPipe's networks. Use it as a context manager.

    Raises LandmarkModelError when the model file is missing or damaged.
    """

    def __init__(self, media: Media, options: CaptureOptions) -> None:
        self.media = media
        self._options = options
        self._settings = settings_of(options, video=True)
        self._networks = Networks(options.landmark_model, quality=options.quality)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Give the networks' threads and memory back, and let go of the file."""
        self._networks.close()
        self.media.close()

    def single_threaded(self) -> None:
        """Leave the other cores to others."""
        self._networks.threads = 1

    def stretch(
        self, index: int, on_frame: Callable[[int], None], should_stop: Callable[[], bool]
    ) -> Stretch:
        """Look at the stretch after `index` others. `on_frame` is called with the count of its frames so far;
        `should_stop` is asked before each, and what was found by then is returned."""
        rows = index * STRETCH, STRETCH
        regions = [
            r for r in self._options.regions if r.frame is None or r.frame in self.media.numbers(*rows)
        ]
        whole_past = any(region.frame is not None for region in regions)
        finder = ClipFinder(self._settings, self._networks, whole_past=whole_past)
        numbers: list[int] = []
        with closing(read_ahead(self.media.frames(*rows))) as frames:
            for frame in frames:
                if should_stop():
                    break
                looked_at(finder, frame, regions, first=index == 0 and not numbers)
                numbers.append(frame.number)
                on_frame(len(numbers))
        return Stretch.found_by(finder, numbers)

    def joined(self, stretches: Sequence[Stretch]) -> tuple[list[tuple[HandDetection, ...]], list[int]]:
        """The hands of a clip's frames, with sides judged, and the rows that begin another shot.

        Hands that go on over the end of a stretch, and are not found in the next, are followed into it; those
        that the next one begins with, and the one before has not, are followed back.
        """
        frames = [frame for stretch in stretches for frame in stretch.frames]
        starts = np.cumsum([0, *(len(stretch.frames) for stretch in stretches)]).tolist()
        cuts = [
            start + row for start, stretch in zip(starts, stretches, strict=False) for row in stretch.cuts
        ]
        cuts += [
            start
            for start, (before, after) in zip(starts[1:], pairwise(stretches), strict=False)
            if before.last is not None and after.first is not None and after.first.is_cut_from(before.last)
        ]
        again = _Again(self.media)
        carried: list[Followed] = []
        for start, end, (before, after) in zip(starts[1:], starts[2:], pairwise(stretches), strict=False):
            going, carried = [*before.followed, *carried], []
            if start in cuts or before.last is None or after.first is None:
                continue  # another shot, or frames that nobody could look at
            new = [
                Followed.of(hand, self._settings.threshold)
                for hand in after.frames[0]
                if not any(same_hand(hand, other.last) for other in going)
            ]
            for followed in new:
                past = again.back_from(start, whole=followed.last.shown, cuts=cuts)
                for row, rgb in past:
                    if rgb is not None and not goes_on(self._networks, followed, rgb, row, frames):
                        break
            carried = [f for f in going if not any(same_hand(f.last, hand) for hand in after.frames[0])]
            for row in range(start, end):
                if not carried or row in cuts:
                    carried = []
                    break
                rgb = again.picture(row)
                if rgb is not None:
                    carried = [f for f in carried if goes_on(self._networks, f, rgb, row, frames)]
        judged = iter(with_side_judged([hand for frame in frames for hand in frame]))
        return [tuple(next(judged) for _ in frame) for frame in frames], sorted(cuts)


class _Again:
    """Frames of a clip that are looked at once more, most of them in order."""

    def __init__(self, media: Media) -> None:
        self._media = media
        self._frames: Iterator[Frame] = iter(())
        self._next = 0
        self._past = Past()

    def picture(self, row: int) -> np.ndarray | None:
        """(H, W, 3) uint8 RGB of the frame after `row` others; None where it cannot be read."""
        if self._next - len(self._past) <= row < self._next:
            return list(self._past.backwards())[self._next - 1 - row]
        if not self._next <= row <= self._next + LOOK_BACK:
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
        """The rows before that one and their pictures, the last first, back to where the shot begins: as many
        as memory holds, or, where `whole`, as JPEGs."""
        begin = max((cut for cut in cuts if cut < row), default=0)
        past: Past = Packed()
        if whole:
            for frame in self._media.frames(begin, row - begin):
                past.append(frame.rgb)
        else:
            begin = max(begin, row - LOOK_BACK)
            for here in range(begin, row):
                self.picture(here)
            past = self._past
        yield from zip(range(row - 1, begin - 1, -1), past.backwards(), strict=False)
