"""One frame for a detector, and the boxes in which somebody has seen a hand there."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np

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
            found = (*found, *shown_in(detector, frame.rgb, region))
    return found


def shown_in(detector: Detector, rgb: np.ndarray | None, region: Region) -> tuple[HandDetection, ...]:
    """The hand of a region, if there is one; where there is none, that is told."""
    box = (region.x, region.y, region.width, region.height)
    hand = None if rgb is None else detector.look_in(rgb, box, region.side)
    if hand is None:
        log.warning(
            "no hand was found in the region %g,%g,%g,%g: draw the box closer around it, or over all of "
            "it, or lay a hand there yourself with Add Hand in Blender",
            *box,
        )
    return () if hand is None else (hand,)
