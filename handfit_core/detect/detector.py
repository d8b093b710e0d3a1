"""What a detector is, and those that there are.

A backend is one file with a `Detector` and a `Backend` that makes it. Those of other packages are found by
their entry points of the group `handfit.detectors` (see `registry`).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, Protocol, Self

import numpy as np

from handfit_core.detect.keypoints import HandDetection
from handfit_core.errors import OptionError
from handfit_core.media.source import Media
from handfit_core.registry import Registry
from handfit_core.skeleton import Side

Quality = Literal["draft", "standard", "best"]
"""How closely hands are looked at. `draft`: by the fastest landmark network alone, once. `standard`: by two.
`best`: also in clips from several turns, and mirrored."""


class Detector:
    """Finds the hands of one run's pictures. Use it as a context manager."""

    def find(self, rgb: np.ndarray | None, time: float = 0.0) -> tuple[HandDetection, ...]:
        """The hands of the next picture (H, W, 3) uint8 RGB, as many as there are to be found.

        `time` in seconds rises from frame to frame of a clip. A picture without a hand has an empty tuple,
        and so has None, a frame that could not be read.
        """
        raise NotImplementedError

    def look_in(
        self,
        rgb: np.ndarray,  # noqa: ARG002
        box: Sequence[float],  # noqa: ARG002
        side: Side | None = None,  # noqa: ARG002
    ) -> HandDetection | None:
        """The hand that a person sees in a box (x, y, width, height), pixels, of the picture that `find` was
        given last: the one about whose points the box is drawn, or what is found by looking there. `side` is
        the person's word. In a clip it is followed from there, both ways. None: nothing is found there."""
        raise OptionError("this detector cannot look into a region of a picture; the detector direct can")

    @property
    def most_seen(self) -> int:
        """The most hands that were seen at once where there were more than are wanted; 0: nobody counted."""
        return 0

    def close(self) -> None:
        """Give memory and threads back."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@dataclass(frozen=True, eq=False)
class Detected:
    """What was found in the T frames of a source."""

    numbers: list[int]
    """(T) of the frames"""
    frames: list[tuple[HandDetection, ...]]
    """(T) the hands of each; an unreadable frame has none"""
    most_seen: int = 0
    """The most hands that were seen at once where there were more than are wanted; 0: nobody counted"""
    cuts: tuple[int, ...] = ()
    """Rows that begin another shot"""


@dataclass(frozen=True)
class DetectorSettings:
    """What a detector is made for."""

    max_hands: int | None = 2
    """How many hands of one picture are wanted; None: all"""
    video: bool = False
    """Whether the pictures are the frames of one clip, in order; else they have nothing to do with each
    other"""
    threshold: float = 0.5
    """How sure a hand must be, 0..1"""
    landmark_model: str | os.PathLike[str] | None = None
    """A model file in place of the backend's own"""
    quality: Quality = "standard"
    first_word: bool = False
    """Whether one look at the whole picture is enough: faster, and finds less"""


class ChunkedDetector(Protocol):
    """Finds the hands of one clip in chunks of 96 frames. Use it as a context manager; ours is
    `stretches.ClipDetector`, which also makes and joins the `stretches.Stretch` of a chunk."""

    media: Media

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None: ...

    def close(self) -> None:
        """Give memory, threads and the file back."""

    def single_threaded(self) -> None:
        """Leave the other cores to those that look at other stretches."""

    def stretch(self, index: int, on_frame: Callable[[int], None], should_stop: Callable[[], bool], /) -> Any:
        """The `Stretch` after `index` others, of its own frames alone. `on_frame` is called with the count of
        its frames so far; `should_stop` is asked before each, and what was found by then is returned."""

    def joined(self, stretches: Sequence[Any], /) -> tuple[list[tuple[HandDetection, ...]], list[int]]:
        """The hands of all frames, and the rows that begin another shot."""
        ...


@dataclass(frozen=True)
class Backend:
    """One way to find hands, and what it can do."""

    open: Callable[[DetectorSettings], Detector]
    """Makes a detector, and loads what it needs only then. Raises LandmarkModelError where a model file is
    missing or damaged."""
    fingerprint: Callable[[DetectorSettings], str]
    """Names the packages' versions and the models that decide what is found, so that an evaluation knows
    which detections it may use again"""
    clip: Callable[[Media, Any], ChunkedDetector] | None = None
    """Makes what finds the hands of a clip, of its `Media` and the `CaptureOptions`. None: what `open` makes
    looks at it frame after frame, in one thread; no cut to another shot is noticed, and a batch cannot
    `--split` it"""
    calibrated: Callable[[DetectorSettings], bool] = lambda _settings: False
    """Whether `fit.doubt` can tell how far off the hands are likely to be that it finds with these settings:
    that was measured with MediaPipe's networks. Of other keypoints it is not known, however they look"""


DETECTORS: Final = Registry(
    "handfit.detectors",
    "detector",
    Backend,
    {
        "direct": "handfit_core.detect.direct:DIRECT",
        "mediapipe": "handfit_core.detect.mediapipe_tasks:MEDIAPIPE",
    },
)
