"""Fewer keys: the bounds hold on every dense frame, keys hold what was there, and few are left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from math import comb
from typing import Any

import numpy as np
import pytest

from handfit_core.common.skeleton import NUM_JOINTS, TIP_KEYPOINTS
from handfit_core.common.slices import run_to_completion
from handfit_core.edit.simplify import LOCATION, Channels, Sight, Simplified, Spline, simplifying
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import channels_to_quat, quat_multiply, rotvec_to_quat, unflip_quats
from handfit_core.hand_model import load_model
from handfit_core.hand_model.axes import RestPose, bone_frames, points_to_rest
from handfit_core.retarget.transfer import SourceHand


def turning(count: int, noise: float, seed: int = 0) -> np.ndarray:
    """(N, 4) quaternions of a bone that swings, with so many radians of noise in each frame."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, count / 40.0, count)[:, None]
    swing = np.sin(2.0 * np.pi * (t * rng.uniform(0.3, 1.2, 3) + rng.uniform(size=3))) * rng.uniform(
        0.1, 0.8, 3
    )
    jitter = rotvec_to_quat(rng.normal(scale=noise, size=(count, 3)))
    return unflip_quats(quat_multiply(rotvec_to_quat(swing), jitter))


def played(spline: Spline, frames: np.ndarray, at: np.ndarray) -> np.ndarray:
    """What Bezier curves through the keys and handles say at these times, by Bernstein's polynomials."""
    values = np.broadcast_to(spline.values[0], (len(at), spline.values.shape[1])).copy()
    before, behind = spline.handles(frames)
    places = frames[spline.rows]
    for k, (start, end) in enumerate(pairwise(places)):
        np.testing.assert_allclose(behind[k, :, 0], (2 * start + end) / 3)
        np.testing.assert_allclose(before[k + 1, :, 0], (start + 2 * end) / 3)
        inside = (at >= start) & (at <= end)
        t = ((at[inside] - start) / (end - start))[:, None]
        corners = spline.values[k], behind[k, :, 1], before[k + 1, :, 1], spline.values[k + 1]
        values[inside] = sum(
            comb(3, i) * t**i * (1 - t) ** (3 - i) * corner for i, corner in enumerate(corners)
        )
    return values


def degrees_off(track: Channels, spline: Spline, frames: np.ndarray) -> float:
    dense = channels_to_quat(track.values, track.mode)
    shown = channels_to_quat(played(spline, frames, frames), track.mode)
    return float(np.degrees(2.0 * np.arccos(np.minimum(np.abs(np.sum(dense * shown, axis=-1)), 1.0))).max())


def simplified(frames: np.ndarray, channels: Sequence[Channels], *bounds: float, **more: Any) -> Simplified:
    return run_to_completion(simplifying(frames, channels, *bounds, **more))


def keys_of(found: Simplified) -> int:
    return sum(len(spline.rows) for spline in found.splines)


@pytest.mark.parametrize("noise", [0.0, 0.004, 0.05])
@pytest.mark.parametrize("bound", [0.5, 2.0, 10.0])
def test_rotation_bound(noise, bound):
    frames = 7.0 + 0.8 * np.arange(120)
    tracks = [Channels(turning(120, noise, seed), "QUATERNION", group=seed // 2) for seed in range(4)]
    found = simplified(frames, tracks, bound)
    off = [degrees_off(*pair, frames) for pair in zip(tracks, found.splines, strict=True)]
    assert max(off) <= bound
    assert found.degrees == pytest.approx(max(off), abs=1e-3)
    assert found.pixels is None
    for track, spline in zip(tracks, found.splines, strict=True):
        assert spline.rows[[0, -1]].tolist() == [0, 119]
        np.testing.assert_array_equal(spline.values, track.values[spline.rows])
    for one, other in ((0, 1), (2, 3)):
        np.testing.assert_array_equal(found.splines[one].rows, found.splines[other].rows)


def test_looser_bounds_fewer_keys():
    frames = np.arange(150.0)
    motions = [turning(150, 0.004, seed) for seed in range(6)]
    together = [Channels(motion, "QUATERNION") for motion in motions]
    alone = [Channels(motion, "QUATERNION", group=i) for i, motion in enumerate(motions)]
    counts = [keys_of(simplified(frames, together, bound)) for bound in (0.5, 2.0, 8.0)]
    assert counts[0] > counts[1] > counts[2]
    assert keys_of(simplified(frames, alone, 2.0)) < counts[1] < 0.5 * 6 * 150


@pytest.mark.parametrize("mode", ["XYZ", "ZXY", "AXIS_ANGLE"])
def test_rotation_modes(mode):
    frames = np.arange(200.0)
    values = 0.9 * np.sin(frames[:, None] / 30.0 * [1.0, 1.7, 2.3] + [0.0, 1.0, 2.0])
    if mode == "AXIS_ANGLE":
        values = np.concatenate([1.0 + values[:, :1], np.tile([0.6, 0.0, 0.8], (200, 1))], axis=-1)
    track = Channels(values, mode)
    (spline,) = simplified(frames, [track], 1.0).splines
    assert degrees_off(track, spline, frames) <= 1.0
    assert len(spline.rows) < 60


def test_what_does_not_move_keeps_two_keys():
    still = Channels(np.tile(turning(1, 0.0), (90, 1)), "QUATERNION")
    place = Channels(np.tile([0.1, -0.2, 0.3], (90, 1)), "LOCATION", 1, arm=0.1)
    found = simplified(np.arange(90.0), [still, place], 0.1)
    assert [spline.rows.tolist() for spline in found.splines] == [[0, 89], [0, 89]]
    assert found.degrees == pytest.approx(0.0, abs=1e-6)
    np.testing.assert_allclose(found.splines[1].slopes, 0.0, atol=1e-12)


def test_rows_that_are_to_stay_stay():
    found = simplified(np.arange(120.0), [Channels(turning(120, 0.0), "QUATERNION")], 5.0, kept=[17, 18, 64])
    assert {17, 18, 64} <= set(found.splines[0].rows.tolist())


@pytest.mark.parametrize("count", [1, 2, 3])
def test_very_short_motions(count):
    frames = np.arange(5.0, 5.0 + count)
    (spline,) = simplified(frames, [Channels(turning(count, 0.3), "QUATERNION")], 0.01).splines
    assert spline.rows.tolist() == list(range(count))
    before, behind = spline.handles(frames)
    assert np.isfinite([before, behind]).all()
    assert (before[..., 0] < frames[:, None]).all()
    assert (behind[..., 0] > frames[:, None]).all()


def test_quaternions_stay_near_unit():
    frames = np.arange(300.0)
    (spline,) = simplified(frames, [Channels(turning(300, 0.0, seed=3), "QUATERNION")], 2.0).splines
    between = played(spline, frames, np.arange(0.0, 299.0, 0.1))
    np.testing.assert_allclose(np.linalg.norm(between, axis=-1), 1.0, atol=0.05)
    assert np.abs(np.diff(between, axis=0)).max() < 0.02


def seen_hand(count: int) -> tuple[list[Channels], Sight]:
    """A hand half a metre before a camera, whose bones all swing."""
    shaped = load_model("open-hand", "right").shaped()
    rest = RestPose("right", bone_frames(shaped, "right"), points_to_rest(shaped.joints[0]))
    quats = np.stack([turning(count, 0.002, seed) for seed in range(NUM_JOINTS)], axis=1)
    t = np.linspace(0.0, 6.0, count)
    places = np.stack([0.1 * np.sin(t), 0.5 + 0.05 * np.cos(t), 0.02 * np.sin(2 * t)], axis=-1)
    places = (places - rest.wrist) @ rest.frames[0]
    sight = Sight(rest, SourceHand.of(shaped, "right"), Intrinsics(900.0, 950.0, 320.0, 240.0), quats, places)
    tracks = [Channels(quats[:, j], "QUATERNION", j, joint=j) for j in range(NUM_JOINTS)]
    return [*tracks, Channels(places, "LOCATION", LOCATION, arm=0.1, joint=LOCATION)], sight


def test_sight_projects_model():
    sight, model = seen_hand(5)[1], load_model("open-hand", "right")
    pose = sight.rest.from_bones(model.shaped(), sight.quats, sight.locations)
    bend = np.linalg.norm(sight.points(sight.quats, sight.locations) - model.keypoints(None, *pose), axis=-1)
    assert bend.max() < 4e-3  # pose blend shapes move fingertips
    assert np.delete(bend, TIP_KEYPOINTS, axis=1).max() < 1e-9


@pytest.mark.parametrize(
    ("joints", "pixels"),
    [(range(NUM_JOINTS + 1), 3.0), (range(NUM_JOINTS + 1), 1.0), ([13, 14, 15, 16], 1.5)],
)
def test_pixel_bound(joints, pixels):
    """Of all joints and the location, or of some, which are grouped anew."""
    tracks, sight = seen_hand(80)
    own, frames = [replace(tracks[j], group=i) for i, j in enumerate(joints)], np.arange(80.0)
    found = simplified(frames, own, 4.0, pixels, sight=sight)
    quats, places = sight.quats.copy(), sight.locations
    for joint, spline in zip(joints, found.splines, strict=True):
        values = played(spline, frames, frames)
        if joint == LOCATION:
            places = values
        else:
            quats[:, joint] = channels_to_quat(values, "QUATERNION")
    pictures = [
        sight.intrinsics.project(sight.points(*p)) for p in ((quats, places), (sight.quats, sight.locations))
    ]
    off = np.linalg.norm(pictures[0] - pictures[1], axis=-1)
    assert found.pixels == pytest.approx(off.max(), abs=1e-6)
    assert off.max() <= pixels
    free = simplified(frames, own, 4.0, sight=sight)
    assert free.pixels > pixels
    assert keys_of(free) < keys_of(found)
