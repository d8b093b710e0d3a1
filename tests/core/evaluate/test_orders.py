"""Every joint order is a bijection, and means what the data set's own documentation says."""

from __future__ import annotations

import numpy as np
import pytest

from handfit_core.evaluate.datasets import orders
from handfit_core.skeleton import FINGERS, JOINT_NAMES, KEYPOINT_NAMES, KEYPOINT_PARENTS


@pytest.mark.parametrize("order", [orders.FREIHAND, orders.HO3D, orders.RHD])
def test_an_order_is_a_bijection(order: tuple[int, ...]) -> None:
    assert sorted(order) == list(range(21))
    points = np.random.default_rng(0).normal(size=(21, 3))
    there = points[list(order)]
    back = np.empty_like(points)
    back[list(order)] = there
    np.testing.assert_array_equal(back, points)


def test_ho3d_is_manos_joints_and_then_the_tips() -> None:
    names = [*JOINT_NAMES, *(f"{finger}_tip" for finger in FINGERS)]
    keypoints = [names[i] for i in orders.HO3D]
    assert keypoints[0] == "wrist"
    for k, name in enumerate(keypoints[1:], start=1):
        assert name.split("_")[0] == KEYPOINT_NAMES[k].split("_")[0]
    assert [keypoints[k] for k in (4, 8, 12, 16, 20)] == [f"{finger}_tip" for finger in FINGERS]
    # The authors' own picture of the order: MANO to "simple".
    assert orders.HO3D == (0, 13, 14, 15, 16, 1, 2, 3, 17, 4, 5, 6, 18, 10, 11, 12, 19, 7, 8, 9, 20)


def test_rhd_runs_from_the_tips_to_the_palm() -> None:
    # Its README: 1 thumb tip ... 4 thumb near the palm, 5 index tip, ..., 20 little finger near the palm.
    theirs = ["wrist", *(f"{finger}_{joint}" for finger in FINGERS for joint in (4, 3, 2, 1))]
    assert [theirs[i] for i in orders.RHD] == list(KEYPOINT_NAMES)
    assert (orders.RHD_HANDS["left"], orders.RHD_HANDS["right"]) == (slice(0, 21), slice(21, 42))


def test_tips_are_ends_of_fingers() -> None:
    assert not set(orders.FINGERTIPS) & set(KEYPOINT_PARENTS)
    tips = np.arange(15.0).reshape(5, 3)
    keypoints = orders.keypoints_of_tips(tips)
    for finger, tip in zip(FINGERS, tips, strict=True):
        np.testing.assert_array_equal(keypoints[KEYPOINT_NAMES.index(f"{finger}_4")], tip)
    assert np.isnan(keypoints).all(axis=1).sum() == 16
