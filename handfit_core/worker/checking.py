"""The requests `warm`, which uses every heavy part once, and `check`, which tells their versions after it."""

from __future__ import annotations

import platform
import sys
import time
from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from typing import Any, Final

import numpy as np

from handfit_core.capturing.detection import open_detector
from handfit_core.capturing.options import CaptureOptions
from handfit_core.common.errors import Cancelled
from handfit_core.common.version import __version__
from handfit_core.edit import warm_up
from handfit_core.hand_model import OPEN_HAND

PACKAGES: Final = ("numpy", "scipy", "cv2", "mediapipe", "av")
"""The packages that capturing imports"""


def check(should_stop: Callable[[], bool]) -> dict[str, Any]:
    """Use every heavy part once; returns the fields of the `done` event: `versions`, a text. Raises what
    `warm` raises."""
    warm({}, should_stop)
    packages = [f"{name} {getattr(import_module(name), '__version__', 'unknown')}" for name in PACKAGES]
    python = f"Python {platform.python_version()}, {sys.executable}"
    return {"versions": "\n".join([f"handfit_core {__version__}", python, *packages])}


def warm(message: Mapping[str, Any], should_stop: Callable[[], bool]) -> dict[str, Any]:
    """Run the detector and a re-fit once; returns the fields of the `done` event.

    The request's `model` is the hand model that re-fits will use, null for the open hand. Raises
    LandmarkModelError, HandModelError, Cancelled, and ImportError where a package is missing.
    """
    started = time.perf_counter()
    for step in (_look_at_a_blank_picture, partial(warm_up, message.get("model") or OPEN_HAND)):
        if should_stop():
            raise Cancelled("loading was stopped")
        step()
    return {"seconds": round(time.perf_counter() - started, 3)}


def _look_at_a_blank_picture() -> None:
    with open_detector(CaptureOptions(plain_detection=True)) as finder:
        finder.find(np.full((240, 320, 3), 128, dtype=np.uint8))
