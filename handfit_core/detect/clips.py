"""Hands in the frames of a clip: MediaPipe's own following, and second looks where it loses a hand."""

from __future__ import annotations

import os
from collections import deque
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np

from handfit_core.detect.agreement import SAME_HAND, distance
from handfit_core.detect.keypoints import HandDetection
from handfit_core.detect.look_again import look_again
from handfit_core.detect.mediapipe_tasks import MediaPipeHands
from handfit_core.detect.search import search
from handfit_core.detect.second_look import SecondLook

LOOK_BACK = 24
"""So many frames are kept, to be looked at again once a hand turns up ..."""

MOST_KEPT_BYTES = 100_000_000
"""... but no more than this: 4 frames of 3840 x 2160."""

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
class _Kept:
    """A frame that may be looked at again."""

    index: int
    rgb: np.ndarray | None


class ClipFinder:
    """Finds the hands of one clip, frame by frame. Use as a context manager.

    Where all hands are found, it costs what MediaPipe's video mode costs. Where one is lost, its
    surroundings are looked at again, and again in later frames, each time after a longer wait. A hand
    that turns up is looked for in the `LOOK_BACK` frames before, so that `frames` is final only so
    many frames back.

    Raises LandmarkModelError when the model file is missing or damaged, OptionError for a threshold
    outside 0..1.
    """

    def __init__(
        self, *, max_hands: int, threshold: float, landmark_model: str | os.PathLike[str] | None
    ) -> None:
        self.frames: list[tuple[HandDetection, ...]] = []
        """The hands of every frame so far"""
        self._max_hands = max_hands
        self._followed: list[_Followed] = []
        self._kept: deque[_Kept] = deque(maxlen=LOOK_BACK)
        self._searches = 0
        self._search_wait = 0
        self._landmark_model = landmark_model
        with ExitStack() as opening:
            self._following = opening.enter_context(
                MediaPipeHands(
                    max_hands=max_hands, video=True, threshold=threshold, landmark_model=landmark_model
                )
            )
            self._open = opening.pop_all()
        self._of_crops: SecondLook | None = None
        self._of_frames: SecondLook | None = None

    def __enter__(self) -> ClipFinder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Give MediaPipe's threads and memory back."""
        self._open.close()
        self._kept.clear()

    def find(self, rgb: np.ndarray | None, time: float) -> tuple[HandDetection, ...]:
        """The hands of the next frame (H, W, 3) uint8 RGB at `time` in seconds; None where it could not
        be read."""
        index = len(self.frames)
        self.frames.append(())
        hands = [] if rgb is None else list(self._following.detect(rgb, time))
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
        self._kept.append(_Kept(index, rgb if len(hands) < self._max_hands else None))
        while sum(kept.rgb.nbytes for kept in self._kept if kept.rgb is not None) > MOST_KEPT_BYTES:
            self._kept.popleft()
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
            self._of_crops = self._open.enter_context(
                SecondLook(max_hands=1, landmark_model=self._landmark_model)
            )
        return look_again(rgb, last, self._of_crops)

    def _search(self, rgb: np.ndarray, hands: list[HandDetection]) -> None:
        if self._search_wait > 0:
            self._search_wait -= 1
            return
        if self._of_frames is None:
            self._of_frames = self._open.enter_context(
                SecondLook(max_hands=self._max_hands, landmark_model=self._landmark_model)
            )
        hands += search(rgb, self._of_frames, (), self._max_hands)
        self._searches = 0 if hands else self._searches + 1
        self._search_wait = min(2**self._searches - 1, LONGEST_WAIT) if self._searches else 0

    def _look_back(self, hand: HandDetection) -> None:
        """Look for a hand that turned up in the frames before, back to where it is not seen any more."""
        gaps = 0
        for kept in reversed(self._kept):
            there = self.frames[kept.index]
            if (
                kept.rgb is None
                or len(there) >= self._max_hands
                or any(distance(hand, other) < 1.0 for other in there)
            ):
                return
            before = self._look_at(kept.rgb, hand)
            if before is None:
                gaps += 1
                if gaps == MOST_GAPS:
                    return
                continue
            if any(distance(before, other) < SAME_HAND for other in there):
                return
            self.frames[kept.index] = (*there, before)
            hand = before
