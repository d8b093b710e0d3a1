"""Corrections by hand: pins are met, other fingers stay, locks hold, neighbours follow."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.arrays import pack
from handfit_core.detect.keypoints import HandDetection
from handfit_core.edit import (
    RefineHand,
    answer,
    from_message,
    landmark_points,
    refit_each,
    refit_range,
    result_from_message,
    to_message,
    warm_up,
)
from handfit_core.edit.recent import Recent
from handfit_core.errors import Cancelled, HandfitError, HandModelError, OptionError, ProtocolError
from handfit_core.fit.fast import fit_track
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model import save_model_npz
from handfit_core.hand_model.chain import Chain
from handfit_core.hand_model.files import kept_model
from handfit_core.hand_model.landmarks import detector_landmarks
from handfit_core.hand_model.motion import POSE_ARRAYS, HandMotion
from handfit_core.skeleton import SIDES, TIP_KEYPOINTS, Side
from tests.core.fit.detections import (
    CAMERA,
    columns,
    keypoints_of,
    laid_error,
    landmarks_of,
    mirrored,
    model_of,
    poses,
    seen,
    track_of,
)
from tests.core.fit.frames import fit_frames

Parameters = tuple[np.ndarray, ...]
"""betas (N, 10), global_orient (N, 3), hand_pose (N, 45), transl (N, 3)"""
ROOT = Path(__file__).resolve().parents[3]
TIP, OWN = 8, [5, 6, 7, 8]
OTHERS = [k for k in range(21) if k not in OWN]
FPS = 25.0


def no_pins(count: int) -> np.ndarray:
    return np.full((count, 21, 2), np.nan)


def unlocked(*joints: int) -> np.ndarray:
    locked = np.zeros(16, dtype=bool)
    locked[list(joints)] = True
    return locked


def make_hand(
    side: Side,
    detections: Sequence[HandDetection | None],
    parameters: Parameters,
    pins: np.ndarray | None = None,
    **more: Any,
) -> RefineHand:
    betas, orient, pose, transl = parameters
    return RefineHand(
        side=side,
        betas=betas[0],
        intrinsics=CAMERA,
        detections=columns(detections),
        pins=no_pins(len(detections)) if pins is None else pins,
        global_orient=orient,
        hand_pose=pose,
        transl=transl,
        locked=more.pop("locked", unlocked()),
        fps=FPS,
        **more,
    )


def true_hands(side: Side, count: int, seed: int = 0) -> Parameters:
    """Of one shape."""
    betas, *rest = poses(count, seed) if side == "right" else mirrored(*poses(count, seed))
    return np.repeat(betas[:1], count, axis=0), *rest


def handles(side: Side, parameters: Parameters) -> np.ndarray:
    """(N, 21, 2) by the mesh, and not by the package's own function."""
    return CAMERA.project(landmarks_of(side, *parameters))


def parameters_of(found: HandMotion) -> Parameters:
    return np.tile(found.betas, (len(found.transl), 1)), *found.pose


def shown(found: HandMotion) -> np.ndarray:
    """(T, 21, 2) the handles of a result."""
    return handles(found.side, parameters_of(found))


def joints_of(found: HandMotion) -> np.ndarray:
    """(T, 21, 3) metres"""
    return keypoints_of(found.side, *parameters_of(found))


def captured(side: Side, detections: list[HandDetection]) -> Parameters:
    fits = fit_frames(model_of(side), columns(detections), CAMERA)
    return fits.betas, fits.global_orient, fits.hand_pose, fits.transl


@cache
def photo() -> tuple[HandDetection, Parameters]:
    """A hand seen with some noise, and its capture."""
    true = true_hands("right", 3, seed=1)
    detection = seen(landmarks_of("right", *true)[1], "right", noise=2.0)
    return detection, captured("right", [detection])


def dragged(keypoint: int, by: tuple[float, float], **more: Any) -> tuple[RefineHand, np.ndarray]:
    """The photo's hand with one point dragged by pixels, and its handles before."""
    detection, start = photo()
    before = handles("right", start)
    pins = no_pins(1)
    pins[0, keypoint] = before[0, keypoint] + by
    return make_hand("right", [detection], start, pins, **more), before[0]


def distance(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.linalg.norm(a - b, axis=-1)


@pytest.mark.parametrize("side", SIDES)
def test_handles_are_the_solvers_points(side: Side) -> None:
    """The light function, the chain, and the mesh with offsets."""
    betas, orient, pose, transl = true_hands(side, 4)
    found = landmark_points(model_of(side), betas[0], orient, pose, transl)
    chain = Chain(model_of(side), detector_landmarks())
    posed = chain.pose(chain.state(betas, orient, pose, transl, np.zeros((4, 1))))
    np.testing.assert_allclose(found, posed.points, atol=1e-9)
    np.testing.assert_allclose(found, landmarks_of(side, betas, orient, pose, transl), atol=1e-9)


@pytest.mark.parametrize("by", [(6.0, 0.0), (0.0, 12.0), (-15.0, 20.0)])
def test_dragged_fingertip(by: tuple[float, float]) -> None:
    hand, before = dragged(TIP, by)
    after = shown(refit_each(hand))[0]
    assert distance(after[TIP], hand.pins[0, TIP]) < 1.0
    moved = distance(after, before)
    assert moved[[7, 6]].min() > 0.2 * np.hypot(*by)  # its finger comes along
    assert moved[OTHERS].mean() < 1.0


def test_several_pins_are_all_met() -> None:
    hand, before = dragged(TIP, (-8.0, 6.0))
    for keypoint, by in ((4, (6.0, 4.0)), (17, (4.0, -4.0)), (20, (5.0, 9.0))):
        hand.pins[0, keypoint] = before[keypoint] + by
    found = shown(refit_each(hand))
    assert distance(found, hand.pins)[hand.pinned].max() < 1.0


@pytest.mark.parametrize("keypoint", [5, 17])
def test_dragged_knuckle(keypoint: int) -> None:
    hand, before = dragged(keypoint, (-12.0, 12.0))
    after = shown(refit_each(hand))[0]
    moved = distance(after, before)
    assert distance(after[keypoint], hand.pins[0, keypoint]) < 1.0
    assert moved[[5, 9, 13, 17]].min() > 3.0
    assert moved[0] < 0.6 * moved[keypoint]


def test_dragged_wrist() -> None:
    hand, before = dragged(0, (12.0, -9.0))
    after = shown(refit_each(hand))[0]
    moved = distance(after, before)
    assert distance(after[0], hand.pins[0, 0]) < 1.0
    assert moved[[5, 9, 13, 17]].min() > 2.0
    assert moved[list(TIP_KEYPOINTS)].max() < 4.0


def test_pin_in_place() -> None:
    hand, before = dragged(TIP, (0.0, 0.0))
    found = refit_each(hand)
    assert distance(shown(found)[0], before).max() < 0.5
    assert distance(joints_of(found)[0], keypoints_of("right", *photo()[1])[0]).max() < 0.003
    # At the detector's own point: by no more than the fit was off there.
    detection, start = photo()
    pins = no_pins(1)
    pins[0, TIP] = detection.keypoints_2d[TIP]
    off = distance(detection.keypoints_2d[TIP], before[TIP])
    again = shown(refit_each(make_hand("right", [detection], start, pins)))[0]
    assert distance(again, before).max() < off + 0.5
    assert distance(again, before)[OTHERS].max() < 0.3 * off + 0.5


def test_no_pins_keep_pose() -> None:
    detection, start = photo()
    found = refit_each(make_hand("right", [detection], start))
    for name, rows in zip(("global_orient", "hand_pose", "transl"), start[1:], strict=True):
        np.testing.assert_array_equal(getattr(found, name), rows)


@pytest.mark.parametrize("side", SIDES)
def test_a_wrong_fingertip_is_mended(side: Side) -> None:
    """The detector puts a fingertip 40 px aside; the artist puts it back."""
    true = true_hands(side, 12, seed=3)
    points = landmarks_of(side, *true)
    rng = np.random.default_rng(0)
    tips = rng.choice(TIP_KEYPOINTS, 12)
    detections, pins = [], no_pins(12)
    for i, (p, tip) in enumerate(zip(points, tips, strict=True)):
        detection = seen(p, side, noise=1.0, seed=i)
        angle = rng.uniform(0, 2 * np.pi)
        pins[i, tip] = CAMERA.project(p[tip])
        detection.keypoints[tip, :2] += 40.0 * np.array([np.cos(angle), np.sin(angle)])
        detections.append(detection)
    aims = keypoints_of(side, *true)
    fits = captured(side, detections)
    uncorrected, corrected = [], []
    for i, detection in enumerate(detections):
        start = (fits[0][i : i + 1], *(a[i : i + 1] for a in fits[1:]))
        uncorrected.append(keypoints_of(side, *start)[0])
        result = refit_each(make_hand(side, [detection], start, pins[i : i + 1]))
        corrected.append(joints_of(result)[0])
        assert distance(shown(result), pins[i : i + 1])[0, tips[i]] < 2.0
    before, after = laid_error(np.array(uncorrected), aims), laid_error(np.array(corrected), aims)
    assert after.mean() < 0.85 * before.mean()


@pytest.mark.parametrize("locked", [(0,), (1, 2, 3), (2,), (0, 1, 4, 7, 10, 13)])
def test_locked_joints_hold(locked: tuple[int, ...]) -> None:
    hand, before = dragged(TIP, (10.0, 14.0), locked=unlocked(*locked))
    found = refit_each(hand)
    rotations = np.concatenate([found.global_orient, found.hand_pose], axis=1).reshape(16, 3)
    aims = np.concatenate([hand.global_orient, hand.hand_pose], axis=1).reshape(16, 3)
    np.testing.assert_array_equal(rotations[list(locked)], aims[list(locked)])
    if 0 in locked:
        np.testing.assert_array_equal(found.transl, hand.transl)
    # What is free still goes for the pin.
    aim = hand.pins[0, TIP]
    assert distance(shown(found)[0, TIP], aim) < 0.8 * distance(before[TIP], aim)


def test_all_locked_stays() -> None:
    hand, _ = dragged(TIP, (10.0, 14.0), locked=np.ones(16, dtype=bool))
    np.testing.assert_array_equal(refit_each(hand).hand_pose, hand.hand_pose)


def test_pins_without_detection() -> None:
    """And one without a pose by its detection; one with neither comes back empty, as does one with a pose
    behind the camera."""
    detection, start = photo()
    before = handles("right", start)
    four = (np.repeat(start[0], 4, 0), *(np.repeat(a, 4, 0) for a in start[1:]))
    for array in four[1:]:
        array[[1, 2]] = np.nan
    four[3][3] = (0.0, 0.0, -0.5)
    pins = no_pins(4)
    pins[:3, TIP] = before[0, TIP] + (-7.0, 5.0)
    found = refit_each(make_hand("right", [None, detection, None, None], four, pins))
    np.testing.assert_array_equal(found.present, [True, True, False, False])
    assert distance(shown(found), pins)[:2, TIP].max() < 1.0
    assert distance(shown(found)[0], before[0])[OTHERS].mean() < 1.0
    assert distance(shown(found)[1], before[0])[OTHERS].mean() < 5.0
    for rows in found.pose:
        assert np.isnan(rows[2:]).all()
        assert np.isfinite(rows[:2]).all()


def test_many_frames_are_each_by_itself() -> None:
    true = true_hands("right", 5, seed=4)
    detections = [seen(p, "right", noise=2.0, seed=i) for i, p in enumerate(landmarks_of("right", *true))]
    before = handles("right", true)
    pins = no_pins(5)
    pins[[0, 1, 3], TIP] = before[[0, 1, 3], TIP] + (6.0, 6.0)
    together = refit_each(make_hand("right", list(detections), true, pins))
    for i in range(5):
        rows = slice(i, i + 1)
        alone = refit_each(
            make_hand("right", detections[rows], (true[0], *(a[rows] for a in true[1:])), pins[rows])
        )
        np.testing.assert_allclose(joints_of(alone)[0], joints_of(together)[i], atol=2e-4)


def outwards(points: np.ndarray, keypoint: int) -> np.ndarray:
    """(2,) the direction in the picture from a fingertip's finger's first point (21, 2) to itself."""
    along = points[keypoint] - points[keypoint - 3]
    return along / np.linalg.norm(along)


def turned(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """(15,) degrees between two hand poses (45,)."""
    first, second = (rotvec_to_rotmat(np.reshape(pose, (15, 3))) for pose in (before, after))
    between = rotmat_to_rotvec(np.swapaxes(first, -1, -2) @ second)
    return np.degrees(np.linalg.norm(between, axis=-1))


@pytest.mark.parametrize("keypoint", TIP_KEYPOINTS)
def test_outward_drag_keeps_distance(keypoint: int) -> None:
    """Nearer, it would look larger and reach the pin."""
    _, before = dragged(keypoint, (0.0, 0.0))
    hand, _ = dragged(keypoint, tuple(12.0 * outwards(before, keypoint)))
    found = refit_each(hand)
    assert abs(joints_of(found)[0, 0, 2] - keypoints_of("right", *photo()[1])[0, 0, 2]) < 0.004


def test_range_pin_keeps_distance() -> None:
    true, start, detections = clip()
    points = handles("right", true)
    pins = no_pins(COUNT)
    pins[10, TIP] = points[10, TIP] + 15.0 * outwards(points[10], TIP)
    hand = make_hand("right", list(detections), start, pins)
    plain = refit_range(replace(hand, pins=no_pins(COUNT)))
    found = refit_range(hand)
    assert distance(shown(found), shown(plain))[10, TIP] > 5.0
    assert np.abs(joints_of(found) - joints_of(plain))[:, 0, 2].max() < 0.001


def test_palm_pins_change_the_distance() -> None:
    """Wrist and knuckles drawn apart: that hand is nearer."""
    hand, before = dragged(0, (0.0, 0.0))
    palm = [0, 5, 9, 13, 17]
    middle = before[palm].mean(axis=0)
    hand.pins[0, palm] = middle + 1.1 * (before[palm] - middle)
    found = refit_each(hand)
    assert distance(shown(found), hand.pins)[0, palm].max() < 3.0
    wrist = keypoints_of("right", *photo()[1])[0, 0, 2]
    assert 0.85 * wrist < joints_of(found)[0, 0, 2] < 0.95 * wrist


def test_drafts_follow_drag() -> None:
    """Small steps with few iterations each land near the pin; what is kept is fitted in full."""
    guess, missed = None, []
    for step in np.linspace(0.1, 1.0, 10):
        hand, _ = dragged(8, (-24.0 * step, 18.0 * step))
        guess = refit_each(hand, guess, draft=True)
        missed.append(distance(shown(guess), hand.pins)[0, 8])
    assert max(missed) < 3.0, missed
    direct = refit_each(hand)
    final = refit_each(hand, guess)
    assert np.linalg.norm(joints_of(final) - joints_of(direct), axis=-1).max() < 1e-3  # metres


def test_untouched_fingers_keep_pose() -> None:
    """Beyond the limits, and far from what hands usually do."""
    detection, (betas, orient, pose, transl) = photo()
    by_hand = pose.copy()
    by_hand[0, 27:36] += np.radians([20.0, -15.0, 60.0, 10.0, 0.0, -50.0, 0.0, 25.0, -30.0])
    by_hand[0, 9:18] += np.radians([0.0, 30.0, -60.0, 0.0, 0.0, -40.0, 0.0, 0.0, 70.0])
    start = (betas, orient, by_hand, transl)
    before = handles("right", start)[0]
    pins = no_pins(1)
    pins[0, TIP] = before[TIP] + (5.0, 8.0)
    pins[0, 4] = before[4] + (4.0, -3.0)
    found = refit_each(make_hand("right", [detection], start, pins))
    assert distance(shown(found), pins)[0, [TIP, 4]].max() < 1.0
    np.testing.assert_array_equal(found.hand_pose[0, 9:36], by_hand[0, 9:36])
    assert turned(by_hand[0], found.hand_pose[0])[[0, 1, 2, 12, 13, 14]].max() > 1.0


def test_small_drag() -> None:
    """Its own finger does not fall back to what hands usually do."""
    detection, (betas, orient, pose, transl) = photo()
    by_hand = pose.copy()
    by_hand[0, 0:9] *= 0.3
    start = (betas, orient, by_hand, transl)
    pins = no_pins(1)
    pins[0, TIP] = handles("right", start)[0, TIP] + (0.3, 0.2)
    found = refit_each(make_hand("right", [detection], start, pins))
    assert turned(by_hand[0], found.hand_pose[0]).max() < 2.0


def test_fingers_ride_on_a_dragged_knuckle() -> None:
    hand, before = dragged(9, (-10.0, 8.0))
    found = refit_each(hand)
    moved = distance(shown(found)[0], before)
    assert moved[[5, 9, 13, 17]].min() > 3.0
    assert np.median(turned(hand.hand_pose[0], found.hand_pose[0])) < 5.0


def test_far_drag_returns_to_detection() -> None:
    """Its pose was changed by hand; where it is dragged far from that, the detection knows it better."""
    true = true_hands("right", 3, seed=1)
    detection = seen(landmarks_of("right", *true)[1], "right", noise=0.5)
    betas, orient, pose, transl = captured("right", [detection])
    by_hand = pose.copy()
    by_hand[0, 0:9] += np.radians([0.0, 0.0, -50.0, 0.0, 0.0, -40.0, 0.0, 0.0, -20.0])
    start = (betas, orient, by_hand, transl)
    pins = no_pins(1)
    pins[0, 6] = detection.keypoints_2d[6]
    known = shown(refit_each(make_hand("right", [detection], start, pins)))[0]
    unknown = shown(refit_each(make_hand("right", [None], start, pins)))[0]
    off, without = (distance(p, detection.keypoints_2d)[[7, TIP]].mean() for p in (known, unknown))
    assert off < 0.5 * without


@pytest.mark.parametrize("smoothing", [0.0, 3.0])
def test_range_equals_capture(smoothing: float) -> None:
    """At its own frame rate, with a missing picture and a gap."""
    detections = clip()[2]
    rows: tuple[HandDetection | None, ...] = (*detections[:4], None, *detections[5:])
    track = replace(track_of("right", rows, 12.0), holes=(9,))
    capture = fit_track(smoothing, model_of("right"), track, CAMERA, lambda: None)
    empty = (capture.betas[None], *(np.full((COUNT, n), np.nan) for n in (3, 45, 3)))
    hand = make_hand("right", rows, empty, smoothing=smoothing, holes=(9,))
    found = refit_range(replace(hand, fps=12.0))
    assert found.present.all()
    aims = model_of("right").keypoints(
        capture.betas, capture.global_orient, capture.hand_pose, capture.transl
    )
    assert distance(joints_of(found), aims).max() < 1e-5


def test_drafts_go_on_from_the_last() -> None:
    """Those of a thumb that is drawn far aside, step by step, each begin where the one before ended."""
    steps = [dragged(4, (share * 120.0, 0.0))[0] for share in (0.25, 0.5, 0.75, 0.95, 1.0)]
    requests = [{"mode": "draft", "hand": to_message(hand)} for hand in steps]
    answer({"mode": "each", "hand": to_message(corrected_clip())}, lambda: False)  # of many frames: forgotten
    answers = [result_from_message(answer(request, lambda: False)) for request in requests]
    led = None
    for hand in steps:
        led = refit_each(hand, led, draft=True)
    assert led is not None
    assert distance(shown(answers[-1]), shown(led)).max() < 1.0
    assert distance(shown(led), steps[-1].pins)[0, 4] < 3.0
    assert distance(shown(led), shown(refit_each(steps[-1], draft=True))).max() > 1.0


def test_drag_path_does_not_count() -> None:
    """What is kept is the same after any drafts, at one go too, and comes as near to its pin."""
    steps = [dragged(4, (share * 120.0, 0.0))[0] for share in (0.25, 0.5, 0.75, 0.95, 1.0)]
    kept = []
    for way in (steps[:0], steps[:-1], steps[-2::-1]):
        for hand in way:
            answer({"mode": "draft", "hand": to_message(hand)}, lambda: False)
        kept.append(
            result_from_message(answer({"mode": "each", "hand": to_message(steps[-1])}, lambda: False))
        )
    for other in kept[1:]:
        np.testing.assert_array_equal(shown(other), shown(kept[0]))
    assert distance(shown(kept[0]), steps[-1].pins)[0, 4] < 1.5


def test_diverged_frame_is_isolated(monkeypatch: pytest.MonkeyPatch) -> None:
    hand = corrected_clip()
    good = refit_range(hand)
    transl = good.transl.copy()
    transl[4, 2] = 1e12
    monkeypatch.setattr("handfit_core.edit.messages.refit_range", lambda *_: replace(good, transl=transl))
    request = {"mode": "range", "hand": to_message(hand)}
    found = result_from_message(answer(request, lambda: False), COUNT)
    assert np.flatnonzero(~found.present).tolist() == [4]
    np.testing.assert_allclose(found.hand_pose[5:], good.hand_pose[5:], atol=1e-6)


COUNT = 21


@cache
def clip() -> tuple[Parameters, Parameters, tuple[HandDetection, ...]]:
    """A hand that opens and wanders: its truth, captured poses, and detections whose index fingertip is off
    by 30 px in frames 5 to 15."""
    betas, orient, pose, transl = true_hands("right", 1, seed=6)
    t = np.arange(COUNT) / FPS
    true = (
        np.repeat(betas, COUNT, 0),
        np.repeat(orient, COUNT, 0),
        (1.0 + 0.3 * np.sin(3 * t))[:, None] * pose,
        transl + np.stack([0.04 * np.sin(2 * t), 0.02 * t, 0.03 * t], axis=-1),
    )
    detections = [seen(p, "right", noise=1.5, seed=i) for i, p in enumerate(landmarks_of("right", *true))]
    for detection in detections[5:16]:
        detection.keypoints[TIP, :2] += (25.0, 17.0)
    fits = captured("right", detections)
    return true, (true[0], *fits[1:]), tuple(detections)


def corrected_clip(**more: Any) -> RefineHand:
    """Pinned in frames 8 and 13."""
    true, start, detections = clip()
    pins = no_pins(COUNT)
    pins[[8, 13], TIP] = handles("right", true)[[8, 13], TIP]
    return make_hand("right", list(detections), start, pins, **more)


def test_range_pins_mend_frames_between() -> None:
    aims = handles("right", clip()[0])[:, TIP]
    hand = corrected_clip()
    plain = refit_range(replace(hand, pins=no_pins(COUNT)))
    mended = refit_range(hand)
    assert distance(shown(mended), hand.pins)[[8, 13], TIP].max() < 1.5
    before, after = (distance(shown(r)[:, TIP], aims) for r in (plain, mended))
    assert before[6:15].mean() > 7.0
    between = [7, 9, 10, 11, 12, 14]
    assert after[between].mean() < 0.6 * before[between].mean()
    # Far from the pins nothing changes.
    far = distance(shown(mended), shown(plain))[[0, 1, 20]]
    assert far.max() < 2.5
    assert far.mean() < 0.3
    assert mended.present.all()


def test_locks_hold_over_time() -> None:
    """Also in a gap, whose locked joints stay as they were."""
    hand = corrected_clip(locked=unlocked(1, 2, 5, 15))
    hand = replace(hand, detections=hand.detections.select(~np.isin(hand.detections.frame, [2, 3])))
    found = refit_range(hand)
    assert found.present.all()
    locked = np.repeat(hand.locked[1:], 3)
    np.testing.assert_array_equal(found.hand_pose[:, locked], hand.hand_pose[:, locked])
    assert np.abs(found.hand_pose[:, ~locked] - hand.hand_pose[:, ~locked]).max() > 1e-2
    wrist = refit_range(replace(hand, locked=unlocked(0)))
    np.testing.assert_array_equal(wrist.global_orient, hand.global_orient)
    np.testing.assert_array_equal(wrist.transl, hand.transl)
    assert np.abs(wrist.hand_pose - hand.hand_pose).max() > 1e-2


def test_gaps_of_a_range() -> None:
    """Short ones are filled, long ones stay empty, and a pin in one with a pose is met."""
    true, _, detections = clip()
    count = COUNT + 40
    seen_rows = [*detections, *([None] * 20), *detections[:20]]
    seen_rows[2] = seen_rows[3] = None
    rows = np.minimum(np.arange(count), COUNT - 1)
    start = (true[0][:1], *(a[rows].copy() for a in true[1:]))
    start[1][[50, 51]] = np.nan  # poses are no more than a start
    pins = no_pins(count)
    pins[30, TIP] = handles("right", true)[-1, TIP] + (8.0, 0.0)
    found = refit_range(make_hand("right", seen_rows, start, pins))
    # With the pin there are two short gaps, without it one long one.
    assert found.present.all()
    assert distance(shown(found), pins)[30, TIP] < 2.0
    without = refit_range(make_hand("right", seen_rows, start))
    assert not without.present[COUNT : COUNT + 20].any()


def test_a_range_can_be_stopped() -> None:
    with pytest.raises(Cancelled):
        refit_range(corrected_clip(), lambda: True)
    asked = []
    refit_range(corrected_clip(), lambda: bool(asked.append(1)))
    assert len(asked) >= 2


def test_nothing_to_fit_to() -> None:
    nothing = (np.zeros((1, 10)), *(np.full((4, n), np.nan) for n in (3, 45, 3)))
    hand = make_hand("left", [None] * 4, nothing)
    for found in (refit_each(hand), refit_range(hand)):
        assert not found.present.any()
        assert found.hand_pose.shape == (4, 45)


def same(a: RefineHand, b: RefineHand) -> None:
    for name in ("side", "model", "intrinsics", "fps", "smoothing", "holes"):
        assert getattr(a, name) == getattr(b, name)
    for name in ("betas", "pins", "global_orient", "hand_pose", "transl", "locked"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    one, other = a.detections, b.detections
    for name in ("frame", "side", "overlapped"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    np.testing.assert_allclose(one.keypoints, other.keypoints, atol=1e-4)
    np.testing.assert_allclose(one.world, other.world, atol=1e-7)
    np.testing.assert_allclose(one.score, other.score, rtol=1e-6)


def test_messages_come_back() -> None:
    hand = corrected_clip(locked=unlocked(3), smoothing=0.5, holes=(4,))
    seen = hand.detections
    odd = seen.frame == 7
    seen = replace(
        seen, side=np.where(odd, 1 - seen.side, seen.side), overlapped=odd[:, None] & (np.arange(21) > 3)
    )
    hand = replace(hand, detections=seen.select(seen.frame > 0))
    same(from_message(json.loads(json.dumps(to_message(hand), allow_nan=False))), hand)


def test_optional_fields_have_defaults() -> None:
    message = to_message(dragged(TIP, (3.0, 3.0))[0])
    for name in ("model", "fps", "smoothing", "holes", "agrees"):
        del message[name]
    hand = from_message(message)
    assert (hand.model, hand.fps, hand.smoothing, hand.holes) == ("open-hand", 25.0, 1.0, ())


@pytest.mark.parametrize("mode", ["each", "draft", "range"])
def test_answers(mode: str) -> None:
    hand, _ = dragged(TIP, (9.0, 7.0))
    request = {"id": 1, "request": "refit", "mode": mode, "hand": to_message(hand)}
    done = json.loads(json.dumps(answer(json.loads(json.dumps(request)), lambda: False), allow_nan=False))
    assert 0 < done["seconds"] < 60
    found = result_from_message(done)
    assert distance(shown(found), hand.pins)[0, TIP] < (3.0 if mode == "draft" else 1.5)
    if mode == "draft":  # it goes on from whatever was answered last
        return
    again = refit_range(hand) if mode == "range" else refit_each(hand)
    for name in ("betas", *POSE_ARRAYS):
        np.testing.assert_allclose(getattr(found, name), getattr(again, name), rtol=1e-3, atol=5e-2)
    with pytest.raises(Cancelled):
        answer(request, lambda: True)


def test_only_the_same_drag_is_remembered() -> None:
    hand, _ = dragged(TIP, (9.0, 7.0))
    result = refit_each(hand)
    recent = Recent()
    assert recent.of(hand) is None
    recent.keep(hand, result)
    assert recent.of(dragged(TIP, (1.0, 1.0))[0]) is result
    assert recent.of(replace(hand, transl=hand.transl + 0.01)) is None
    assert recent.of(replace(hand, locked=unlocked(2))) is None
    clip_hand = corrected_clip()
    recent.keep(clip_hand, result)
    assert recent.of(clip_hand) is None


def photo_like(value: float) -> HandDetection:
    """A detection whose numbers are all the same."""
    return HandDetection("right", 1.0, np.full((21, 3), value), np.zeros((21, 3)))


BAD_HANDS: list[tuple[str, Any, str]] = [
    ("betas", np.full(10, np.nan), "betas"),
    ("pins", np.tile([np.nan, 3.0], (1, 21, 1)), "pins"),
    ("hand_pose", np.zeros((2, 45)), "hand_pose"),
    ("transl", np.array([["a", "b", "c"]]), "transl"),
    ("side", "middle", "side"),
    ("fps", 0.0, "fps"),
    ("fps", np.nan, "fps"),
    ("fps", 1e200, "fps must be a finite number from 0.001 to 1e"),
    ("pins", np.full((1, 21, 2), -1e10), "pins holds numbers beyond 1e"),
    ("smoothing", 11.0, "smoothing"),
    ("pins", np.zeros((0, 21, 2)), "pins has shape"),
    ("detections", columns([None, photo_like(0.0)]), "detections: at most one"),
    ("detections", columns([photo_like(np.nan)]), "detections: keypoints is not finite"),
]


@pytest.mark.parametrize(("field", "value", "named"), BAD_HANDS)
def test_bad_hands_are_named(field: str, value: Any, named: str) -> None:
    with pytest.raises(OptionError, match=named):
        replace(dragged(TIP, (1.0, 1.0))[0], **{field: value})


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *((name, None) for name in ("side", "betas", "pins", "keypoints", "world", "score", "intrinsics")),
        ("keypoints", pack(np.zeros((1, 21)))),
        ("world", pack(np.zeros((3, 21, 3)))),
        ("score", pack(np.zeros(2))),
        ("overlapped", pack(np.zeros((1, 21)))),
        ("betas", [0.0] * 10),
        ("pins", {"dtype": "float32", "shape": [1, 21, 2], "data": "AAAA"}),
        ("side", "both"),
    ],
)
def test_bad_messages_are_named(field: str, value: Any) -> None:
    message = to_message(dragged(TIP, (1.0, 1.0))[0])
    if value is None:
        del message[field]
    else:
        message[field] = value
    with pytest.raises(HandfitError, match="intrinsics|" + field):
        from_message(message)


@pytest.mark.parametrize(
    ("message", "named"),
    [({"mode": "all"}, "mode"), ({"mode": "each"}, "hand"), ({"hand": 3}, "hand"), ({"hand": {}}, "side")],
)
def test_bad_requests_are_named(message: dict[str, Any], named: str) -> None:
    with pytest.raises(HandfitError, match=named):
        answer(message, lambda: False)
    with pytest.raises(ProtocolError, match="result"):
        result_from_message(message)


def test_kept_model(tmp_path: Path) -> None:
    path = save_model_npz(model_of("right"), tmp_path / "MANO_RIGHT.npz")
    first = kept_model(str(path), "right")
    assert kept_model(str(path), "right") is first
    assert kept_model(str(tmp_path), "right").digest == first.digest
    other = replace(model_of("right"), v_template=model_of("right").v_template * 1.1)
    save_model_npz(other, path)
    os.utime(path, ns=(1, 1))
    assert kept_model(str(path), "right").digest != first.digest
    shutil.rmtree(tmp_path)
    with pytest.raises(HandModelError, match="MANO_RIGHT"):
        kept_model(str(path), "right")


def test_warming_up(tmp_path: Path) -> None:
    warm_up()
    path = save_model_npz(model_of("right"), tmp_path / "MANO_RIGHT.npz")
    warm_up(str(path))  # one side is enough
    with pytest.raises(HandModelError):
        warm_up(str(tmp_path / "none.npz"))


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("transl", np.zeros((2, 3))),
        ("hand_pose", np.full((1, 45), np.inf)),
    ],
    ids=lambda value: str(np.shape(value)),
)
def test_wrong_answer_shapes_are_named(name: str, array: np.ndarray) -> None:
    done = answer({"mode": "draft", "hand": to_message(dragged(TIP, (1.0, 1.0))[0])}, lambda: False)
    with pytest.raises(ProtocolError, match=name):
        result_from_message({"result": {**done["result"], name: pack(array)}})
