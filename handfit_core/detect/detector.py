"""The interface of detectors, and their registry.

A backend is one file with a `Detector` and a `Backend` that makes it. Backends of other packages are found by
their entry points of the group `handfit.detectors` (see `registry`).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, Protocol, Self, TypeVar

import numpy as np

from handfit_core.common.errors import OptionError
from handfit_core.common.registry import Registry
from handfit_core.common.skeleton import Side
from handfit_core.detect.keypoints import Detections
from handfit_core.media.source import Media

Quality = Literal["draft", "standard", "best"]
"""Effort for each hand. `draft`: one prediction of the fastest landmark network. `standard`: two networks,
and test-time augmentation in stills. `best`: test-time augmentation in every frame of a clip, too."""


class Detector:
    """Finds the hands of one run's pictures. Use it as a context manager."""

    def find(self, rgb: np.ndarray | None, time: float = 0.0) -> Detections:
        """Detect all hands of the next picture (H, W, 3) uint8 RGB.

        `time`, in seconds, rises from frame to frame of a clip. A picture of None stands for a frame that
        could not be read, and has no hands.
        """
        raise NotImplementedError

    def detect_in_box(
        self,
        rgb: np.ndarray,  # noqa: ARG002
        box: Sequence[float],  # noqa: ARG002
        side: Side | None = None,  # noqa: ARG002
        known: Iterable[Detections] = (),  # noqa: ARG002
    ) -> Detections | None:
        """Return the hand that a person sees in a box (x, y, width, height), pixels, of the picture that
        `find` was given last; None where there is none.

        It is the hand about whose keypoints the box is drawn, or what is detected there beside the hands that
        `find` returned and the `known` ones; where there is nothing else, the better detection of one of
        these. `side` is the side that the person names. In a clip the hand is tracked from there, both ways.
        """
        raise OptionError("this detector cannot look into a region of a picture; the detector direct can")

    @property
    def most_seen(self) -> int:
        """The most hands that were seen in one picture, even if more than are wanted; 0 where they were not
        counted."""
        return 0

    @property
    def missed(self) -> bool:
        """True if the pictures likely show another hand beside those that were found."""
        return False

    def close(self) -> None:
        """Release the networks' memory and threads."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@dataclass(frozen=True, eq=False)
class Detected:
    """The hands of the T frames of a source."""

    numbers: list[int]
    """The T numbers of the frames in the source"""
    hands: Detections
    """The hands of all T frames; an unreadable frame has none"""
    most_seen: int = 0
    """The most hands that were seen in one frame, even if more than are wanted; 0 where they were not
    counted"""
    cuts: tuple[int, ...] = ()
    """Rows (indices 0 to T - 1) of the frames that begin another shot"""
    missed: bool = False
    """True if the frames likely show another hand beside those that were found"""


@dataclass(frozen=True)
class Region:
    """A box in the upright picture in which somebody has seen a hand. Pixels; y grows downwards.

    The box of a hand that is found anyway, drawn about its landmarks, means that hand."""

    x: float
    y: float
    width: float
    height: float
    frame: int | None = None
    """Number of the source's frame in which the box is drawn; None: the first frame that is used"""
    side: Side | None = None
    """Side of the hand, as somebody says; None: the side is judged by the detector"""


@dataclass(frozen=True)
class DetectorSettings:
    """The options with which a detector is opened."""

    max_hands: int | None = 2
    """The most hands of one picture that are wanted; None: all"""
    video: bool = False
    """True if the pictures are the frames of one clip, in order; else they are independent of each other"""
    threshold: float = 0.5
    """Least probability, 0..1, that a detection must have to count as a hand"""
    landmark_model: str | os.PathLike[str] | None = None
    """Path of a model file in place of the backend's own; None: the backend's own"""
    quality: Quality = "standard"
    plain: bool = False
    """True to search the whole picture only, with one prediction for each hand: faster, and finds less"""


class ChunkOfFrames(Protocol):
    """What was found in consecutive frames of a clip."""

    @property
    def numbers(self) -> list[int]:
        """Numbers of the chunk's frames in the source: the media's `chunk_frames`, fewer at the end."""
        ...


Part = TypeVar("Part", bound=ChunkOfFrames, covariant=True)


class InChunks(Protocol[Part]):
    """Goes through one clip in chunks of the media's `chunk_frames`. Use it as a context manager."""

    media: Media

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Release memory and threads, and close the file."""

    def single_threaded(self) -> None:
        """Run in one thread, since other threads detect other chunks."""

    def chunk(self, index: int, on_frame: Callable[[int], None], should_stop: Callable[[], bool], /) -> Part:
        """Detect what is in the chunk with that index, counted from 0, from the chunk's own frames alone.
        `on_frame` is called with the count of the chunk's frames that are done; `should_stop` is asked before
        each frame, and ends the chunk there."""
        ...


class ChunkedDetector(InChunks[Any], Protocol):
    """Finds the hands of one clip; the built-in one is `chunks.ClipDetector`, which makes and joins
    `chunks.Chunk`s."""

    def joined(self, chunks: Sequence[Any], /) -> tuple[Detections, list[int]]:
        """Join the chunks of a clip: return the hands of all its frames, and the rows that begin another
        shot."""
        ...


@dataclass(frozen=True)
class Backend:
    """A way to detect hands, with the functions that open it and its capabilities."""

    open: Callable[[DetectorSettings], Detector]
    """Makes a detector, and imports heavy packages only then. Raises LandmarkModelError where a model file is
    missing or damaged."""
    fingerprint: Callable[[DetectorSettings], str]
    """Versions and models on which the detections depend, as a string by which an evaluation knows which ones
    it may use again"""
    clip: Callable[[Media, DetectorSettings, Sequence[Region]], ChunkedDetector] | None = None
    """Makes the detector of a whole clip's hands, and of those in the regions that somebody has drawn. None:
    the detector that `open` makes gets the clip frame after frame, in one thread, and no cut to another shot
    is noticed"""
    calibrated: Callable[[DetectorSettings], bool] = lambda _settings: False
    """Returns True if `fit.doubt` can tell, for hands found with these settings, how far off they are likely
    to be. That was measured with MediaPipe's networks, and is not known for other keypoints"""


DETECTORS: Final = Registry(
    "handfit.detectors",
    "detector",
    Backend,
    {
        "direct": "handfit_core.detect.direct:DIRECT",
        "mediapipe": "handfit_core.detect.mediapipe_tasks:MEDIAPIPE",
    },
)
