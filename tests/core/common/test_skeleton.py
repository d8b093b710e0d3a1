"""The joint and keypoint maps, against the published orders written out a second time."""

import numpy as np

from handfit_core.common import skeleton

# MediaPipe's documented order, as MANO joint numbers and fingertips (T, I, M, R, L), and its parents.
PUBLISHED = [0, 13, 14, 15, "T", 1, 2, 3, "I", 4, 5, 6, "M", 10, 11, 12, "R", 7, 8, 9, "L"]
PARENTS = (-1, 0, 1, 2, 3, 0, 5, 6, 7, 0, 9, 10, 11, 0, 13, 14, 15, 0, 17, 18, 19)


def test_keypoints_follow_mediapipes_order():
    joints = np.arange(16.0)[:, None] * np.ones(3)
    tips = 100.0 + np.arange(5.0)[:, None] * np.ones(3)
    keypoints = skeleton.keypoints_from_joints(joints, tips)
    expected = [100.0 + "TIMRL".index(k) if isinstance(k, str) else k for k in PUBLISHED]
    np.testing.assert_array_equal(keypoints[:, 0], expected)
    batch = skeleton.keypoints_from_joints(np.stack([joints, -joints]), np.stack([tips, -tips]))
    np.testing.assert_array_equal(batch, np.stack([keypoints, -keypoints]))
    assert skeleton.KEYPOINT_PARENTS == PARENTS
