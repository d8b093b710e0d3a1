"""A clip with two hands, made of the pictures of the sample."""

from pathlib import Path

import cv2
import numpy as np

from handfit_core.media.pictures import read_picture
from tests.conftest import ROOT

SAMPLE = ROOT / "samples" / "rendered_hand"


def picture(number: int) -> np.ndarray:
    """(480, 640, 3) uint8 RGB of the 24 of the sample, and back again."""
    number %= 46
    return read_picture(SAMPLE / f"hand.{1 + min(number, 46 - number):04}.jpg")[0]


def plain(rgb: np.ndarray) -> np.ndarray:
    """The picture's colours without a hand."""
    return np.broadcast_to(rgb.mean(axis=(0, 1)).astype(np.uint8), rgb.shape)


def write_two_hands(path: Path) -> None:
    """210 frames: a hand that stays, and its mirror image beside it, which is not always there."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 25.0, (960, 360))
    for i in range(210):
        rgb = picture(i)
        beside = rgb[:, ::-1] if 40 <= i < 80 or 90 <= i < 150 else plain(rgb)
        frame = cv2.resize(np.hstack([rgb, beside]), (960, 360), interpolation=cv2.INTER_AREA)
        writer.write(frame[..., ::-1].copy())
    writer.release()
