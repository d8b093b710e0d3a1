"""Fewer keys: the bounds hold on every dense frame, keys hold what was there, and few are left."""

from __future__ import annotations

import numpy as np
import pytest

from handfit_core.edit.simplify import LOCATION, Channels, Sight, Simplified, Spline, simplifying
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import channels_to_quat, quat_multiply, rotvec_to_quat, unflip_quats
from handfit_core.hand_model import load_model
from handfit_core.hand_model.axes import RestPose, bone_frames, points_to_rest
from handfit_core.retarget.transfer import SourceHand
from handfit_core.skeleton import NUM_JOINTS
from handfit_core.slices import run_to_completion


def turning(count: int, noise: float, seed: int = 0) -> np.ndarray:
    """(N, 4) quaternions of a bone that swings, with so many radians of noise in each frame."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, count / 40.0, count)[:, None]
    swing = np.sin(2.0 * np.pi * (t * rng.uniform(0.3, 1.2, 3) + rng.uniform(size=3))) * rng.uniform(
        0.1, 0.8, 3
    )
    jitter = rotvec_to_quat(rng.normal(scale=noise, size=(count, 3)))
    return unflip_quats(quat_multiply(rotvec_to_quat(swing), jitter))


def bezier(before: np.ndarray, start, end, behind, share: np.ndarray) -> np.ndarray:
    t = share[:, None]
    return start * (1 - t) ** 3 + 3 * before * t * (1 - t) ** 2 + 3 * behind * t * t * (1 - t) + end * t**3


def played(spline: Spline, frames: np.ndarray, at: np.ndarray) -> np.ndarray:
    """What Bezier curves through the keys and handles say, by de Casteljau's corners alone."""
    values = np.empty((len(at), spline.values.shape[1]))
    before, behind = spline.handles(frames)
    places = frames[spline.rows]
    values[:] = spline.values[0]
    for k in range(len(places) - 1):
        inside = (at >= places[k]) & (at <= places[k + 1])
        third = (places[k + 1] - places[k]) / 3.0
        np.testing.assert_allclose(behind[k, :, 0], places[k] + third)
        np.testing.assert_allclose(before[k + 1, :, 0], places[k + 1] - third)
        share = (at[inside] - places[k]) / (3.0 * third)
        corners = behind[k, :, 1], spline.values[k], spline.values[k + 1], before[k + 1, :, 1]
        values[inside] = bezier(*corners, share)
    return values


def degrees_off(track: Channels, spline: Spline, frames: np.ndarray) -> float:
    dense = channels_to_quat(track.values, track.mode)
    shown = channels_to_quat(played(spline, frames, frames), track.mode)
    return float(np.degrees(2.0 * np.arccos(np.minimum(np.abs(np.sum(dense * shown, axis=-1)), 1.0))).max())


@pytest.mark.parametrize("noise", [0.0, 0.004, 0.05])
@pytest.mark.parametrize("bound", [0.5, 2.0, 10.0])
def test_no_bone_is_farther_off_than_the_bound_in_any_frame(noise, bound):
    frames = 7.0 + 0.8 * np.arange(260)
    tracks = [Channels(turning(260, noise, seed), "QUATERNION", group=seed // 2) for seed in range(4)]
    found = run_to_completion(simplifying(frames, tracks, bound))
    off = [degrees_off(*pair, frames) for pair in zip(tracks, found.splines, strict=True)]
    assert max(off) <= bound
    assert found.degrees == pytest.approx(max(off), abs=1e-3)
    assert found.pixels is None
    for track, spline in zip(tracks, found.splines, strict=True):
        assert spline.rows[[0, -1]].tolist() == [0, 259]
        np.testing.assert_array_equal(spline.values, track.values[spline.rows])
    for one, other in ((0, 1), (2, 3)):
        np.testing.assert_array_equal(found.splines[one].rows, found.splines[other].rows)


def keys_of(found: Simplified) -> int:
    return sum(len(spline.rows) for spline in found.splines)


def test_looser_bounds_and_frames_of_their_own_take_fewer_keys():
    frames = np.arange(300.0)
    motions = [turning(300, 0.004, seed) for seed in range(6)]
    together = [Channels(motion, "QUATERNION") for motion in motions]
    alone = [Channels(motion, "QUATERNION", group=i) for i, motion in enumerate(motions)]
    counts = [keys_of(run_to_completion(simplifying(frames, together, bound))) for bound in (0.5, 2.0, 8.0)]
    assert counts[0] > counts[1] > counts[2]
    assert keys_of(run_to_completion(simplifying(frames, alone, 2.0))) < counts[1] < 0.5 * 6 * 300


@pytest.mark.parametrize("mode", ["XYZ", "ZXY", "AXIS_ANGLE"])
def test_bones_in_other_rotation_modes_keep_to_the_bound(mode):
    frames = np.arange(200.0)
    t = frames[:, None] / 30.0
    values = 0.9 * np.sin(t * [1.0, 1.7, 2.3] + [0.0, 1.0, 2.0])
    if mode == "AXIS_ANGLE":
        values = np.concatenate([1.0 + values[:, :1], np.tile([0.6, 0.0, 0.8], (200, 1))], axis=-1)
    track = Channels(values, mode)
    found = run_to_completion(simplifying(frames, [track], 1.0))
    assert degrees_off(track, found.splines[0], frames) <= 1.0
    assert len(found.splines[0].rows) < 60


def test_what_does_not_move_keeps_two_keys():
    still = np.tile(turning(1, 0.0), (90, 1))
    place = np.tile([0.1, -0.2, 0.3], (90, 1))
    found = run_to_completion(
        simplifying(
            np.arange(90.0), [Channels(still, "QUATERNION"), Channels(place, "LOCATION", 1, arm=0.1)], 0.1
        )
    )
    assert [spline.rows.tolist() for spline in found.splines] == [[0, 89], [0, 89]]
    assert found.degrees == pytest.approx(0.0, abs=1e-6)
    np.testing.assert_allclose(found.splines[1].slopes, 0.0, atol=1e-12)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_very_short_motions(count):
    frames, track = np.arange(5.0, 5.0 + count), Channels(turning(count, 0.3), "QUATERNION")
    found = run_to_completion(simplifying(frames, [track], 0.01))
    assert found.splines[0].rows.tolist() == list(range(count))
    before, behind = found.splines[0].handles(frames)
    assert np.isfinite([before, behind]).all()
    assert (before[..., 0] < frames[:, None]).all()
    assert (behind[..., 0] > frames[:, None]).all()


def test_rows_that_are_to_stay_stay():
    track = Channels(turning(120, 0.0), "QUATERNION")
    found = run_to_completion(simplifying(np.arange(120.0), [track], 5.0, kept=[17, 18, 64]))
    assert {17, 18, 64} <= set(found.splines[0].rows.tolist())


def test_smooth_motion_of_unit_quaternions_stays_near_length_one_between_frames():
    frames = np.arange(300.0)
    track = Channels(turning(300, 0.0, seed=3), "QUATERNION")
    spline = run_to_completion(simplifying(frames, [track], 2.0)).splines[0]
    between = played(spline, frames, np.arange(0.0, 299.0, 0.1))
    np.testing.assert_allclose(np.linalg.norm(between, axis=-1), 1.0, atol=0.05)
    assert np.abs(np.diff(between, axis=0)).max() < 0.02


def seen_hand(count: int) -> tuple[list[Channels], Sight]:
    """A hand half a metre before a camera, whose bones all swing."""
    model = load_model("open-hand", "right")
    shaped = model.shaped()
    rest = RestPose("right", bone_frames(shaped, "right"), points_to_rest(shaped.joints[0]))
    quats = np.stack([turning(count, 0.002, seed) for seed in range(NUM_JOINTS)], axis=1)
    t = np.linspace(0.0, 6.0, count)
    places = np.stack([0.1 * np.sin(t), 0.05 * np.cos(t), 0.02 * np.sin(2 * t)], axis=-1)
    places = (np.array([0.0, 0.5, 0.0]) + places - rest.wrist) @ rest.frames[0]
    sight = Sight(rest, SourceHand.of(shaped, "right"), Intrinsics(900.0, 950.0, 320.0, 240.0), quats, places)
    tracks = [Channels(quats[:, j], "QUATERNION", j, joint=j) for j in range(NUM_JOINTS)]
    return [*tracks, Channels(places, "LOCATION", LOCATION, arm=0.1, joint=LOCATION)], sight


def test_the_sight_is_the_models_own_projection():
    sight = seen_hand(5)[1]
    model = load_model("open-hand", "right")
    pose = sight.rest.from_bones(model.shaped(), sight.quats, sight.locations)
    expected = model.keypoints(None, *pose)
    points = sight.points(sight.quats, sight.locations)
    bend = np.linalg.norm(points - expected, axis=-1)
    assert bend.max() < 4e-3  # pose blend shapes move fingertips
    joints = [0, 1, 2, 3, 5, 6, 7, 9, 10, 11, 13, 14, 15, 17, 18, 19]
    np.testing.assert_allclose(points[:, joints], expected[:, joints], atol=1e-9)


@pytest.mark.parametrize("pixels", [1.0, 3.0])
def test_no_keypoint_is_farther_off_than_the_bound_in_pixels(pixels):
    tracks, sight = seen_hand(120)
    frames = np.arange(120.0)
    found = run_to_completion(simplifying(frames, tracks, 4.0, pixels, sight=sight))
    shown = [played(spline, frames, frames) for spline in found.splines]
    quats = np.stack([channels_to_quat(values, "QUATERNION") for values in shown[:NUM_JOINTS]], axis=1)
    project = sight.intrinsics.project
    off = np.linalg.norm(
        project(sight.points(quats, shown[LOCATION])) - project(sight.points(sight.quats, sight.locations)),
        axis=-1,
    )
    assert found.pixels == pytest.approx(off.max(), abs=1e-6)
    assert off.max() <= pixels
    free = run_to_completion(simplifying(frames, tracks, 4.0, sight=sight))
    assert free.pixels is not None
    assert free.pixels > pixels
    assert keys_of(free) < keys_of(found)


def test_a_part_of_a_hand_that_is_seen_keeps_to_the_bound_in_pixels():
    tracks, sight = seen_hand(100)
    frames = np.arange(100.0)
    chosen = [13, 14, 15, LOCATION]
    own = [tracks[i] for i in chosen]
    found = run_to_completion(
        simplifying(
            frames,
            [Channels(t.values, t.mode, i, t.arm, t.joint) for i, t in enumerate(own)],
            5.0,
            1.5,
            sight=sight,
        )
    )
    quats, places = sight.quats.copy(), sight.locations
    for i, spline in zip(chosen, found.splines, strict=True):
        if i == LOCATION:
            places = played(spline, frames, frames)
        else:
            quats[:, i] = channels_to_quat(played(spline, frames, frames), "QUATERNION")
    project = sight.intrinsics.project
    off = project(sight.points(quats, places)) - project(sight.points(sight.quats, sight.locations))
    assert np.linalg.norm(off, axis=-1).max() <= 1.5
