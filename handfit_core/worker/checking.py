"""The request `check`: versions, files and a self-test, as text for a bug report.

Every part is tried by itself: what is missing or broken becomes a line, never an error of the request.
"""

from __future__ import annotations

import hashlib
import importlib
import os
import platform
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from handfit_core.errors import Cancelled, HandfitError
from handfit_core.skeleton import SIDES
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

ASSEMBLED_MODEL_SHA256: Final = "7462e38bc4b5eb36699bb7f406e28e9768e70b0b073e0cf8a8da419ea4b8fa02"
"""Of the hand_landmarker.task that scripts/fetch_landmark_model.py makes"""

BUNDLED_VARIABLE: Final = "HANDFIT_BUNDLED"
"""Set in the environment where the packages come from the add-on's zip"""
LEFT_OUT_VARIABLE: Final = "HANDFIT_LEFT_OUT"
"""Names those, with commas, that this zip lacks for this Python on purpose"""

_ZIP_AGAIN: Final = "remove the add-on, restart Blender and install its zip again"

WORST_FIT_MM: Final = 7.0
"""More than the self-test's hand is off on any machine"""


def answer(should_stop: Callable[[], bool]) -> dict[str, Any]:
    """The fields of the `done` event: `report`, lines that end in "ok" or "FAILED: reason and remedy", and
    `ok`, whether none failed. Raises Cancelled."""
    started = time.perf_counter()
    lines = [
        f"Hand capture core {__version__}, worker protocol {PROTOCOL}",
        f"Python {platform.python_version()}, {_short(Path(sys.executable))}",
        f"{platform.platform()}, {platform.machine()}, {os.cpu_count()} processors",
    ]
    steps: list[tuple[str, Callable[[], str]]] = [
        *((name, _package(name)) for name in PACKAGES),
        ("landmark model", _landmark_model),
        *((f"open hand, {side}", _open_hand(side)) for side in SIDES),
        ("self-test of the detector", _detector),
        ("self-test of the solver", _solver),
        ("self-test of re-fitting", _refitting),
    ]
    all_well = True
    for name, step in steps:
        if should_stop():
            raise Cancelled("the check was stopped")
        try:
            lines.append(f"{name}: {step()}: ok")
        except Exception as error:  # whatever is wrong with an installation is what the report is for
            all_well = False
            lines.append(f"{name}: FAILED: {_reason(error)}")
    lines.append("Everything works." if all_well else "Not everything works; see FAILED above.")
    return {
        "report": "\n".join(lines),
        "ok": all_well,
        "seconds": round(time.perf_counter() - started, 3),
    }


def _package(name: str) -> Callable[[], str]:
    def find() -> str:
        module_name, lowest = PACKAGES[name]
        wanted = ".".join(map(str, lowest))
        remedy = _how_to_get(name, wanted)
        try:
            version = str(getattr(importlib.import_module(module_name), "__version__", "unknown"))
        except ModuleNotFoundError as error:
            if error.name == module_name:
                raise _Remedy(f"not installed; {remedy}") from error
            raise _Remedy(f"it lacks {error.name}; {remedy}") from error
        except (ImportError, OSError) as error:
            raise _Remedy(f"it does not load ({error}); {remedy}") from error
        if _numbers(version) < lowest:
            raise _Remedy(f"{version} is too old; {remedy}")
        return version

    return find


def _how_to_get(name: str, lowest: str) -> str:
    """Where the add-on's zip brings the packages, nobody is to install them into Blender's own Python."""
    if name in os.environ.get(LEFT_OUT_VARIABLE, "").split(","):
        return "the add-on's zip does not have it for this Python: choose a Python of your own"
    if os.environ.get(BUNDLED_VARIABLE):
        return f"{_ZIP_AGAIN}, or choose a Python of your own"
    return f"install {name}>={lowest} into this Python, or choose another one"


def _again(remedy: str) -> str:
    """What to do about a part that is there and does not work."""
    return _ZIP_AGAIN if os.environ.get(BUNDLED_VARIABLE) else remedy


def _numbers(version: str) -> tuple[int, ...]:
    """The leading numbers of a version: 2.9.1+cpu -> (2, 9, 1)."""
    numbers: list[int] = []
    for part in version.split("+")[0].split("."):
        if not part.isdigit():
            break
        numbers.append(int(part))
    return tuple(numbers)


def _landmark_model() -> str:
    from handfit_core.detect.landmark_model import landmark_model_path

    path = landmark_model_path()
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    known = "as assembled" if digest == ASSEMBLED_MODEL_SHA256 else "not the one that fetching assembles"
    return f"{path.name} in {_short(path.parent)}, sha256 {digest[:12]} ({known})"


def _open_hand(side: str) -> Callable[[], str]:
    def load() -> str:
        from handfit_core.hand_model import load_model

        return f"digest {load_model(None, 'left' if side == 'left' else 'right').digest}"

    return load


def _detector() -> str:
    from handfit_core.worker.trial import blank_picture_hands

    count = blank_picture_hands()
    if count:
        raise _Remedy(f"it saw {count} hands in a blank picture; {_again('fetch the landmark model again')}")
    return "no hand in a blank picture"


def _solver() -> str:
    from handfit_core.worker.trial import synthetic_fit_error_mm

    worst = max(synthetic_fit_error_mm(side) for side in SIDES)
    # Written so that NaN fails.
    if not worst < WORST_FIT_MM:
        again = _again("install torch and handfit-core again")
        raise _Remedy(f"a hand came out {worst:.1f} mm off; {again}")
    return f"{worst:.1f} mm off a known hand"


def _refitting() -> str:
    from handfit_core.edit import warm_up

    warm_up()
    started = time.perf_counter()
    warm_up()
    return f"{(time.perf_counter() - started) / len(SIDES) * 1e3:.0f} ms a frame"


class _Remedy(HandfitError):
    """A reason and what to do."""


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
