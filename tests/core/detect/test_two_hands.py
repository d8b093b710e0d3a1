"""Painted hands of one person that cross: both are found, and each stays itself."""

import numpy as np
import pytest

from handfit_core.detect.clips import ClipFinder
from handfit_core.detect.detector import DetectorSettings
from handfit_core.detect.tracks import link_tracks
from handfit_core.skeleton import SIDES
from scripts.two_hands import KINDS, clip, pictures


@pytest.mark.usefixtures("landmark_model")
@pytest.mark.parametrize("seed", [0, 3])
def test_hands_that_cross_keep_their_sides(seed: int) -> None:
    shot = clip("cross", seed, frames=26)
    truth = {hand.side: shot.camera.project(hand.keypoints()) for hand in shot.hands}
    with ClipFinder(DetectorSettings(video=True)) as finder:
        found = finder.completed([finder.find(rgb) for rgb in pictures(shot)])
    tracks = {track.side: track for track in link_tracks(found)}
    assert set(tracks) == set(SIDES)
    overlapped = []
    for side, track in tracks.items():
        assert track.detected.mean() > 0.75
        assert track.detected[[0, -1]].all()
        for t, seen in enumerate(track.detections):
            if seen is not None and t not in range(9, 17):
                off = np.linalg.norm(seen.keypoints_2d - truth[side][t], axis=-1).mean()
                assert off < 0.15 * seen.extent
                assert seen.overlapped is None or t in range(5, 21)
            overlapped.append(seen is not None and seen.overlapped is not None)
    assert sum(overlapped) > 8


@pytest.mark.parametrize("kind", KINDS)
def test_clips_are_the_same_again_and_hands_meet(kind: str) -> None:
    first, again = clip(kind, 2, frames=50, size=64), clip(kind, 2, frames=50, size=64)
    one, other = (hand.keypoints() for hand in first.hands)
    np.testing.assert_array_equal(one, again.hands[0].keypoints())
    apart = np.linalg.norm(one.mean(axis=1) - other.mean(axis=1), axis=-1)
    assert apart.min() < 0.12 < apart.max()  # metres
    np.testing.assert_array_equal(next(pictures(first)), next(pictures(again)))
