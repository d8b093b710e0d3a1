"""Painted hands of one person that cross: both are found, and each stays itself."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from handfit_core import capture
from handfit_core.skeleton import SIDES
from tests.core.detect.two_hands import clip, pictures


@pytest.mark.usefixtures("landmark_model")
@pytest.mark.parametrize("seed", [0, 3])
def test_hands_that_cross_keep_their_sides(seed: int, tmp_path: Path) -> None:
    shot = clip("cross", seed, frames=26)
    truth = {hand.side: shot.camera.project(hand.keypoints()) for hand in shot.hands}
    for t, rgb in enumerate(pictures(shot)):
        cv2.imwrite(str(tmp_path / f"{t:04}.png"), rgb[..., ::-1])
    hands = {hand.side: hand for hand in capture(tmp_path, intrinsics=shot.camera).hands}
    assert set(hands) == set(SIDES)
    overlapped = []
    for side, hand in hands.items():
        assert hand.detected.mean() > 0.75
        off = np.linalg.norm(shot.camera.project(hand.joints_3d) - truth[side], axis=-1).mean(axis=-1)
        assert (off < np.where(np.abs(np.arange(26) - 12.5) < 4.0, 0.3, 0.1) * 170.0).all()  # pixels
        assert hand.overlapped is not None
        overlapped.append(hand.overlapped.any(axis=1))
    assert not np.any(overlapped, axis=0)[[0, 1, -2, -1]].any()
    assert np.sum(overlapped) > 8


@pytest.mark.usefixtures("landmark_model")
@pytest.mark.parametrize("seed", [10, 12])
def test_small_hands_at_few_frames_a_second_keep_their_tracks(seed: int, tmp_path: Path) -> None:
    shot = clip("roam", seed, frames=30, size=640, fps=6.25, away=1.6)
    truth = np.array([shot.camera.project(hand.keypoints()) for hand in shot.hands])
    for t, rgb in enumerate(pictures(shot)):
        cv2.imwrite(str(tmp_path / f"{t:04}.png"), rgb[..., ::-1])
    own = 0
    for track in capture(tmp_path, intrinsics=shot.camera).hands:
        off = np.linalg.norm(track.keypoints_2d - truth, axis=-1).mean(axis=-1)[:, track.detected]
        own += np.count_nonzero(off.argmin(axis=0) == [hand.side for hand in shot.hands].index(track.side))
    assert own > 0.9 * 60
