"""The requests `check` and `warm`: using every heavy part once tells whether it works, and has it loaded.

In a check every part is tried by itself: what is missing or broken becomes a line, never an error of the
request. So the packages that it tries are imported inside functions.
"""

from __future__ import annotations

import importlib
import os
import platform
import sys
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from handfit_core.capturing.detection import open_detector
from handfit_core.capturing.options import CaptureOptions
from handfit_core.common.errors import Cancelled, HandfitError
from handfit_core.common.skeleton import SIDES, Side
from handfit_core.common.version import __version__
from handfit_core.detect.landmark_model import landmark_model_path, landmarks_2020_path
from handfit_core.edit import warm_up
from handfit_core.edit.refit import seen_hand
from handfit_core.fit.fast import fitter_of
from handfit_core.geometry.similarity import align
from handfit_core.hand_model import OPEN_HAND, load_model

PACKAGES: Final = ("numpy", "scipy", "cv2", "mediapipe")
"""What capturing imports"""

WORST_FIT_MM: Final = 7.0
"""More than the self-test's hand is off on any machine"""


def check(should_stop: Callable[[], bool]) -> dict[str, Any]:
    """The fields of the `done` event: `report`, lines that end in "ok" or "FAILED: reason", and `ok`, whether
    none failed. Raises Cancelled."""
    started = time.perf_counter()
    lines = [
        f"Hand capture core {__version__}",
        f"Python {platform.python_version()}, {_short(Path(sys.executable))}",
        f"{platform.platform()}, {platform.machine()}, {os.cpu_count()} processors",
    ]
    steps: list[tuple[str, Callable[[], str]]] = [
        *((name, partial(_package, name)) for name in PACKAGES),
        ("torch", _torch),
        ("landmark model", _landmark_model),
        ("landmarks of 2020", _landmarks_2020),
        ("self-test of the detector", _detector),
        ("self-test of the solver", _solver),
        ("self-test of re-fitting", _refitting),
    ]
    ok = True
    for name, step in steps:
        if should_stop():
            raise Cancelled("the check was stopped")
        try:
            lines.append(f"{name}: {step()}: ok")
        except Exception as error:  # whatever is wrong with an installation is what the report is for
            ok = False
            lines.append(f"{name}: FAILED: {' '.join(f'{type(error).__name__}: {error}'.split())}")
    lines.append(
        "Everything works."
        if ok
        else "Not everything works: install the add-on's zip again, or what FAILED into a Python of your own."
    )
    return {"report": "\n".join(lines), "ok": ok, "seconds": round(time.perf_counter() - started, 3)}


def warm(message: Mapping[str, Any], should_stop: Callable[[], bool]) -> dict[str, Any]:
    """Run the detector, the fast solver and a re-fit once; the fields of the `done` event.

    The request's `model` is the hand model that re-fits will use, null for the open hand. Raises
    LandmarkModelError, HandModelError, Cancelled, and ImportError where a package is missing.
    """
    started = time.perf_counter()
    model = message.get("model") or OPEN_HAND
    loading = [partial(importlib.import_module, name) for name in ("cv2", "scipy.optimize")]
    for step in (*loading, blank_picture_hands, synthetic_fit_error_mm, partial(warm_up, model)):
        if should_stop():
            raise Cancelled("loading was stopped")
        step()
    return {"seconds": round(time.perf_counter() - started, 3)}


def blank_picture_hands() -> int:
    """How many hands the detector sees in a grey picture. Raises LandmarkModelError."""
    with open_detector(CaptureOptions(plain_detection=True)) as finder:
        return len(finder.find(np.full((240, 320, 3), 128, dtype=np.uint8)))


def synthetic_fit_error_mm(side: Side = "right") -> float:
    """Mean distance in mm of the 21 keypoints that the fast solver finds, from those of the relaxed open hand
    that was projected for it, laid over each other."""
    model = load_model(None, side)
    hand = seen_hand(model, OPEN_HAND, side)
    fitter = fitter_of(model)
    seen = fitter.observe(hand.detections, hand.intrinsics)
    betas, *pose = fitter.chain.parameters(fitter.solve_pictures(seen)[1].state)
    found = model.keypoints(betas[0], *pose)[0]
    true = model.keypoints(None, *hand.pose)[0]
    laid = align(found, true, with_scale=True).apply(found)
    return float(np.linalg.norm(laid - true, axis=1).mean() * 1e3)


def _package(name: str) -> str:
    return str(getattr(importlib.import_module(name), "__version__", "of unknown version"))


def _torch() -> str:
    try:
        return _package("torch")
    except ModuleNotFoundError:
        return "not installed, which the paper's experiments alone would need"


def _landmark_model() -> str:
    path = landmark_model_path()
    return f"{path.name} in {_short(path.parent)}, {path.stat().st_size / 1e6:.1f} MB"


def _landmarks_2020() -> str:
    if (path := landmarks_2020_path()) is None:
        return "not there or not whole; all works without, but depths are less exact"
    return f"{path.name} in {_short(path.parent)}, {path.stat().st_size / 1e6:.1f} MB"


def _detector() -> str:
    count = blank_picture_hands()
    if count:
        raise HandfitError(f"it saw {count} hands in a blank picture")
    return "no hand in a blank picture"


def _solver() -> str:
    worst = max(synthetic_fit_error_mm(side) for side in SIDES)
    # Written so that NaN fails.
    if not worst < WORST_FIT_MM:
        raise HandfitError(f"a hand came out {worst:.1f} mm off")
    return f"{worst:.1f} mm off a known hand"


def _refitting() -> str:
    warm_up()
    started = time.perf_counter()
    warm_up()
    return f"{(time.perf_counter() - started) / len(SIDES) * 1e3:.0f} ms a frame"


def _short(path: Path) -> str:
    """A path without the user's name."""
    try:
        return str(Path("~") / path.relative_to(Path.home()))
    except (ValueError, RuntimeError):
        return str(path)
