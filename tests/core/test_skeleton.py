"""The joint and keypoint maps, against the published orders written out a second time."""

from __future__ import annotations

import numpy as np

from handfit_core import skeleton

# MediaPipe's documented order, as MANO joint numbers and fingertips (T, I, M, R, L).
PUBLISHED = [0, 13, 14, 15, "T", 1, 2, 3, "I", 4, 5, 6, "M", 10, 11, 12, "R", 7, 8, 9, "L"]


def test_keypoints_follow_mediapipes_order() -> None:
    joints = np.arange(16.0)[:, None] * np.ones(3)
    tips = 100.0 + np.arange(5.0)[:, None] * np.ones(3)
    keypoints = skeleton.keypoints_from_joints(joints, tips)
    expected = [100.0 + "TIMRL".index(k) if isinstance(k, str) else k for k in PUBLISHED]
    np.testing.assert_array_equal(keypoints[:, 0], expected)
    batch = skeleton.keypoints_from_joints(np.stack([joints, -joints]), np.stack([tips, -tips]))
    np.testing.assert_array_equal(batch, np.stack([keypoints, -keypoints]))


def test_every_joint_and_tip_is_one_keypoint() -> None:
    assert sorted(skeleton.KEYPOINT_SOURCE) == list(range(21))


def test_parents_are_manos() -> None:
    assert skeleton.PARENTS == (-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14)
    assert len(skeleton.JOINT_NAMES) == skeleton.NUM_JOINTS
    for first, second, third in skeleton.FINGER_JOINTS.values():
        assert [skeleton.PARENTS[j] for j in (first, second, third)] == [0, first, second]


def test_names_agree_with_numbers() -> None:
    for finger, joints in skeleton.FINGER_JOINTS.items():
        assert all(skeleton.JOINT_NAMES[j].startswith(f"{finger}_") for j in joints)
    for number, name in enumerate(skeleton.KEYPOINT_NAMES[1:], start=1):
        finger, place = name.split("_")
        source = skeleton.KEYPOINT_SOURCE[number]
        if place == "4":
            assert source == 16 + skeleton.FINGERS.index(finger)
            assert number in skeleton.TIP_KEYPOINTS
        else:
            assert source == skeleton.FINGER_JOINTS[finger][int(place) - 1]
    assert skeleton.KEYPOINT_NAMES[skeleton.INDEX_KNUCKLE_KEYPOINT] == "index_1"
    assert [skeleton.KEYPOINT_NAMES[k] for k in skeleton.PALM_KEYPOINTS] == [
        "wrist", "thumb_1", "index_1", "middle_1", "ring_1", "little_1"
    ]  # fmt: skip


def test_keypoint_parents_agree_with_the_joints_parents() -> None:
    place = {source: keypoint for keypoint, source in enumerate(skeleton.KEYPOINT_SOURCE)}
    for keypoint, parent in enumerate(skeleton.KEYPOINT_PARENTS):
        source = skeleton.KEYPOINT_SOURCE[keypoint]
        if keypoint == skeleton.WRIST_KEYPOINT:
            assert parent == -1
        elif source < 16:
            assert parent == place[skeleton.PARENTS[source]]
        else:
            finger = skeleton.FINGERS[source - 16]
            assert parent == place[skeleton.FINGER_JOINTS[finger][2]]


def test_other_side() -> None:
    assert [skeleton.other_side(side) for side in skeleton.SIDES] == ["right", "left"]
