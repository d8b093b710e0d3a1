"""Detections of posed hands whose truth is known: tracks stay on their hands over the whole clip."""

from dataclasses import dataclass

import numpy as np
import pytest

from handfit_core.common.skeleton import SIDES, Side, other_side
from handfit_core.detect.keypoints import Detections
from handfit_core.detect.tracks import link_tracks

SIZE = 60.0
"""pixels"""


@dataclass(frozen=True)
class Scene:
    """Hands that roam about a picture, each on its own way."""

    sides: tuple[Side, ...] = SIDES
    fps: float = 6.0
    seconds: float = 16.0
    reach: float = 220.0
    """pixels"""
    unsure: float = 0.05
    """by how much detections of left hands are taken for right ones"""
    dropped: float = 0.03
    """share of detections that are missing"""
    faces: float = 0.0
    """share of frames in which something is taken for a hand"""

    def found(self, seed: int) -> tuple[list[list[Detections]], dict[int, int]]:
        """Detections of each frame, in any order, and whose they are, by the `id` of their keypoints."""
        rng, count = np.random.default_rng(seed), len(self.sides)
        t = np.arange(int(self.fps * self.seconds)) / self.fps
        waves = 2 * np.pi * t[:, None, None] / rng.uniform(1.2, 3.0, (count, 1, 3, 2))
        ways = 320 + self.reach * np.sin(waves + rng.uniform(0, 6, (count, 1, 3, 2))).mean(axis=2)
        right = rng.uniform(-0.5, 0.5, (21, 3)) * SIZE
        frames, whose = [], {}
        for row in range(len(t)):
            there = []
            for i, side in enumerate(self.sides):
                nearer = np.linalg.norm(ways[:i, row] - ways[i, row], axis=-1) < 0.45 * SIZE
                if nearer.any() or rng.random() < self.dropped:
                    continue  # lost behind another hand
                shape = right * [1.0 if side == "right" else -1.0, 1.0, 1.0]
                shape *= 1.0 + 0.2 * self.sides[:i].count(side)  # another person's
                points = shape + [*ways[i, row], 0.0] + rng.normal(0, 0.02 * SIZE, (21, 3))
                sure = np.clip(1.0 - (side == "left") * self.unsure + rng.normal(0, 0.05), 0.0, 1.0)
                named = side if rng.random() < 0.95 else other_side(side)
                there.append(Detections.hand(named, 0.9, points, points / 1000, right_side=sure))
                whose[points.tobytes()] = i
            if rng.random() < self.faces:
                points = right[::-1] + [*rng.uniform(220, 420, 2), 0.0]
                there.append(Detections.hand(SIDES[row % 2], 0.5, points, points / 1000, right_side=0.6))
                whose[points.tobytes()] = -1
            frames.append([there[i] for i in rng.permutation(len(there))])
        return frames, whose


SCENES = {
    "small fast hands": Scene(),
    "one side in doubt": Scene(unsure=0.35),
    "often lost": Scene(dropped=0.25),
    "a face taken for a hand": Scene(faces=0.1),
    "two left hands": Scene(("left", "left"), fps=12.0),
}


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_tracks_stay_on_their_hands(scene):
    kept = seen = 0
    for seed in range(4):
        frames, whose = scene.found(seed)
        taken: list[int] = []
        for track in link_tracks(Detections.of(frames), len(frames), max_hands=len(scene.sides)):
            owners = [whose[points.tobytes()] for points in track.detections.keypoints]
            hand = max(set(owners), key=owners.count)
            assert track.side == scene.sides[hand]
            kept += owners.count(hand)
            taken.append(hand)
        assert len(set(taken)) == len(scene.sides)
        seen += sum(owner >= 0 for owner in whose.values())
    assert kept > 0.96 * seen


def test_given_sides_are_kept():
    """The hands meet and seem to pass; the given sides say that they parted again."""
    shape = np.random.default_rng(3).uniform(-30, 30, (21, 3))

    def hand(x: float, given: Side | None = None) -> Detections:
        points = shape + [x, 300.0, 0.0]
        side = None if given is None else SIDES.index(given)
        return Detections.hand("right", 0.9, points, points / 1000, right_side=0.5, given_side=side)

    frames = [[hand(100.0 + 20.0 * t), hand(500.0 - 20.0 * t)] for t in range(21)]
    frames[2] = [hand(140.0, "left"), hand(460.0)]
    frames[18] = [hand(460.0, "right"), hand(140.0)]
    tracks = {track.side: track for track in link_tracks(Detections.of(frames), len(frames))}
    for side, places in (("left", (140.0, 140.0)), ("right", (460.0, 460.0))):
        detections = tracks[side].detections
        told = np.isin(detections.frame, [2, 18])
        assert (detections.keypoints - shape)[told, 0, 0] == pytest.approx(places)
