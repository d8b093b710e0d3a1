"""The rendered hand and its mirror image pass each other: both are found, and each stays itself."""

import cv2
import numpy as np
import pytest

from handfit_core import Take, capture
from handfit_core.common.skeleton import SIDES
from tests.core.detect.clips import SAMPLE, picture

WIDTH = 640


@pytest.mark.usefixtures("landmark_model")
@pytest.mark.parametrize(("frames", "scale"), [pytest.param(24, 1.0, marks=pytest.mark.slow), (12, 0.25)])
def test_crossing_hands_keep_their_sides(frames, scale, tmp_path):
    places = np.linspace(0, WIDTH, frames).round().astype(int)
    for t, x in enumerate(places):
        hand = picture(t)
        ground = hand[:, :1].astype(int)
        frame = np.tile(hand[:, :1], (1, 2 * WIDTH, 1))
        for layer, at in ((hand[:, ::-1], WIDTH - x), (hand, x)):
            shown = np.abs(layer - ground).sum(axis=-1) > 60
            frame[:, at : at + WIDTH][shown] = layer[shown]
        small = cv2.resize(frame, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(tmp_path / f"{t:04}.png"), small[..., ::-1])

    hands = {hand.side: hand for hand in capture(tmp_path).hands}
    assert set(hands) == set(SIDES)
    apart = np.abs(places - WIDTH / 2) > 200
    shift = np.stack([places, 0 * places], axis=-1)[:, None]
    truth = {"right": Take.load(SAMPLE / "truth.take.npz").hands[0].keypoints_2d[:frames] + shift}
    truth["left"] = truth["right"] * [-1, 1] + [2 * WIDTH, 0]
    for side, hand in hands.items():
        assert hand.detected.mean() > 0.75
        assert hand.detected[apart].all()
        off = np.linalg.norm(hand.keypoints_2d / scale - truth[side], axis=-1).mean(axis=-1)
        assert np.nanmax(off) < 40.0  # a finger's width
        assert hand.rows.overlapped is not None
        overlapped = hand.rows.overlapped.any(axis=1)
        assert not overlapped[apart].any()
        assert overlapped.sum() > 2
