"""Hands in the frames of a clip: the detector's own following, and second looks where it loses a hand."""

from __future__ import annotations

from collections import deque
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np

from handfit_core.detect.correction.corrected import with_side_judged
from handfit_core.detect.detector import Backend, Detector, DetectorSettings
from handfit_core.detect.keypoints import HandDetection
from handfit_core.detect.looks import SAME_HAND, SecondLook, distance, look_again
from handfit_core.detect.stills import ALL_HANDS, search

LOOK_BACK = 24
"""Past frames that are looked at again once a hand turns up, at most"""

MOST_PAST_BYTES = 100_000_000
"""Memory that those frames may take: 4 frames of 3840 x 2160"""

MOST_TRIES = 6
"""Second looks after one loss, 1, 2, 4, ... frames apart: a hand that left costs no more than these."""

LONGEST_WAIT = 32
"""Frames between two searches of a clip in which no hand is followed"""

MOST_GAPS = 2
"""Looking back ends after so many frames that do not show the hand."""


@dataclass
class _Followed:
    """A hand that was seen."""

    last: HandDetection
    frame: int = -1
    """in which it was seen last; -1 for a new one"""
    tries: int = 0
    """second looks since it was last seen, all in vain"""
    wait: int = 0
    """frames until the next one"""

    def seen(self, hand: HandDetection) -> None:
        self.last, self.tries, self.wait = hand, 0, 0

    def missed(self) -> None:
        self.tries += 1
        self.wait = 2**self.tries - 1


@dataclass
class _PastFrame:
    """A frame that may be looked at again."""

    index: int
    rgb: np.ndarray | None


class ClipFinder(Detector):
    """Finds the hands of one clip, frame by frame.

    Where all hands are found, it costs what the backend's own following costs. Where one is lost, its
    surroundings are looked at again, and again in later frames, each time after a longer wait. A hand
    that turns up is looked for in the `LOOK_BACK` frames before, so that `frames` is final only so
    many frames back.

    Raises LandmarkModelError when the model file is missing or damaged.
    """

    def __init__(self, backend: Backend, settings: DetectorSettings) -> None:
        self.frames: list[tuple[HandDetection, ...]] = []
        """The hands of every frame so far"""
        self._backend, self._settings = backend, settings
        self._max_hands = settings.max_hands or ALL_HANDS
        self._followed: list[_Followed] = []
        self._past: deque[_PastFrame] = deque(maxlen=LOOK_BACK)
        self._searches = 0
        self._search_wait = 0
        self._open = ExitStack()
        self._following = self._open.enter_context(backend.open(settings))
        self._of_crops: SecondLook | None = None
        self._of_frames: SecondLook | None = None

    def close(self) -> None:
        """Give the detectors' threads and memory back."""
        self._open.close()
        self._past.clear()

    def completed(self, found: list[tuple[HandDetection, ...]]) -> list[tuple[HandDetection, ...]]:  # noqa: ARG002
        """The hands of all frames, those that were found afterwards included, with sides judged."""
        judged = iter(with_side_judged([hand for frame in self.frames for hand in frame]))
        return [tuple(next(judged) for _ in frame) for frame in self.frames]

    def find(self, rgb: np.ndarray | None, time: float = 0.0) -> tuple[HandDetection, ...]:
        """As `Detector.find`; hands that are found in this frame later are told by `completed`."""
        index = len(self.frames)
        self.frames.append(())
        hands = list(self._following.find(rgb, time))
        lost = self._update(hands)
        if rgb is not None:
            for followed in lost:
                self._look_for(rgb, followed, hands)
            if not hands and not self._followed:
                self._search(rgb, hands)
        self._followed = [f for f in self._followed if f.tries < MOST_TRIES]
        self.frames[index] = tuple(hands)
        for hand in hands:
            if not any(f.last is hand for f in self._followed):
                self._followed.append(_Followed(hand))
        for followed in self._followed:
            if any(followed.last is hand for hand in hands):
                if followed.frame != index - 1:
                    self._look_back(followed.last)
                followed.frame = index
        # Only frames that lack a hand can gain one.
        self._past.append(_PastFrame(index, rgb if len(hands) < self._max_hands else None))
        while sum(past.rgb.nbytes for past in self._past if past.rgb is not None) > MOST_PAST_BYTES:
            self._past.popleft()
        return self.frames[index]

    def _update(self, hands: list[HandDetection]) -> list[_Followed]:
        """Tell the followed hands what was found; returns those that were not."""
        pairs = sorted(
            (
                (distance(f.last, hand), i, j)
                for i, f in enumerate(self._followed)
                for j, hand in enumerate(hands)
            )
        )
        told: set[int] = set()
        taken: set[int] = set()
        for apart, i, j in pairs:
            if apart < 1.0 and i not in told and j not in taken:
                self._followed[i].seen(hands[j])
                told.add(i)
                taken.add(j)
        return [f for i, f in enumerate(self._followed) if i not in told]

    def _look_for(self, rgb: np.ndarray, followed: _Followed, hands: list[HandDetection]) -> None:
        if followed.wait > 0:
            followed.wait -= 1
            return
        if len(hands) >= self._max_hands:
            followed.missed()
            return
        again = self._look_at(rgb, followed.last)
        if again is None or any(distance(again, hand) < SAME_HAND for hand in hands):
            followed.missed()
            return
        followed.seen(again)
        hands.append(again)

    def _look_at(self, rgb: np.ndarray, last: HandDetection) -> HandDetection | None:
        """The hand, near where it was seen last."""
        if self._of_crops is None:
            self._of_crops = self._second_look(1)
        return look_again(rgb, last, self._of_crops)

    def _second_look(self, max_hands: int | None) -> SecondLook:
        """One that is made when it is first needed: a clip whose hands are always found needs none."""
        second = SecondLook(self._backend, self._settings, max_hands=max_hands)
        self._open.callback(second.close)
        return second

    def _search(self, rgb: np.ndarray, hands: list[HandDetection]) -> None:
        if self._search_wait > 0:
            self._search_wait -= 1
            return
        if self._of_frames is None:
            self._of_frames = self._second_look(self._settings.max_hands)
        hands += search(rgb, self._of_frames, (), self._max_hands)
        self._searches = 0 if hands else self._searches + 1
        self._search_wait = min(2**self._searches - 1, LONGEST_WAIT) if self._searches else 0

    def _look_back(self, hand: HandDetection) -> None:
        """Look for a hand that turned up in the frames before, back to where it is not seen any more."""
        gaps = 0
        for past in reversed(self._past):
            there = self.frames[past.index]
            if (
                past.rgb is None
                or len(there) >= self._max_hands
                or any(distance(hand, other) < 1.0 for other in there)
            ):
                return
            before = self._look_at(past.rgb, hand)
            if before is None:
                gaps += 1
                if gaps == MOST_GAPS:
                    return
                continue
            if any(distance(before, other) < SAME_HAND for other in there):
                return
            self.frames[past.index] = (*there, before)
            hand = before
