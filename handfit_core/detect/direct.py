"""The default detector: MediaPipe's networks, shown what we choose."""

from __future__ import annotations

from handfit_core.detect.detector import Backend
from handfit_core.detect.landmark_model import fingerprint
from handfit_core.detect.processes import detect_clip
from handfit_core.detect.stills import StillFinder

DIRECT = Backend(
    open=StillFinder, fingerprint=lambda settings: fingerprint(settings.landmark_model), clip=detect_clip
)
