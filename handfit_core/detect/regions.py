"""One frame for a detector, and the boxes in which somebody has seen a hand there."""

from __future__ import annotations

import logging
from collections.abc import Sequence

from handfit_core.detect.detector import Detector
from handfit_core.detect.keypoints import HandDetection
from handfit_core.media.source import Frame
from handfit_core.options import Region

log = logging.getLogger("handfit")


def looked_at(
    detector: Detector, frame: Frame, regions: Sequence[Region], *, first: bool
) -> tuple[HandDetection, ...]:
    """The hands of the next frame; those of its regions are looked for, and of regions without a frame in the
    `first` one."""
    found = detector.find(frame.rgb, frame.time)
    for region in regions:
        if region.frame == frame.number or (first and region.frame is None):
            box = (region.x, region.y, region.width, region.height)
            hand = None if frame.rgb is None else detector.look_in(frame.rgb, box)
            if hand is None:
                log.warning(
                    "no hand was found in the region %g,%g,%g,%g: draw the box closer around it, or over all "
                    "of it, or lay a hand there yourself with Add Hand in Blender",
                    *box,
                )
            else:
                found = (*found, hand)
    return found
