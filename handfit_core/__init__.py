"""Fit a rigged hand in MANO's format to photos, image sequences and videos.

    import handfit_core
    take = handfit_core.capture("clip.mp4")
    take.save("clip.take.npz")

Importing this package is light: SciPy, OpenCV and MediaPipe load with the first capture.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from handfit_core.errors import HandfitError
from handfit_core.geometry.camera import Intrinsics
from handfit_core.media.source import Source
from handfit_core.take import HandTrack, Take
from handfit_core.version import __version__

if TYPE_CHECKING:
    from handfit_core.pipeline import Progress, capture

__all__ = ["HandTrack", "HandfitError", "Intrinsics", "Progress", "Source", "Take", "__version__", "capture"]

_LAZY = {"capture", "Progress"}


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        from handfit_core import pipeline

        return getattr(pipeline, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
