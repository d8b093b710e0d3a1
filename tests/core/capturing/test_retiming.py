"""Takes at another frame rate: poses between pictures, gaps, and what was measured in the nearest picture."""

from dataclasses import replace

import numpy as np
import pytest

from handfit_core.capturing.retiming import (
    check_rate,
    moments,
    moved_keys,
    retimed,
    retimed_field,
    sampled,
    shown_numbers,
    shown_rows,
)
from handfit_core.common.errors import OptionError
from handfit_core.edit.corrections import Correction, CorrectionField
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model.arm import ArmMotion
from handfit_core.media.source import Source
from handfit_core.take import HandTrack, Take
from tests.takes import found

RATE = 0.3
"""radians per source frame"""


def clip(numbers, absent=(), fps=30.0) -> Take:
    """A hand that turns about x at `RATE`, opens about z, and moves along x by 1 cm a frame."""
    numbers = np.asarray(numbers)
    count = len(numbers)
    there = ~np.isin(numbers, absent)
    nan = np.where(there, 1.0, np.nan)
    turned = np.outer(RATE * numbers, [1.0, 0.0, 0.0])
    pose = np.tile([0.0, 0.0, 0.01], (count, 15)) * numbers[:, None]
    places = np.zeros((count, 21, 2)) + numbers[:, None, None]
    track = HandTrack(
        side="right",
        betas=np.zeros(10),
        global_orient=turned * nan[:, None],
        hand_pose=pose * nan[:, None],
        transl=np.stack([0.01 * numbers, 0 * numbers, 0 * numbers + 0.5], axis=-1) * nan[:, None],
        joints_3d=np.ones((count, 21, 3)) * nan[:, None, None],
        reprojection_error=numbers * nan,
        detections=found("right", places, there),
    )
    camera = Intrinsics(100.0, 100.0, 32.0, 24.0)
    source = Source("video", ("clip.mp4",))
    return Take(source, fps, numbers, 64, 48, camera, "fast", "open-hand", {}, (track,))


@pytest.mark.parametrize("rate", [23.976, 1.0, 120.0])
def test_poses_are_those_of_the_moment(rate):
    """Measurements are those of the picture that is shown, the nearest."""
    take = clip(np.arange(5, 96))
    scale = rate / take.fps
    new = retimed(take, scale)
    assert new.fps == pytest.approx(rate)
    assert new.frame_numbers.tolist() == list(range(5, 5 + len(new.frame_numbers)))
    times = moments(take, scale)
    assert times[0] == 5
    assert times[-1] <= 95 + 1e-6 < times[-1] + 1 / scale + 2e-6
    (track,) = new.hands
    assert track.present.all()
    turns = np.outer(RATE * times, [1.0, 0.0, 0.0])
    np.testing.assert_allclose(rotvec_to_rotmat(track.global_orient), rotvec_to_rotmat(turns), atol=1e-9)
    np.testing.assert_allclose(track.hand_pose[:, 2], 0.01 * times, atol=1e-9)
    np.testing.assert_allclose(track.transl[:, 0], 0.01 * times, atol=1e-9)
    pictures = shown_numbers(times)
    assert np.abs(pictures - times).max() <= 0.5
    np.testing.assert_array_equal(track.keypoints_2d[:, 0, 0], pictures)
    np.testing.assert_array_equal(track.reprojection_error, pictures)


@pytest.mark.parametrize("rate", [24.0, 60.0])
def test_gaps_stay_gaps(rate):
    gap = tuple(range(20, 30))
    take = clip(np.arange(1, 61), absent=gap)
    (track,) = retimed(take, rate / 30.0).hands
    times = moments(take, rate / 30.0)
    np.testing.assert_array_equal(track.present, ~np.isin(shown_numbers(times), gap))
    # The last pose before the gap holds: nothing is turned towards what lies behind it.
    last = np.flatnonzero(shown_numbers(times) == 19)[-1]
    held = track.global_orient[last, 0] % (2 * np.pi)
    assert held == pytest.approx(RATE * min(times[last], 19) % (2 * np.pi))
    track.check(len(times))


def test_every_second_frame():
    """Poses are interpolated across the frames that were left out, and not called detected there."""
    take = clip(np.arange(1, 60, 2))
    (track,) = retimed(take, 24 / 30).hands
    times = moments(take, 24 / 30)
    assert track.present.all()
    np.testing.assert_allclose(track.transl[:, 0], 0.01 * times, atol=1e-9)
    near = np.abs(times[:, None] - take.frame_numbers).min(axis=1) <= 0.501
    np.testing.assert_array_equal(track.detected, near)
    np.testing.assert_array_equal(track.filled, ~near)
    track.check(len(times))


def test_arms_keep_their_lengths():
    """Between the pictures, too, where they are as far as the hand is; beside a gap they hold."""
    numbers = np.arange(1, 21)
    there = ~np.isin(numbers, range(10, 15))
    turned = 0.2 * numbers[:, None]
    bone = np.concatenate([np.cos(turned), np.sin(turned), 0.0 * turned], axis=1)
    wrist = np.where(there[:, None], 0.01 * numbers[:, None] + [0.0, 0.0, 1.0], np.nan)
    elbow, lengths = wrist - 0.25 * bone, np.array([0.3, 0.25])
    errors = np.where(there[:, None], [0.2, 0.3], np.nan)
    arm = ArmMotion(elbow - 0.3 * bone[:, [1, 2, 0]], elbow, wrist, lengths, there, errors)
    take = clip(numbers)
    take = replace(take, hands=(replace(take.hands[0], arm=arm),))
    new = retimed(take, 0.8).hands[0].arm
    assert new is not None
    at = moments(take, 0.8)
    np.testing.assert_array_equal(new.present, ~np.isin(shown_numbers(at), range(10, 15)))
    np.testing.assert_allclose(new.wrist[:5, 0], 0.01 * at[:5])
    for first, last, length in ((new.shoulder, new.elbow, 0.3), (new.elbow, new.wrist, 0.25)):
        np.testing.assert_allclose(np.linalg.norm(last - first, axis=1)[new.present], length)
    np.testing.assert_array_equal(retimed(take, 1.0).hands[0].arm.wrist, arm.wrist)
    retimed(take, 0.8).hands[0].check(len(at))


def test_shortest_way():
    """A turn past half a circle goes on, and does not come back the long way round."""
    take = clip(np.arange(1, 61))
    signs = np.where(np.arange(60)[:, None] % 2, 1.0, -1.0)
    other = replace(take.hands[0], global_orient=signs * np.array([np.pi - 1e-3, 0.0, 0.0]))
    new = sampled(other, take.frame_numbers, np.array([1.5]))
    matrix = rotvec_to_rotmat(new.global_orient[0])
    np.testing.assert_allclose(matrix, np.diag([1.0, -1.0, -1.0]), atol=1e-9)


@pytest.mark.parametrize(("rate", "count"), [(24.0, 48), (60.0, 60)])
def test_back_to_pictures(rate, count):
    take, scale = clip(np.arange(11, 71)), rate / 30.0
    rows, numbers = shown_rows(retimed(take, scale), take.frame_numbers, scale)
    assert len(numbers) == count
    assert np.all(np.diff(numbers) > 0)
    assert np.isin(numbers, take.frame_numbers).all()
    assert np.abs(moments(take, scale)[rows] - numbers).max() <= (0.5 if rate == 24.0 else 1e-9)


def test_absurd_rates_are_refused():
    for fps in (0.1, 240.0, 0.999, float("nan")):
        with pytest.raises(OptionError, match="frames per second"):
            check_rate(fps)


def test_dense_keys_are_sampled_and_others_move():
    keyed = np.array([10.0, 11.0, 12.0, 13.0, 20.0, 30.0])
    frames, times = moved_keys(keyed, 10.0, 2.0, 1.5, np.array([12.0]))
    np.testing.assert_array_equal(frames, [10, 11, 12, 13, 14, 15, 16, 30, 50])
    np.testing.assert_array_equal(times, [10, 10.5, 11, 11.5, 12, 12.5, 13, 20, 30])
    frames, times = moved_keys(keyed, 10.0, 0.4, 1.5, np.array([12.0]))
    np.testing.assert_array_equal(frames, [10, 11, 14, 18])
    np.testing.assert_array_equal(times, [10, 12, 20, 30])
    assert moved_keys(np.empty(0), 0.0, 2.0, 1.5, np.empty(0))[0].size == 0


def test_corrections_move_with_their_frames():
    one = Correction({8: (1.0, 2.0)}, spread=4.0)
    moved = retimed_field(CorrectionField({10: one, 20: Correction({}, keyed=True)}), 5, 0.8)
    assert moved.corrected == [9]
    assert moved.corrections[9].spread == pytest.approx(3.2)
    assert moved.frames.tolist() == [9, 17]
    # The artist's stays where an anchor would come to lie.
    close = retimed_field(CorrectionField({10: one, 11: Correction({}, keyed=True)}), 5, 0.4)
    assert close.corrected == [7]
