"""MediaPipe's palm and landmark networks, run directly on any crop of a picture.

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
from pathlib import Path
from queue import SimpleQueue
from typing import Any, Final, Self, TypeVar

import numpy as np

from handfit_core.common.errors import LandmarkModelError
from handfit_core.common.machine import usable_threads
from handfit_core.common.skeleton import KEYPOINT_PARENTS, NUM_KEYPOINTS, SIDES
from handfit_core.detect.crops import Crop
from handfit_core.detect.detector import Quality
from handfit_core.detect.keypoints import Detections
from handfit_core.detect.landmark_model import TASK, landmark_model_path, landmarks_2020_path


@dataclass(frozen=True)
class NetworkSettings:
    """What the palm and the landmark network take and give, and how hands are cropped for them."""

    palm_input_px: int = 192
    """Pixels a side of the palm network's input"""
    hand_input_px: int = 224
    """Pixels a side of the landmark network's input"""
    depth_scale: float = 0.4
    """What one unit of the landmark network's x and y is in its depth, which is divided by this"""
    same_palm_distance: float = 0.35
    """Distance between centres, in sides of their boxes, below which palms of about one size are one palm"""
    palm_of_hand_distance: float = 0.2
    """Mean distance, in sides of the palm's box, below which a palm's points lie on the landmarks of its own
    hand"""
    palm_crop_span: float = 2.6
    """Side of the hand's crop, in sides of its palm's box"""
    palm_crop_shift: float = 0.5
    """Sides of the palm's box by which the crop's centre lies towards the fingers"""
    hand_crop_span: float = 2.0
    """Side of the hand's crop, in sides of the box of its landmarks, fingertips left out"""
    hand_crop_shift: float = 0.1
    """Heights of that box by which the crop's centre lies towards the fingers"""
    augmentation_turns: tuple[float, float, float] = (0.0, 0.35, -0.35)
    """Radians by which the crops of test-time augmentation are turned; the picture and its mirror image have
    each"""
    mean_bone: float = 0.0385
    """Mean length in metres of the 20 bones between an average hand's keypoints"""
    presence_bias_2020: float = 2.5
    """Difference in logits by which the landmark network of December 2020 gives a higher presence than the
    present one, measured on the hands in twenty photos of people and on false candidates"""
    max_threads: int = 4
    """Most threads that run networks; each has networks of its own, which take some 30 MB"""

    @property
    def augmentation_crops(self) -> int:
        """How many crops of a hand test-time augmentation predicts: each turn, plain and mirrored."""
        return 2 * len(self.augmentation_turns)


NETWORK: Final = NetworkSettings()


Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class Palms:
    """N palms in pixels of the picture, by falling score."""

    score: np.ndarray
    """(N,) score of each palm, 0..1"""
    centre: np.ndarray
    """(N, 2) pixels: the centre of each palm's box"""
    side: np.ndarray
    """(N,) pixels: the longer side of each palm's box"""
    points: np.ndarray
    """(N, 7, 2) pixels: wrist, knuckles of index, middle, ring and little finger, and two of the thumb"""

    def __len__(self) -> int:
        return len(self.score)

    @classmethod
    def suppressed(cls, parts: Sequence[Palms]) -> Palms:
        """Suppress non-maxima: join the palms of several crops, keeping each palm once, with its best
        score."""
        whole = [np.concatenate([getattr(part, name) for part in parts]) for name in cls.__dataclass_fields__]
        order = np.argsort(-whole[0], kind="stable")
        score, centre, side, points = (array[order] for array in whole)
        kept: list[int] = []
        for i in range(len(score)):
            apart = np.linalg.norm(centre[kept] - centre[i], axis=-1) / np.maximum(side[kept], side[i])
            size = side[kept] / side[i]
            if not ((apart < NETWORK.same_palm_distance) & (size > 0.6) & (size < 1.0 / 0.6)).any():
                kept.append(i)
        return cls(score[kept], centre[kept], side[kept], points[kept])

    def scaled(self, factor: float) -> Palms:
        """Return the palms as they lie in a picture that is larger by this factor."""
        return Palms(self.score, self.centre * factor, self.side * factor, self.points * factor)

    def is_of(self, index: int, hand: Detections) -> bool:
        """Return True if the palm with that index lies on this hand's landmarks."""
        # These landmarks are a palm's points.
        off = self.points[index] - hand.keypoints_2d[0, [0, 5, 9, 13, 17, 1, 2]]
        return float(np.linalg.norm(off, axis=-1).mean()) < NETWORK.palm_of_hand_distance * float(
            self.side[index]
        )

    def crop(self, index: int) -> Crop:
        """Return the crop in which the landmark network predicts the hand of the palm with that index."""
        points, side = self.points[index], float(self.side[index])
        up = _unit(points[2] - points[0])
        centre = self.centre[index] + NETWORK.palm_crop_shift * side * up
        return Crop.of_square(
            centre, NETWORK.palm_crop_span * side, NETWORK.hand_input_px, turn=turn_upright(up)
        )


def crop_around(keypoints: np.ndarray) -> Crop:
    """Return the crop in which the landmark network finds a hand again, around its landmarks (21, 2 or more),
    pixels."""
    # All but the outer landmarks of the fingers
    points = keypoints[[0, 1, 2, 3, 5, 6, 9, 10, 13, 14, 17, 18], :2]
    knuckles = (keypoints[5, :2] + keypoints[13, :2]) / 2.0
    up = _unit((knuckles + keypoints[9, :2]) / 2.0 - keypoints[0, :2])
    across = np.array([-up[1], up[0]])
    along = np.stack([points @ across, points @ up])
    low, high = along.min(axis=1), along.max(axis=1)
    middle, side = (low + high) / 2.0, float((high - low).max())
    middle[1] += NETWORK.hand_crop_shift * (high - low)[1]
    centre = middle[0] * across + middle[1] * up
    return Crop.of_square(
        centre, NETWORK.hand_crop_span * max(side, 1.0), NETWORK.hand_input_px, turn=turn_upright(up)
    )


def square_around(keypoints: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Return the square of the crop around landmarks (21, 2 or more), pixels: its centre (2,) and side in
    pixels, and its turn in radians."""
    upright = crop_around(keypoints)
    centre = upright.inverse @ (NETWORK.hand_input_px / 2.0 - upright.offset)
    turn = float(np.arctan2(upright.linear[1, 0], upright.linear[0, 0]))
    return centre, NETWORK.hand_input_px / upright.scale, turn


def augmented_crops(keypoints: np.ndarray) -> Iterator[Crop]:
    """Yield the crops of test-time augmentation around landmarks (21, 2 or more), pixels: three turns, then
    the three mirrored."""
    centre, span, turn = square_around(keypoints)
    for mirrored, upright in ((False, turn), (True, -turn)):
        for more in NETWORK.augmentation_turns:
            yield Crop.of_square(centre, span, NETWORK.hand_input_px, turn=upright + more, mirrored=mirrored)


def _unit(vector: np.ndarray) -> np.ndarray:
    length = float(np.linalg.norm(vector))
    return vector / length if length > 0.0 else np.array([0.0, -1.0])


def turn_upright(up: np.ndarray) -> float:
    """Return the angle in radians, clockwise as seen, that turns a direction (2,) upwards."""
    return -float(np.arctan2(up[0], -up[1]))


class Runner:
    """Loads networks into MediaPipe's image embedder and runs them. Use as a context manager."""

    def __init__(self) -> None:
        # MediaPipe and TensorFlow Lite greet on stderr; only real errors are of interest.
        os.environ.setdefault("GLOG_minloglevel", "2")
        os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
        import mediapipe as mp

        _drop_import_tracebacks()
        self._mp = mp
        self._open = ExitStack()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Give MediaPipe's threads and memory back."""
        self._open.close()

    def _load(self, path: Path, *members: str) -> list[Any]:
        """Load networks by their names in a zip, or one from a file that is itself a network. Raises
        LandmarkModelError where that fails."""
        vision = self._mp.tasks.vision
        try:
            if members:
                with zipfile.ZipFile(path) as task:
                    networks = [task.read(member) for member in members]
            else:
                networks = [path.read_bytes()]
            bases = [self._mp.tasks.BaseOptions(model_asset_buffer=network) for network in networks]
            made = (vision.ImageEmbedder.create_from_options(vision.ImageEmbedderOptions(b)) for b in bases)
            return [self._open.enter_context(network) for network in made]
        except (OSError, KeyError, zipfile.BadZipFile, RuntimeError, ValueError) as error:
            self._open.close()
            raise LandmarkModelError(
                f"{path}: MediaPipe cannot load this landmark model ({error}); assemble it again with "
                "scripts/fetch_landmark_model.py --force"
            ) from error

    def _run(self, network: Any, rgb: np.ndarray) -> Sequence[np.ndarray]:
        image = self._mp.Image(image_format=self._mp.ImageFormat.SRGB, data=rgb)
        return [output.embedding for output in network.embed(image).embeddings]


class Networks(Runner):
    """The palm network and the landmark networks.

    With quality `draft`, the landmark network of December 2020 replaces the present one where its file is
    there. Raises LandmarkModelError when the landmark model file is missing or damaged.
    """

    def __init__(
        self, landmark_model: str | os.PathLike[str] | None = None, *, quality: Quality = "standard"
    ) -> None:
        path = landmark_model_path(landmark_model)
        super().__init__()
        self.quality: Quality = quality
        self.threads = min(usable_threads(), NETWORK.max_threads)
        """How many threads run the networks on several crops of a picture"""
        self._landmark_model = landmark_model
        self._rendered: tuple[np.ndarray, Crop, np.ndarray] | None = None
        """The last picture, its crop and the crop's pixels, kept because both landmark networks see the same
        crop"""
        self._pool: ThreadPoolExecutor | None = None
        self._background: ThreadPoolExecutor | None = None
        """Looks for palms in a live picture while hands are followed into it"""
        self._idle: SimpleQueue[Networks | None] = SimpleQueue()
        """Networks that the pool's threads take and return; None stands for ones that are not loaded yet"""
        self._palms, self._hand = self._load(path, *(name for name, _ in TASK.entries))
        second = landmarks_2020_path()
        (self._hand_2020,) = [None] if second is None else self._load(second)

    def close(self) -> None:
        """Give MediaPipe's threads and memory back."""
        for pool in (self._pool, self._background):
            if pool is not None:
                pool.shutdown(cancel_futures=True)
        self._pool = self._background = None
        while not self._idle.empty():
            if (other := self._idle.get()) not in (None, self):
                other.close()
        super().close()

    def map(
        self, function: Callable[[Networks, Item], Result], items: Sequence[Item]
    ) -> Generator[Result, None, None]:
        """Yield function(networks, item) for each item, in order, from up to `threads` threads, each with
        networks of its own. A network's output depends on its crop alone, so the number of threads changes no
        result. Closing the generator cancels what has not begun."""
        if self.threads < 2 or len(items) < 2:
            yield from (function(self, item) for item in items)
            return
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self.threads, "handfit-networks")
            for networks in (self, *[None] * (self.threads - 1)):
                self._idle.put(networks)
        waiting = iter(items)

        def begun(count: int) -> Iterator[Future[Result]]:
            return (pool.submit(self._call, function, item) for item in islice(waiting, count))

        pool = self._pool
        futures = deque(begun(2 * self.threads))
        try:
            while futures:
                yield futures.popleft().result()
                futures.extend(begun(1))
        finally:
            for future in futures:
                future.cancel()

    def _call(self, function: Callable[[Networks, Item], Result], item: Item) -> Result:
        """Call a function with an item and with networks that no other thread uses meanwhile."""
        networks = self._idle.get() or Networks(self._landmark_model, quality=self.quality)
        try:
            return function(networks, item)
        finally:
            self._idle.put(networks)

    @property
    def is_draft(self) -> bool:
        """True if the landmark network of December 2020 replaces the present one."""
        return self.quality == "draft" and self._hand_2020 is not None

    def detect_palms(self, rgb: np.ndarray, crop: Crop, min_score: float) -> Palms:
        """Return the palms in a crop, `palm_input_px` wide, of a picture (H, W, 3) uint8 RGB, before
        non-maximum suppression."""
        boxes, logits = self._run(self._palms, crop.render(rgb))
        chosen = np.flatnonzero(logits >= np.log(min_score / (1.0 - min_score)))
        chosen = chosen[np.argsort(-logits[chosen], kind="stable")]
        numbers = boxes.reshape(-1, 9, 2)[chosen]
        numbers[:, 0] += NETWORK.palm_input_px * anchors()[chosen]
        numbers[:, 2:] += NETWORK.palm_input_px * anchors()[chosen][:, None]
        return Palms(
            score=1.0 / (1.0 + np.exp(-logits[chosen])),
            centre=(numbers[:, 0] - crop.offset) @ crop.inverse.T,
            side=numbers[:, 1].max(axis=1) / crop.scale,
            points=(numbers[:, 2:] - crop.offset) @ crop.inverse.T,
        )

    def predict(self, rgb: np.ndarray, crop: Crop, *, by_2020: bool = False) -> Detections:
        """Run the landmark network on a crop, `hand_input_px` wide, of a picture (H, W, 3) uint8 RGB; in
        drafts, or with `by_2020`, the one of December 2020, whose world landmarks are its keypoints at the
        size of an average hand. Returns one hand, whose `certainty` is its presence, the probability that the
        crop shows a hand, and whose `score` is that of the side."""
        rendered = self._rendered
        if rendered is None or rendered[0] is not rgb or rendered[1] is not crop:
            rendered = self._rendered = rgb, crop, crop.render(rgb)
        pixels = rendered[2]
        by_2020 = by_2020 or self.is_draft
        if by_2020:
            landmarks, (presence,), (right,) = self._run(self._hand_2020, pixels)
            keypoints = _with_depth(landmarks)
            world = average_sized(keypoints)
            odds = float(presence) / max(1.0 - float(presence), 1e-9) * np.exp(-NETWORK.presence_bias_2020)
            presence = odds / (1.0 + odds)
        else:
            landmarks, (presence,), (right,), world = self._run(self._hand, pixels)
            keypoints, world = _with_depth(landmarks), world.reshape(NUM_KEYPOINTS, 3).astype(np.float64)
        keypoints = crop.points_to_picture(keypoints)[None]
        return Detections(
            frame=np.zeros(1, dtype=np.int64),
            side=np.array([SIDES.index("right" if (right >= 0.5) != crop.mirrored else "left")]),
            score=np.array([max(float(right), 1.0 - float(right))]),
            keypoints=keypoints,
            world=crop.world_to_picture(world)[None],
            keypoints_2020=keypoints if by_2020 else None,
            certainty=np.array([float(presence)]),
        )

    @property
    def take_turns(self) -> bool:
        """True if the two landmark networks take turns in following the hands of a clip."""
        return self.quality == "standard" and self._hand_2020 is not None

    def with_keypoints_2020(self, rgb: np.ndarray, hand: Detections) -> Detections:
        """Add to a hand of a picture (H, W, 3) uint8 RGB the keypoints of the landmark network of December
        2020, where that network is there and the hand has none yet."""
        if self._hand_2020 is None or hand.asked_2020.all():
            return hand
        crop = crop_around(hand.keypoints[0])
        points = _with_depth(self._run(self._hand_2020, crop.render(rgb))[0])
        return replace(hand, keypoints_2020=crop.points_to_picture(points)[None])

    def submit(self, function: Callable[[], Result]) -> Future[Result]:
        """Call a function in a background thread, after those submitted before; at once, in this thread,
        where `threads` is 1."""
        if self.threads < 2:
            done: Future[Result] = Future()
            done.set_result(function())
            return done
        self._background = self._background or ThreadPoolExecutor(1, "handfit-background")
        return self._background.submit(function)


def average_sized(keypoints: np.ndarray) -> np.ndarray:
    """Return (21, 3) metres: keypoints (21, 3) about their mean, scaled to the size of an average hand."""
    bones = np.linalg.norm(keypoints[1:] - keypoints[list(KEYPOINT_PARENTS[1:])], axis=-1)
    return (keypoints - keypoints.mean(axis=0)) * (NETWORK.mean_bone / max(float(bones.mean()), 1e-9))


def _with_depth(landmarks: np.ndarray) -> np.ndarray:
    """Turn the output (63,) of a landmark network into (21, 3) pixels of its crop, with depth on the scale of
    x."""
    keypoints = landmarks.reshape(NUM_KEYPOINTS, 3).astype(np.float64)
    keypoints[:, 2] /= NETWORK.depth_scale
    return keypoints


def _drop_import_tracebacks() -> None:
    """Free what the import of MediaPipe keeps alive. Without a sound device it stores the error of an import,
    whose traceback holds the frames of all callers and so the detections of a whole clip."""
    error = getattr(sys.modules.get("mediapipe.tasks.python.audio.core.audio_record"), "sd_error", None)
    while isinstance(error, BaseException):
        error.__traceback__ = None
        error = error.__context__


@lru_cache
def anchors(grids: tuple[tuple[int, int], ...] = ((24, 2), (12, 6))) -> np.ndarray:
    """Return (A, 2) the anchors of a detector, in sides of the crop. Each grid is given as its places along a
    side and the anchors at each place; the default is the palm network's grids."""
    places = []
    for count, each in grids:
        middles = (np.arange(count) + 0.5) / count
        grid = np.stack(np.meshgrid(middles, middles), axis=-1).reshape(-1, 2)
        places.append(grid.repeat(each, axis=0))
    return np.concatenate(places)
