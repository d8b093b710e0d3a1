"""Detections beside the truth, from painted pictures: what the correction network learns from."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from handfit_core.detect.crops import Crop
from handfit_core.detect.keypoints import HandDetection
from handfit_core.detect.matching import mean_detection
from handfit_core.detect.networks import NETWORK, Networks, augmented_crops, crop_around, square_around
from handfit_core.detect.search import SEARCH
from handfit_core.geometry.camera import Intrinsics
from handfit_core.skeleton import SIDES, other_side
from scripts.benchmark.shots import Shot, ShotHand
from scripts.benchmark.stills import Poses, still_shot

from .painter import paint

SIZE = 320
"""pixels a side"""
VIEWS = 3
"""Detections per picture: as it is, then turned, zoomed and mirrored at random, which moves the
detector's errors at no cost of painting"""
_FARTHEST = 0.5
"""Of the hand's size; a detection that is farther from the truth is of something else"""
_OFF, _LARGER, _TURNED = 0.08, 0.12, 0.35
"""How far the first crop of a hand is off the truth's: parts of its side, logarithm of its side, radians"""


Sample = dict[str, Any]
"""One detected hand and the truth about it, as an npz file keeps it"""


def sample(
    detection: HandDetection,
    camera: Intrinsics,
    size: int,
    hand: ShotHand,
    joints_3d: np.ndarray,
    *,
    mirrored: bool,
) -> Sample:
    """A hand of a still, (21, 3) metres where the `camera` of a picture `size` pixels square sees its joints,
    and its detection. Where that picture shows the hand's mirror image, `side` is that of the image, and
    shape and pose are those of the hand."""
    return {
        "detected_side": SIDES.index(detection.side),
        "score": detection.score,
        "keypoints": detection.keypoints,
        "world": detection.world,
        "focal": camera.fx,
        "centre": np.array([camera.cx, camera.cy]),
        "size": size,
        "side": SIDES.index(other_side(hand.side) if mirrored else hand.side),
        "joints_3d": joints_3d,
        "betas": hand.betas,
        "hand_pose": hand.hand_pose[0],
        "mirrored": mirrored,
    }


def samples_of(
    seed: int, number: int, networks: Networks, size: int = SIZE, poses: Poses = "usual"
) -> tuple[int, list[Sample]]:
    """How many hands stand in all views of that still, and those that the landmark network sees, once it is
    shown where they are: those that only a search of all parts finds would be missing otherwise, and they are
    the hard ones. Half of them are single predictions, as of clips, the others means, as of photos."""
    shot = still_shot(seed, number, size, poses)
    rng = np.random.default_rng([seed, number, 7])
    picture = paint(shot, rng)
    found: list[Sample] = []
    for view in range(VIEWS):
        turn, zoom = (np.eye(2), 1.0) if view == 0 else _random_view(rng)
        seen = np.ascontiguousarray(picture if view == 0 else _viewed(picture, turn, zoom, shot))
        camera = Intrinsics(shot.camera.fx * zoom, shot.camera.fy * zoom, size / 2, size / 2)
        mirrored = bool(np.linalg.det(turn) < 0)
        for hand in shot.hands:
            points = hand.keypoints()[0].copy()
            points[:, :2] = points[:, :2] @ turn.T
            pixels = camera.project(points)
            detection = _detection_near(networks, seen, pixels, rng)
            if detection is None:
                continue
            off = np.linalg.norm(detection.keypoints_2d - pixels, axis=1).mean()
            if off <= _FARTHEST * np.ptp(pixels, axis=0).max():
                made = sample(detection, camera, size, hand, points, mirrored=mirrored)
                found.append({"number": number, "view": view, **made})
    return VIEWS * len(shot.hands), found


def _detection_near(
    networks: Networks, rgb: np.ndarray, pixels: np.ndarray, rng: np.random.Generator
) -> HandDetection | None:
    """What the landmark network finds near true points (21, 2), and finds again."""
    middle, span, turn = square_around(pixels)
    first = Crop.of_square(
        middle + rng.normal(size=2) * _OFF * span,
        span * float(np.exp(rng.normal() * _LARGER)),
        NETWORK.hand_input_px,
        turn=turn + rng.normal() * _TURNED,
    )
    prediction = networks.predict(rgb, first)
    prediction = networks.predict(rgb, crop_around(prediction.hand.keypoints))
    if prediction.presence < SEARCH.min_presence:
        return None
    if rng.random() < 0.5:
        return prediction.hand
    crops = augmented_crops(prediction.hand.keypoints)
    return mean_detection([networks.predict(rgb, crop).hand for crop in crops])


def _random_view(rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """A turn of the picture, maybe mirrored first (2, 2), and a zoom."""
    angle = rng.uniform(-np.pi, np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    if rng.random() < 0.5:
        turn = turn @ np.diag([-1.0, 1.0])
    return turn, float(np.exp(rng.uniform(-0.25, 0.25)))


def _viewed(picture: np.ndarray, turn: np.ndarray, zoom: float, shot: Shot) -> np.ndarray:
    """The picture turned and zoomed about the principal point, which goes to the middle."""
    size = shot.size
    linear = zoom * turn
    shift = size / 2 - linear @ np.array([shot.camera.cx, shot.camera.cy])
    # OpenCV's pixel centres are whole numbers, ours lie half a pixel further.
    shift = shift + linear @ np.array([0.5, 0.5]) - 0.5
    matrix = np.concatenate([linear, shift[:, None]], axis=1)
    return cv2.warpAffine(
        picture, matrix, (size, size), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
