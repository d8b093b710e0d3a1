"""MediaPipe's palm and landmark networks, run directly on any view of a picture.

Palm and landmark network lie in the landmark model file; a landmark network of December 2020, whose depth is
better and which is faster, in a file of its own that may be absent. MediaPipe's own graph shows them crops of
its own choice; its image embedder runs any network on any picture and returns all of its outputs, which is
all that is needed here. Crops are MediaPipe's: "MediaPipe Hands: On-device Real-time Hand Tracking" (Zhang
et al., 2020).
"""

from __future__ import annotations

import os
import sys
import zipfile
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import islice
from queue import SimpleQueue
from typing import Any, Final, Self, TypeVar

import numpy as np

from handfit_core.detect.detector import Quality
from handfit_core.detect.keypoints import HandDetection
from handfit_core.detect.landmark_model import landmark_model_path, landmarks_2020_path
from handfit_core.detect.looks import View
from handfit_core.errors import LandmarkModelError
from handfit_core.machine import usable_cores
from handfit_core.skeleton import KEYPOINT_PARENTS, NUM_KEYPOINTS

PALM_SIZE: Final = 192
"""Pixels a side of what the palm network sees"""
HAND_SIZE: Final = 224
"""Pixels a side of what the landmark network sees"""
DEPTH_SCALE: Final = 0.4
"""The landmark network's depth, in units of what it gives for x and y"""

SAME_PALM: Final = 0.35
"""Palms of about one size nearer than this, in sides of their boxes, are one"""
THE_PALM: Final = 0.2
"""A palm's points are that near to the landmarks of its hand, in sides of its box"""
_OF_PALM: Final = [0, 5, 9, 13, 17, 1, 2]
"""The landmarks that are a palm's points"""
OF_PALM: Final = 2.6
"""Side of a hand's crop in sides of its palm's box"""
BEYOND_PALM: Final = 0.5
"""By so many sides of the box a crop's middle lies towards the fingers"""
OF_HAND: Final = 2.0
"""Side of a hand's crop in sides of the box of its landmarks, but for fingertips"""
BEYOND_HAND: Final = 0.1
_BOXED: Final = [0, 1, 2, 3, 5, 6, 9, 10, 13, 14, 17, 18]
"""Landmarks that the box of a hand is about"""

TURNS: Final = (0.0, 0.35, -0.35)
"""Radians by which the averaged looks are turned; the picture and its mirror image are looked at"""
ALL_LOOKS: Final = 2 * len(TURNS)

MEAN_BONE: Final = 0.0385
"""metres, the mean of the 20 bones between an average hand's keypoints"""

SURER_2020: Final = 2.5
"""The landmark network of December 2020 is surer that there is a hand than the present one: by so much in the
logit of the presence, of the hands and of what are none in twenty photos of people"""

MOST_THREADS: Final = 4
"""Each has networks of its own: some 30 MB"""

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class Palms:
    """N palms in pixels of the picture, the surest first."""

    score: np.ndarray
    """(N,) 0..1"""
    centre: np.ndarray
    """(N, 2) of their boxes"""
    side: np.ndarray
    """(N,) of their boxes, the longer one"""
    points: np.ndarray
    """(N, 7, 2): wrist, knuckles of index, middle, ring and little, thumb's two"""

    def __len__(self) -> int:
        return len(self.score)

    @classmethod
    def of(cls, parts: Sequence[Palms]) -> Palms:
        """All palms of several views, the surest first, each once."""
        whole = [np.concatenate([getattr(part, name) for part in parts]) for name in cls.__dataclass_fields__]
        order = np.argsort(-whole[0], kind="stable")
        score, centre, side, points = (array[order] for array in whole)
        kept: list[int] = []
        for i in range(len(score)):
            apart = np.linalg.norm(centre[kept] - centre[i], axis=-1) / np.maximum(side[kept], side[i])
            size = side[kept] / side[i]
            if not ((apart < SAME_PALM) & (size > 0.6) & (size < 1.0 / 0.6)).any():
                kept.append(i)
        return cls(score[kept], centre[kept], side[kept], points[kept])

    def times(self, factor: float) -> Palms:
        """The same in a picture so many times as large."""
        return Palms(self.score, self.centre * factor, self.side * factor, self.points * factor)

    def is_of(self, index: int, hand: HandDetection) -> bool:
        """Whether that palm is a hand's."""
        off = self.points[index] - hand.keypoints_2d[_OF_PALM]
        return float(np.linalg.norm(off, axis=-1).mean()) < THE_PALM * float(self.side[index])

    def view(self, index: int) -> View:
        """The crop in which the landmark network looks for that palm's hand."""
        points, side = self.points[index], float(self.side[index])
        up = _unit(points[2] - points[0])
        centre = self.centre[index] + BEYOND_PALM * side * up
        return View.of_square(centre, OF_PALM * side, HAND_SIZE, turn=_upright(up))


@dataclass(frozen=True, eq=False)
class Look:
    """What the landmark network makes of one crop."""

    presence: float
    """How likely it shows a hand, 0..1"""
    hand: HandDetection
    """In pixels of the picture; its score is that of the side"""


def view_of(keypoints: np.ndarray) -> View:
    """The crop in which the landmark network finds landmarks (21, 2 or more) again."""
    points = keypoints[_BOXED, :2]
    knuckles = (keypoints[5, :2] + keypoints[13, :2]) / 2.0
    up = _unit((knuckles + keypoints[9, :2]) / 2.0 - keypoints[0, :2])
    across = np.array([-up[1], up[0]])
    along = np.stack([points @ across, points @ up])
    low, high = along.min(axis=1), along.max(axis=1)
    middle, side = (low + high) / 2.0, float((high - low).max())
    middle[1] += BEYOND_HAND * (high - low)[1]
    centre = middle[0] * across + middle[1] * up
    return View.of_square(centre, OF_HAND * max(side, 1.0), HAND_SIZE, turn=_upright(up))


def crop_of(keypoints: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Centre (2,), side and turn of the crop about landmarks (21, 2 or more)."""
    upright = view_of(keypoints)
    centre = np.linalg.inv(upright.linear) @ (HAND_SIZE / 2.0 - upright.offset)
    return centre, HAND_SIZE / upright.scale, float(np.arctan2(upright.linear[1, 0], upright.linear[0, 0]))


def around(keypoints: np.ndarray) -> Iterator[View]:
    """The crop about landmarks (21, 2 or more), turned to and fro, and mirrored."""
    centre, span, turn = crop_of(keypoints)
    for mirrored, upwards in ((False, turn), (True, -turn)):
        for more in TURNS:
            yield View.of_square(centre, span, HAND_SIZE, turn=upwards + more, mirrored=mirrored)


def _unit(vector: np.ndarray) -> np.ndarray:
    length = float(np.linalg.norm(vector))
    return vector / length if length > 0.0 else np.array([0.0, -1.0])


def _upright(up: np.ndarray) -> float:
    """Radians, clockwise as seen, that turn a direction (2,) upwards."""
    return -float(np.arctan2(up[0], -up[1]))


class Networks:
    """The palm network and the landmark networks. Use as a context manager.

    Of quality `draft`, the landmark network of December 2020 stands in for the present one, where it is
    there. Raises LandmarkModelError when the landmark model file is missing or damaged.
    """

    def __init__(
        self, landmark_model: str | os.PathLike[str] | None = None, *, quality: Quality = "standard"
    ) -> None:
        path = landmark_model_path(landmark_model)
        self.quality: Quality = quality
        self.threads = min(usable_threads(), MOST_THREADS)
        """How many run the networks where several views of a picture are to be looked at"""
        self._landmark_model = landmark_model
        self._pool: ThreadPoolExecutor | None = None
        self._beside: ThreadPoolExecutor | None = None
        """Runs the landmark network of December 2020 while the present one looks at the next frame"""
        self._idle: SimpleQueue[Networks | None] = SimpleQueue()
        """What threads run; None: networks that are not loaded yet"""
        # MediaPipe and TensorFlow Lite greet on stderr; only real errors are of interest.
        os.environ.setdefault("GLOG_minloglevel", "2")
        os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
        import mediapipe as mp

        _forget_tracebacks()
        self._mp = mp
        self._open = ExitStack()
        try:
            with zipfile.ZipFile(path) as task:
                self._palms = self._opened(task.read("hand_detector.tflite"))
                self._hand = self._opened(task.read("hand_landmarks_detector.tflite"))
            second = landmarks_2020_path()
            self._hand_2020 = None if second is None else self._opened(second.read_bytes())
        except (OSError, KeyError, zipfile.BadZipFile, RuntimeError, ValueError) as error:
            self._open.close()
            raise LandmarkModelError(
                f"{path}: MediaPipe cannot load this landmark model ({error}); assemble it again with "
                "scripts/fetch_landmark_model.py --force"
            ) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Give MediaPipe's threads and memory back."""
        for pool in (self._pool, self._beside):
            if pool is not None:
                pool.shutdown(cancel_futures=True)
        self._pool = self._beside = None
        while not self._idle.empty():
            if (other := self._idle.get()) not in (None, self):
                other.close()
        self._open.close()

    def each(
        self, do: Callable[[Networks, Item], Result], items: Sequence[Item]
    ) -> Generator[Result, None, None]:
        """What comes of doing something with each item, in their order. `do` gets the networks to do it with:
        these, or those of another thread. The results are the same with any number of threads, since a
        network's answer hangs on its view alone. Whoever asks for no more has the rest left undone."""
        if self.threads < 2 or len(items) < 2:
            yield from (do(self, item) for item in items)
            return
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self.threads, "handfit-networks")
            for networks in (self, *[None] * (self.threads - 1)):
                self._idle.put(networks)
        left = iter(items)
        begun = deque(self._pool.submit(self._lent, do, item) for item in islice(left, 2 * self.threads))
        try:
            while begun:
                yield begun.popleft().result()
                begun.extend(self._pool.submit(self._lent, do, item) for item in islice(left, 1))
        finally:
            for future in begun:
                future.cancel()

    def _lent(self, do: Callable[[Networks, Item], Result], item: Item) -> Result:
        """Do something with networks that nobody else uses."""
        networks = self._idle.get() or Networks(self._landmark_model, quality=self.quality)
        try:
            return do(networks, item)
        finally:
            self._idle.put(networks)

    def _opened(self, network: bytes) -> Any:
        vision, base = self._mp.tasks.vision, self._mp.tasks.BaseOptions(model_asset_buffer=network)
        options = vision.ImageEmbedderOptions(base)
        return self._open.enter_context(vision.ImageEmbedder.create_from_options(options))

    @property
    def is_draft(self) -> bool:
        """Whether the landmark network of December 2020 looks alone."""
        return self.quality == "draft" and self._hand_2020 is not None

    def _run(self, network: Any, rgb: np.ndarray) -> Sequence[np.ndarray]:
        image = self._mp.Image(image_format=self._mp.ImageFormat.SRGB, data=rgb)
        return [output.embedding for output in network.embed(image).embeddings]

    def palms(self, rgb: np.ndarray, view: View, threshold: float) -> Palms:
        """The palms of a picture (H, W, 3) uint8 RGB that `view`, `PALM_SIZE` wide, shows; some more than
        once."""
        boxes, logits = self._run(self._palms, view.render(rgb))
        sure = np.flatnonzero(logits >= np.log(threshold / (1.0 - threshold)))
        sure = sure[np.argsort(-logits[sure], kind="stable")]
        numbers = boxes.reshape(-1, 9, 2)[sure]
        numbers[:, 0] += PALM_SIZE * _anchors()[sure]
        numbers[:, 2:] += PALM_SIZE * _anchors()[sure][:, None]
        back = np.linalg.inv(view.linear)
        return Palms(
            score=1.0 / (1.0 + np.exp(-logits[sure])),
            centre=(numbers[:, 0] - view.offset) @ back.T,
            side=numbers[:, 1].max(axis=1) / view.scale,
            points=(numbers[:, 2:] - view.offset) @ back.T,
        )

    def look(self, rgb: np.ndarray, view: View) -> Look:
        """What the landmark network makes of a view, `HAND_SIZE` wide, of a picture (H, W, 3) uint8 RGB."""
        crop = view.render(rgb)
        if self.is_draft:
            return self._draft(crop, view)
        landmarks, presence, handedness, world = self._run(self._hand, crop)
        right = float(handedness[0])
        found = HandDetection(
            side="right" if right >= 0.5 else "left",
            score=max(right, 1.0 - right),
            keypoints=_with_depth(landmarks),
            world=world.reshape(NUM_KEYPOINTS, 3).astype(np.float64),
        )
        return Look(float(presence[0]), view.to_picture(found))

    def seen_twice(self, rgb: np.ndarray, hand: HandDetection) -> HandDetection:
        """A hand of a picture (H, W, 3) uint8 RGB with what the landmark network of December 2020 sees of it,
        where that is there and has not been asked."""
        if self._hand_2020 is None or hand.keypoints_2020 is not None:
            return hand
        view = view_of(hand.keypoints)
        points = _with_depth(self._run(self._hand_2020, view.render(rgb))[0])
        return replace(hand, keypoints_2020=view.points_to_picture(points))

    def beside(self, do: Callable[[], Result]) -> Future[Result]:
        """What comes of doing something in a thread of its own, one thing after another; at once where the
        networks have one thread."""
        if self.threads < 2:
            done: Future[Result] = Future()
            done.set_result(do())
            return done
        self._beside = self._beside or ThreadPoolExecutor(1, "handfit-beside")
        return self._beside.submit(do)

    def _draft(self, crop: np.ndarray, view: View) -> Look:
        """What the landmark network of December 2020 alone makes of a crop of that view. Its world landmarks
        are its keypoints at the size of an average hand."""
        landmarks, presence, handedness = self._run(self._hand_2020, crop)
        keypoints, right = _with_depth(landmarks), float(handedness[0])
        bones = np.linalg.norm(keypoints[1:] - keypoints[list(KEYPOINT_PARENTS[1:])], axis=-1)
        world = (keypoints - keypoints.mean(axis=0)) * (MEAN_BONE / max(float(bones.mean()), 1e-9))
        side = "right" if right >= 0.5 else "left"
        hand = view.to_picture(HandDetection(side, max(right, 1.0 - right), keypoints, world))
        odds = float(presence[0]) / max(1.0 - float(presence[0]), 1e-9) * np.exp(-SURER_2020)
        return Look(float(odds / (1.0 + odds)), replace(hand, keypoints_2020=hand.keypoints))


def _with_depth(landmarks: np.ndarray) -> np.ndarray:
    """(63,) what a landmark network says -> (21, 3) pixels of its crop, depth on the scale of x."""
    keypoints = landmarks.reshape(NUM_KEYPOINTS, 3).astype(np.float64)
    keypoints[:, 2] /= DEPTH_SCALE
    return keypoints


def _forget_tracebacks() -> None:
    """Where there is no sound, MediaPipe keeps the error of its import, and with it all that the functions
    which were being called then hold at their ends: the detections of a whole clip."""
    error = getattr(sys.modules.get("mediapipe.tasks.python.audio.core.audio_record"), "sd_error", None)
    while isinstance(error, BaseException):
        error.__traceback__ = None
        error = error.__context__


def usable_threads() -> int:
    """How many may look at pictures at the same time: one a core, fewer where OpenMP was told so."""
    told = os.environ.get("OMP_NUM_THREADS", "")
    cores = usable_cores()
    return max(1, min(cores, int(told) if told.isdecimal() else cores))


@lru_cache(maxsize=1)
def _anchors() -> np.ndarray:
    """(2016, 2) in sides of the picture: two at each place of a 24 x 24 grid, six of a 12 x 12 grid."""
    grids = []
    for count, each in ((24, 2), (12, 6)):
        middles = (np.arange(count) + 0.5) / count
        grid = np.stack(np.meshgrid(middles, middles), axis=-1).reshape(-1, 2)
        grids.append(grid.repeat(each, axis=0))
    return np.concatenate(grids)
