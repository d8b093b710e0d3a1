"""MediaPipe's hand landmarker through its Tasks API."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from handfit_core.common.errors import LandmarkModelError
from handfit_core.common.skeleton import Side
from handfit_core.detect.detector import Backend, Detector, DetectorSettings
from handfit_core.detect.keypoints import Detections
from handfit_core.detect.landmark_model import fingerprint, is_calibrated, landmark_model_path

MAX_HANDS = 10
"""How many hands MediaPipe's graph looks for where all are wanted: it has a fixed number of places for them,
each of which costs time"""

MAX_SIDE_PX = 1920
"""Longest side in pixels of the pictures that MediaPipe gets; larger ones are downscaled to it, since the
networks' inputs have at most 224 pixels a side"""


class MediaPipeHands(Detector):
    """A graph of MediaPipe's, which has memory and threads that must be given back by `close`.

    With `video` it tracks hands from frame to frame, which is cheaper and steadier. One object serves a
    whole run. Raises LandmarkModelError when the model file is missing or damaged.
    """

    def __init__(self, settings: DetectorSettings) -> None:
        video, threshold = settings.video, settings.threshold
        path = landmark_model_path(settings.landmark_model)
        # MediaPipe and TensorFlow Lite greet on stderr; only real errors are of interest.
        os.environ.setdefault("GLOG_minloglevel", "2")
        os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
        import mediapipe as mp

        vision = mp.tasks.vision
        self._mp = mp
        self._video = video
        self._last_ms = -1
        options = vision.HandLandmarkerOptions(
            # The bytes and not the path: MediaPipe on Windows fails on paths that are not ASCII.
            base_options=mp.tasks.BaseOptions(model_asset_buffer=path.read_bytes()),
            running_mode=vision.RunningMode.VIDEO if video else vision.RunningMode.IMAGE,
            num_hands=settings.max_hands or MAX_HANDS,
            min_hand_detection_confidence=threshold,
            min_hand_presence_confidence=threshold,
            min_tracking_confidence=threshold,
        )
        try:
            self._landmarker = vision.HandLandmarker.create_from_options(options)
        except (RuntimeError, ValueError) as error:
            reason = (str(error).strip().splitlines() or [type(error).__name__])[0]
            raise LandmarkModelError(
                f"{path}: MediaPipe cannot load this landmark model ({reason}); assemble it "
                "again with scripts/fetch_landmark_model.py --force"
            ) from error

    def close(self) -> None:
        """Give MediaPipe's threads and memory back."""
        self._landmarker.close()

    def find(self, rgb: np.ndarray | None, time: float = 0.0) -> Detections:
        """Return the hands of a picture (see `Detector`); `time`, in seconds, is used for video only."""
        if rgb is None:
            return Detections.of([[]])
        height, width = rgb.shape[:2]
        image = self._mp.Image(image_format=self._mp.ImageFormat.SRGB, data=_downscaled(rgb))
        if self._video:
            # Times must rise strictly, in whole milliseconds.
            self._last_ms = max(self._last_ms + 1, round(time * 1000))
            result = self._landmarker.detect_for_video(image, self._last_ms)
        else:
            result = self._landmarker.detect(image)
        hands = (
            _detection(handedness[0], image_points, world_points, width, height)
            for handedness, image_points, world_points in zip(
                result.handedness, result.hand_landmarks, result.hand_world_landmarks, strict=True
            )
        )
        return Detections.of([hands])


def _downscaled(rgb: np.ndarray) -> np.ndarray:
    longer = max(rgb.shape[:2])
    if longer <= MAX_SIDE_PX:
        return np.ascontiguousarray(rgb)
    import cv2

    height, width = (max(1, round(side * MAX_SIDE_PX / longer)) for side in rgb.shape[:2])
    return cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA)


def _detection(
    category: Any, image_points: list[Any], world_points: list[Any], width: int, height: int
) -> Detections:
    side: Side = "left" if category.category_name == "Left" else "right"
    # Normalised by the width (x and z) and the height (y).
    keypoints = np.array([(p.x * width, p.y * height, p.z * width) for p in image_points])
    world = np.array([(p.x, p.y, p.z) for p in world_points])
    return Detections.hand(side, float(category.score), keypoints, world)


# The calibration holds for single predictions of the same networks: for 194 real hands, the mean expected
# error is 7.2 mm, and so is the mean true error.
MEDIAPIPE = Backend(
    open=MediaPipeHands,
    fingerprint=lambda settings: fingerprint(settings.landmark_model),
    calibrated=lambda settings: is_calibrated(settings.landmark_model),
)
