"""The default detector: MediaPipe's networks, shown what we choose."""

from __future__ import annotations

from handfit_core.detect.clips import ClipFinder
from handfit_core.detect.detector import Backend, Detector, DetectorSettings
from handfit_core.detect.landmark_model import fingerprint
from handfit_core.detect.stills import StillFinder


def _open(settings: DetectorSettings) -> Detector:
    return (ClipFinder if settings.video else StillFinder)(settings)


DIRECT = Backend(open=_open, fingerprint=lambda settings: fingerprint(settings.landmark_model))
