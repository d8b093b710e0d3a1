"""Whether two views belong together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from handfit_core.capturing.views.verdict import Evidence, degrees_apart, verdict_of
from handfit_core.geometry.rotations import rotvec_to_rotmat

GOOD = Evidence(3.3, 2.0, 1.2, 80, 70.0, 5.0, 0.8)


@pytest.mark.parametrize(
    ("changes", "agreement", "said"),
    [
        (
            {},
            "good",
            "Offset 3.30 frames, 80 frames in common, cameras 70 degrees apart, views agree to 2.0 px",
        ),
        ({"apart": 12.0}, "doubtful", "too close together (12 degrees)"),
        ({"common": 25}, "doubtful", "Only 25 frames are in common"),
        ({"score": 0.05}, "doubtful", "The fingers hardly move"),
        ({"left_open": (1.2, 1.0)}, "doubtful", "Where the second camera stands is uncertain"),
        ({"left_open": (9.0, 9.0), "cameras_known": True}, "good", ""),
        ({"residual": 1.9}, "doubtful", "agree badly"),
        ({"halves": 20.0}, "doubtful", "seem to have moved"),
        ({"dropped": 0.2}, "doubtful", "In 20% of the frames"),
        ({"residual": 2.5}, "failed", "do not agree"),
        ({"common": 12}, "failed", "in only 12 frames"),
        ({"apart": 1.0}, "failed", "same place"),
    ],
)
def test_verdict(changes, agreement, said):
    verdict = verdict_of(replace(GOOD, **changes))
    assert verdict.agreement == agreement
    assert said in verdict.text


def test_degrees_apart():
    quarter = rotvec_to_rotmat(np.array([0.0, np.pi / 2, 0.0]))
    # The second camera stands at (1, 0, 1) and looks at the hand from the side.
    point = np.array([[0.0, 0.0, 1.0]])
    assert degrees_apart(quarter, -quarter @ np.array([1.0, 0.0, 1.0]), point) == pytest.approx(90.0)
