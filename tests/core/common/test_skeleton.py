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


def test_parents_are_manos():
    assert skeleton.PARENTS == (-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14)
    for first, second, third in skeleton.FINGER_JOINTS.values():
        assert [skeleton.PARENTS[j] for j in (first, second, third)] == [0, first, second]


def test_names_agree_with_numbers():
    fingers = ("thumb", "index", "middle", "ring", "little")
    names = ["wrist", *(f"{f}_{place}" for f in fingers for place in range(1, 5))]
    assert list(skeleton.KEYPOINT_NAMES) == names
    for finger, joints in skeleton.FINGER_JOINTS.items():
        assert all(skeleton.JOINT_NAMES[j].startswith(f"{finger}_") for j in joints)
        assert [PUBLISHED[skeleton.KEYPOINT_NAMES.index(f"{finger}_{i}")] for i in (1, 2, 3)] == list(joints)
    assert list(skeleton.TIP_KEYPOINTS) == [4, 8, 12, 16, 20]
    assert skeleton.INDEX_KNUCKLE_KEYPOINT == 5
    assert list(skeleton.PALM_KEYPOINTS) == [0, 1, 5, 9, 13, 17]
    assert [skeleton.other_side(side) for side in skeleton.SIDES] == ["right", "left"]
