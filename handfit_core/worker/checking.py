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

from handfit_core.detect.landmark_model import landmark_model_path, landmarks_2020_path
from handfit_core.detect.opening import open_detector
from handfit_core.edit import warm_up
from handfit_core.edit.refit import seen_hand
from handfit_core.errors import Cancelled, HandfitError, OptionError
from handfit_core.fit.fast import fitter_of
from handfit_core.geometry.similarity import align
from handfit_core.hand_model import OPEN_HAND, load_model
from handfit_core.options import CaptureOptions
from handfit_core.skeleton import SIDES, Side
from handfit_core.version import __version__
from handfit_core.worker.protocol import PROTOCOL

PACKAGES: Final[dict[str, tuple[str, tuple[int, ...]]]] = {
    "numpy": ("numpy", (1, 24)),
    "scipy": ("scipy", (1, 11)),
    "torch": ("torch", (2, 2)),
    "opencv-python-headless": ("cv2", (4, 9)),
    "mediapipe": ("mediapipe", (0, 10, 31)),
}
"""Name in the package index -> name to import, lowest version; as in pyproject.toml"""

OPTIONAL: Final = ("torch",)
"""Packages without which hands are captured all the same"""

WORST_FIT_MM: Final = 7.0
"""More than the self-test's hand is off on any machine"""

_REINSTALL: Final = "install the add-on's zip again"

_PRELOADED: Final = ("cv2", "scipy.optimize")
"""What a capture loads beside what the self-tests need"""


def check(should_stop: Callable[[], bool]) -> dict[str, Any]:
    """The fields of the `done` event: `report`, lines that end in "ok" or "FAILED: reason and remedy", and
    `ok`, whether none failed. Raises Cancelled."""
    started = time.perf_counter()
    lines = [
        f"Hand capture core {__version__}, worker protocol {PROTOCOL}",
        f"Python {platform.python_version()}, {_short(Path(sys.executable))}",
        f"{platform.platform()}, {platform.machine()}, {os.cpu_count()} processors",
    ]
    steps: list[tuple[str, Callable[[], str]]] = [
        *((name, partial(_package, name)) for name in PACKAGES),
        ("landmark model", _landmark_model),
        ("landmarks of 2020", _landmarks_2020),
        *((f"open hand, {side}", partial(_open_hand, side)) for side in SIDES),
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
            lines.append(f"{name}: FAILED: {_reason(error)}")
    lines.append("Everything works." if ok else "Not everything works; see FAILED above.")
    return {"report": "\n".join(lines), "ok": ok, "seconds": round(time.perf_counter() - started, 3)}


def warm(message: Mapping[str, Any], should_stop: Callable[[], bool]) -> dict[str, Any]:
    """Run the detector, the fast solver and a re-fit once; the fields of the `done` event.

    The request's `model` is the hand model that re-fits will use, null for the open hand. Raises
    LandmarkModelError, HandModelError, OptionError, Cancelled, and ImportError where a package is missing.
    """
    model = message.get("model") or OPEN_HAND
    if not isinstance(model, str):
        raise OptionError(f"a warm request's model must be a path or '{OPEN_HAND}', not {model!r}")

    started = time.perf_counter()
    later = [partial(importlib.import_module, name) for name in _PRELOADED]
    for step in (*later, blank_picture_hands, synthetic_fit_error_mm, partial(warm_up, model)):
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
    seen = fitter.observe([d for d in hand.detections if d is not None], hand.intrinsics)
    betas, *pose = fitter.chain.parameters(fitter.solve_pictures(seen)[1].state)
    found = model.keypoints(betas[0], *pose)[0]
    true = model.keypoints(None, *hand.pose)[0]
    laid = align(found, true, with_scale=True).apply(found)
    return float(np.linalg.norm(laid - true, axis=1).mean() * 1e3)


def _package(name: str) -> str:
    """The version of a package. Raises HandfitError, which also says where to get one that is missing."""
    module_name, lowest = PACKAGES[name]
    wanted = f"{name}>={'.'.join(map(str, lowest))}"
    remedy = f"{_REINSTALL}; a Python of your own needs {wanted}"
    try:
        version = str(getattr(importlib.import_module(module_name), "__version__", "unknown"))
    except ModuleNotFoundError as error:
        if name in OPTIONAL and error.name == module_name:
            return "not installed, which the paper's experiments alone would need"
        what = "not installed" if error.name == module_name else f"it lacks {error.name}"
        raise HandfitError(f"{what}; {remedy}") from error
    except (ImportError, OSError) as error:
        raise HandfitError(f"it does not load ({error}); {remedy}") from error
    if _numbers(version) < lowest:
        raise HandfitError(f"{version} is too old; {remedy}")
    return version


def _numbers(version: str) -> tuple[int, ...]:
    """The leading numbers of a version: 2.9.1+cpu -> (2, 9, 1)."""
    numbers: list[int] = []
    for part in version.split("+")[0].split("."):
        if not part.isdigit():
            break
        numbers.append(int(part))
    return tuple(numbers)


def _landmark_model() -> str:
    path = landmark_model_path()
    return f"{path.name} in {_short(path.parent)}, {path.stat().st_size / 1e6:.1f} MB"


def _landmarks_2020() -> str:
    if (path := landmarks_2020_path()) is None:
        return "not there or not whole; all works without, but depths are less exact"
    return f"{path.name} in {_short(path.parent)}, {path.stat().st_size / 1e6:.1f} MB"


def _open_hand(side: Side) -> str:
    return f"digest {load_model(None, side).digest}"


def _detector() -> str:
    count = blank_picture_hands()
    if count:
        raise HandfitError(
            f"it saw {count} hands in a blank picture; {_REINSTALL}, or fetch the landmark model again"
        )
    return "no hand in a blank picture"


def _solver() -> str:
    worst = max(synthetic_fit_error_mm(side) for side in SIDES)
    # Written so that NaN fails.
    if not worst < WORST_FIT_MM:
        raise HandfitError(
            f"a hand came out {worst:.1f} mm off; {_REINSTALL}, or NumPy and SciPy into a Python of your own"
        )
    return f"{worst:.1f} mm off a known hand"


def _refitting() -> str:
    warm_up()
    started = time.perf_counter()
    warm_up()
    return f"{(time.perf_counter() - started) / len(SIDES) * 1e3:.0f} ms a frame"


def _reason(error: Exception) -> str:
    text = " ".join(str(error).split())
    if isinstance(error, HandfitError):
        return text
    if isinstance(error, ImportError):
        return f"{text}; install what is missing, as the lines above tell"
    return f"{type(error).__name__}: {text}; please report this"


def _short(path: Path) -> str:
    """A path without the user's name."""
    try:
        return str(Path("~") / path.relative_to(Path.home()))
    except (ValueError, RuntimeError):
        return str(path)
