"""The arm that a captured hand hangs on."""

from __future__ import annotations

import numpy as np

from handfit_core.common.arrays import array, array_dataclass


@array_dataclass
class ArmMotion:
    """One arm of a person over T frames, in metres, camera frame; NaN in frames without it.

    Only its directions, and where the shoulder lies from the wrist, are measured in some way; its lengths are
    a person's whose hand is of that size.
    """

    shoulder: np.ndarray = array("T", 3, finite="present")
    elbow: np.ndarray = array("T", 3, finite="present")
    wrist: np.ndarray = array("T", 3, finite="present")
    """(T, 3) metres: where the hand's wrist joint is in each frame"""
    lengths: np.ndarray = array(2, finite="all")
    """metres of the upper arm and the forearm, in all frames"""
    present: np.ndarray = array("T", kind="b")
    expected_error: np.ndarray = array("T", 2, finite="present")
    """radians that the upper arm's and the forearm's directions are likely to be off"""
