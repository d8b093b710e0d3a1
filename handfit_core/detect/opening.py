"""The detector that a capture's options name."""

from __future__ import annotations

from handfit_core.capturing.options import CaptureOptions
from handfit_core.detect.detector import DETECTORS, Detector, DetectorSettings


def settings_of(options: CaptureOptions, *, video: bool = False) -> DetectorSettings:
    """The detector's settings by a capture's options; `video`: for the frames of one clip."""
    return DetectorSettings(
        options.most_hands(clip=video),
        video,
        options.threshold,
        options.landmark_model,
        options.quality,
        plain=options.plain_detection,
    )


def open_detector(options: CaptureOptions, *, video: bool = False) -> Detector:
    """The detector that a capture's options name, for the frames of one clip (`video`) or for stills.

    Raises OptionError where there is no such detector, LandmarkModelError.
    """
    return DETECTORS.get(options.detector).open(settings_of(options, video=video))
