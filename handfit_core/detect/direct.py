"""The default detector: MediaPipe's networks without its graph."""

from __future__ import annotations

from handfit_core.detect.chunks import ClipDetector
from handfit_core.detect.detector import Backend
from handfit_core.detect.landmark_model import fingerprint, is_calibrated
from handfit_core.detect.stills import StillFinder

DIRECT = Backend(
    open=StillFinder,
    fingerprint=lambda settings: fingerprint(settings.landmark_model),
    clip=ClipDetector,
    calibrated=lambda settings: is_calibrated(settings.landmark_model),
)
