"""Fit a rigged hand in MANO's format to photos, image sequences and videos.

    import handfit_core
    take = handfit_core.capture("clip.mp4")
    take.save("clip.take.npz")

Importing this package is light: SciPy, OpenCV and MediaPipe load with the first capture.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from handfit_core.common.errors import HandfitError
from handfit_core.common.version import __version__

if TYPE_CHECKING:
    from handfit_core.capturing.live.streaming import live
    from handfit_core.capturing.pipeline import Progress, capture
    from handfit_core.geometry.camera import Intrinsics
    from handfit_core.media.source import Source
    from handfit_core.take import HandTrack, Take

__all__ = [
    "HandTrack",
    "HandfitError",
    "Intrinsics",
    "Progress",
    "Source",
    "Take",
    "__version__",
    "capture",
    "live",
]

_LAZY = {
    "HandTrack": "take",
    "Intrinsics": "geometry.camera",
    "Progress": "capturing.pipeline",
    "Source": "media.source",
    "Take": "take",
    "capture": "capturing.pipeline",
    "live": "capturing.live.streaming",
}
"""Which module has what. None of them loads with the package: NumPy looks only when it loads at how many
threads it may have, and `python -m handfit_core` loads the package before it can say so"""


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(importlib.import_module(f"{__name__}.{_LAZY[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
