"""What the solver fits to: detections corrected by the network, in pixels, with a line of sight."""

from __future__ import annotations

import numpy as np

from handfit_core.detect.correction.canonical import canonical
from handfit_core.detect.correction.corrected import BlendWeights, landmarked
from handfit_core.detect.correction.network import landmark_network
from tests.core.fit.detections import columns, detections_of, poses
from tests.core.fit.differences import close

HANDS = detections_of("right", poses(6, seed=5))
DETECTIONS = columns(HANDS)


def test_trust_lies_between_detection_and_network() -> None:
    """In the plane and in depth, each by itself."""
    frame = canonical(DETECTIONS, DETECTIONS.side)
    said = frame.to_picture(landmark_network()(frame).points)
    none = landmarked(DETECTIONS, "right", BlendWeights(plane=0.0, depth=0.0))
    close(none.pixels, DETECTIONS.keypoints_2d)
    close(none.depth.mean(axis=1), 0.0)
    # Image and world landmarks are exact here, and so is their mean; perspective is all that is left.
    depth = DETECTIONS.keypoints[..., 2]
    off = none.depth - (depth - depth.mean(axis=1, keepdims=True))
    assert np.abs(off / DETECTIONS.extent[:, None]).max() < 0.08
    aim = said[..., 2] - said[..., 2].mean(axis=1, keepdims=True)
    for plane, depth in ((1.0, 1.0), (0.5, 0.5), (1.0, 0.0), (0.0, 1.0)):
        found = landmarked(DETECTIONS, "right", BlendWeights(plane=plane, depth=depth))
        close(found.pixels, (1.0 - plane) * none.pixels + plane * said[..., :2])
        close(found.depth, (1.0 - depth) * none.depth + depth * aim)
