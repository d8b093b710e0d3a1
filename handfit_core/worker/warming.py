"""The request `warm`: load what later requests need, so that they answer at once."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from handfit_core.errors import Cancelled, OptionError
from handfit_core.hand_model import OPEN_HAND

_LATER = ("cv2", "scipy.optimize")
"""What a capture loads beside what the trials below need"""


def _load_the_rest() -> None:
    for name in _LATER:
        importlib.import_module(name)


def answer(message: Mapping[str, Any], should_stop: Callable[[], bool]) -> dict[str, Any]:
    """Run the detector, the fast solver and a re-fit once; the fields of the `done` event.

    The request's `model` is the hand model that re-fits will use, null for the open hand. Raises
    LandmarkModelError, HandModelError, OptionError, Cancelled, and ImportError where a package is missing.
    """
    model = message.get("model") or OPEN_HAND
    if not isinstance(model, str):
        raise OptionError(f"a warm request's model must be a path or '{OPEN_HAND}', not {model!r}")

    from handfit_core.edit import warm_up
    from handfit_core.worker.trial import blank_picture_hands, synthetic_fit_error_mm

    started = time.perf_counter()
    for step in (_load_the_rest, blank_picture_hands, synthetic_fit_error_mm, partial(warm_up, model)):
        if should_stop():
            raise Cancelled("loading was stopped")
        step()
    return {"seconds": round(time.perf_counter() - started, 3)}
