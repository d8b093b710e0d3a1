"""Detection of the hands in one frame, and in its regions: the boxes in which a person sees hands."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence

import numpy as np

from handfit_core.detect.detector import Detector, Region
from handfit_core.detect.keypoints import Detections
from handfit_core.media.source import Frame

log = logging.getLogger("handfit")


def detect_frame(detector: Detector, frame: Frame, regions: Sequence[Region], *, first: bool) -> Detections:
    """Detect the hands of the next frame and of the regions that name it; regions without a frame number
    belong to the `first` frame."""
    found = detector.find(frame.rgb, frame.time)
    for region in regions:
        if region.frame == frame.number or (first and region.frame is None):
            found = Detections.of([[found, detect_region(detector, frame.rgb, region, found)]])
    return found


def detect_region(
    detector: Detector, rgb: np.ndarray | None, region: Region, known: Iterable[Detections] = ()
) -> Detections:
    """Return the hand of a region of the picture that `find` was given last, as `Detector.detect_in_box`
    finds it; `Detections` without a row, and a warning, where there is none."""
    box = (region.x, region.y, region.width, region.height)
    hand = None if rgb is None else detector.detect_in_box(rgb, box, region.side, known)
    if hand is None:
        log.warning(
            "no hand was found in the region %g,%g,%g,%g: draw the box closer around it, or over all of "
            "it, or lay a hand there yourself with Add Hand in Blender",
            *box,
            extra={"offer": "add_hand"},
        )
    return Detections.of([[]]) if hand is None else hand
