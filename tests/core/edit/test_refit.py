"""Corrections by hand: pins are met, other fingers stay, locks hold, neighbours follow."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.common.errors import Cancelled, HandModelError
from handfit_core.common.skeleton import SIDES, TIP_KEYPOINTS, Side
from handfit_core.edit import (
    RefineHand,
    answer,
    refit_each,
    refit_range,
    result_from_message,
    to_message,
    warm_up,
)
from handfit_core.fit.fast import fit_track
from handfit_core.fit.solvers import never
from handfit_core.hand_model import save_model_npz
from handfit_core.hand_model.files import kept_model
from handfit_core.hand_model.motion import HandMotion
from tests.core.edit.hands import (
    FPS,
    captured,
    distance,
    drag,
    joints_of,
    locked,
    missed,
    moved,
    photo,
    posed,
    rows_of,
    shown,
    to_refine,
    true_hands,
    turned,
)
from tests.core.fit.detections import (
    CAMERA,
    detections_of,
    laid_error,
    model_of,
    track_of,
)

TIP = 8
OTHERS = [k for k in range(21) if k not in (5, 6, 7, 8)]
KNUCKLES = [5, 9, 13, 17]
PALM = [0, *KNUCKLES]


@pytest.mark.parametrize(
    ("by", "along", "least", "rest", "most"),
    [
        ({TIP: (0.0, 12.0)}, [6, 7], 2.4, OTHERS, 1.0),
        ({TIP: (0.0, 0.0)}, [], 0.0, range(21), 0.5),
        ({5: (-12.0, 12.0)}, KNUCKLES, 3.0, [0], 10.0),
        ({0: (12.0, -9.0)}, KNUCKLES, 2.0, TIP_KEYPOINTS, 4.0),
        ({TIP: (-8.0, 6.0), 4: (6.0, 4.0), 17: (4.0, -4.0), 20: (5.0, 9.0)}, [8, 4, 20], 4.0, [0], 10.0),
    ],
)
def test_what_comes_along(
    by: Mapping[int, Sequence[float]], along: list[int], least: float, rest: Sequence[int], most: float
) -> None:
    """A fingertip takes its finger along, a knuckle the palm on which all fingers ride, and a wrist leaves
    the fingertips."""
    hand = drag(photo(), by)
    found = refit_each(hand)
    assert missed(hand, found).max() < 1.0
    assert moved(hand, found)[along].min(initial=np.inf) > least
    assert moved(hand, found)[list(rest)].mean() < most
    assert len(by) > 1 or np.median(turned(hand, found)) < 6.0


@pytest.mark.parametrize("side", SIDES)
def test_a_wrong_fingertip_is_mended(side: Side) -> None:
    """The detector puts a fingertip 40 px aside in each of twelve frames; the artist puts it back."""
    true, rng = true_hands(side, 12, seed=3), np.random.default_rng(0)
    detections, pins = detections_of(side, rows_of(true), noise=1.0), np.full((12, 21, 2), np.nan)
    for row, tip in enumerate(rng.choice(TIP_KEYPOINTS, 12)):
        angle = rng.uniform(0, 2 * np.pi)
        pins[row, tip] = shown(true)[row, tip]
        detections[row].keypoints[0, tip, :2] += 40.0 * np.array([np.cos(angle), np.sin(angle)])
    hand = to_refine(captured(side, detections), detections, pins)
    found = refit_each(hand)
    assert missed(hand, found).max() < 2.0
    before, after = (laid_error(joints_of(one), joints_of(true)).mean() for one in (hand, found))
    assert after < 0.85 * before


@pytest.mark.parametrize("joints", [(0,), (1, 2, 3), (2,), (0, 1, 4, 7, 10, 13), tuple(range(16))])
def test_locked_joints_hold(joints: tuple[int, ...]) -> None:
    hand = drag(replace(photo(), locked=locked(*joints)), {TIP: (10.0, 14.0)})
    found = refit_each(hand)
    rotations, aims = (np.hstack([one.global_orient, one.hand_pose]).reshape(16, 3) for one in (found, hand))
    np.testing.assert_array_equal(rotations[list(joints)], aims[list(joints)])
    if 0 in joints:
        np.testing.assert_array_equal(found.transl, hand.transl)
    # What is free still goes for the pin.
    assert len(joints) == 16 or missed(hand, found).max() < 0.8 * np.hypot(10.0, 14.0)


def test_poses_and_detections_may_be_missing() -> None:
    """In the rows: a pose alone, a detection alone, neither, and a pose behind the camera."""
    one = photo()
    pose = [np.repeat(rows, 4, axis=0) for rows in one.pose]
    for rows in pose:
        rows[[1, 2]] = np.nan
    pose[2][3] = 0.0, 0.0, -0.5
    pins = np.full((4, 21, 2), np.nan)
    pins[:3, TIP] = shown(one)[0, TIP] + (-7.0, 5.0)
    seen = replace(one.detections, frame=np.array([1]))
    hand = posed(one, *pose, pins=pins, detections=seen)
    found = refit_each(hand)
    np.testing.assert_array_equal(found.present, [True, True, False, False])
    assert distance(shown(found), pins)[:2, TIP].max() < 1.0
    near = distance(shown(found), shown(one))[:2, OTHERS].mean(axis=1)
    assert (near < [1.0, 5.0]).all()
    assert all(np.isnan(rows[2:]).all() for rows in found.pose)
    nothing = replace(hand.posed_at(np.zeros(4, dtype=bool)), detections=seen.select(slice(0)))
    assert not refit_each(nothing).present.any()
    assert not refit_range(nothing).present.any()


def outwards(points: np.ndarray, tip: int) -> np.ndarray:
    """(2,) the direction in the picture from a finger's first point to its tip."""
    along = points[tip] - points[tip - 3]
    return along / np.linalg.norm(along)


def test_what_changes_the_distance() -> None:
    """A fingertip that is drawn outwards does not, though nearer it would reach its pin. Where wrist and
    knuckles are drawn apart, that hand is nearer."""
    for tip in TIP_KEYPOINTS:
        hand = drag(photo(), {tip: 12.0 * outwards(shown(photo())[0], tip)})
        assert abs((joints_of(refit_each(hand)) - joints_of(hand))[0, 0, 2]) < 0.004  # metres
    palm = shown(photo())[0, PALM]
    hand = drag(photo(), dict(zip(PALM, 0.1 * (palm - palm.mean(axis=0)), strict=True)))
    found = refit_each(hand)
    assert missed(hand, found).max() < 3.0
    assert 0.85 < joints_of(found)[0, 0, 2] / joints_of(hand)[0, 0, 2] < 0.95


def test_untouched_fingers_keep_pose() -> None:
    """Beyond the limits, and far from what hands usually do."""
    by_hand = photo().hand_pose.copy()
    by_hand[0, 27:36] += np.radians([20.0, -15.0, 60.0, 10.0, 0.0, -50.0, 0.0, 25.0, -30.0])
    by_hand[0, 9:18] += np.radians([0.0, 30.0, -60.0, 0.0, 0.0, -40.0, 0.0, 0.0, 70.0])
    hand = drag(replace(photo(), hand_pose=by_hand), {TIP: (5.0, 8.0), 4: (4.0, -3.0)})
    found = refit_each(hand)
    assert missed(hand, found).max() < 1.0
    np.testing.assert_array_equal(found.hand_pose[0, 9:36], by_hand[0, 9:36])
    assert turned(hand, found)[0, [0, 1, 2, 12, 13, 14]].max() > 1.0


def test_small_drag() -> None:
    """Its own finger does not fall back to what hands usually do."""
    by_hand = photo().hand_pose.copy()
    by_hand[0, 0:9] *= 0.3
    hand = drag(replace(photo(), hand_pose=by_hand), {TIP: (0.3, 0.2)})
    assert turned(hand, refit_each(hand)).max() < 2.0


def test_far_drag_returns_to_detection() -> None:
    """Its pose was changed by hand; where it is dragged far from that, the detection knows it better."""
    hand = photo(noise=0.5)
    by_hand = hand.hand_pose.copy()
    by_hand[0, [2, 5, 8]] -= np.radians([50.0, 40.0, 20.0])
    pins, detected = hand.pins.copy(), hand.detections.keypoints_2d
    pins[0, 6] = detected[0, 6]
    hand = replace(hand, hand_pose=by_hand, pins=pins)
    unseen = replace(hand, detections=hand.detections.select(slice(0)))
    off, without = (distance(shown(refit_each(h)), detected)[0, [7, TIP]].mean() for h in (hand, unseen))
    assert off < 0.5 * without


def ask(mode: str, hand: RefineHand) -> HandMotion:
    return result_from_message(answer({"mode": mode, "hand": to_message(hand)}, never), len(hand))


STEPS = (0.25, 0.5, 0.75, 0.95, 1.0)


def test_drafts_go_on_from_the_last() -> None:
    """Those of a thumb that is drawn far aside, step by step, each begin where the one before ended."""
    steps = [drag(photo(), {4: (share * 120.0, 0.0)}) for share in STEPS]
    ask("each", corrected_clip())  # of many frames: forgotten
    led = None
    for hand in steps:
        asked, led = ask("draft", hand), refit_each(hand, led, draft=True)
        assert missed(hand, led).max() < 3.0
        assert distance(shown(asked), shown(led)).max() < 1.0
    assert distance(shown(led), shown(refit_each(steps[-1], draft=True))).max() > 1.0
    # Another pose, or other locks, are another drag.
    for other in (replace(hand, transl=hand.transl + 0.01), replace(hand, locked=locked(2))):
        ask("draft", hand)
        expected = shown(refit_each(other, draft=True))
        np.testing.assert_allclose(shown(ask("draft", other)), expected, atol=1e-6)


def test_drag_path_does_not_count() -> None:
    """What is kept is the same after any drafts, at one go too, and comes as near to its pin."""
    steps = [drag(photo(), {4: (share * 120.0, 0.0)}) for share in STEPS]
    kept = []
    for way in (steps[:0], steps[:-1], steps[-2::-1]):
        for hand in way:
            ask("draft", hand)
        kept.append(shown(ask("each", steps[-1])))
    np.testing.assert_array_equal(kept[1:], [kept[0]] * 2)
    assert distance(kept[0], steps[-1].pins)[0, 4] < 1.5


COUNT = 21


@cache
def clip() -> tuple[HandMotion, RefineHand]:
    """A hand that opens and wanders, and what is captured of it: detections whose index fingertip is off by
    30 px in frames 5 to 15."""
    still, t = true_hands("right", 1, seed=6), np.arange(COUNT) / FPS
    true = still.with_pose(
        np.repeat(still.global_orient, COUNT, axis=0),
        (1.0 + 0.3 * np.sin(3 * t))[:, None] * still.hand_pose,
        still.transl + np.stack([0.04 * np.sin(2 * t), 0.02 * t, 0.03 * t], axis=-1),
    )
    detections = detections_of("right", rows_of(true), noise=1.5)
    for detection in detections[5:16]:
        detection.keypoints[0, TIP, :2] += (25.0, 17.0)
    start = replace(captured("right", detections), betas=true.betas)
    return true, to_refine(start, detections)


def corrected_clip(**fields: Any) -> RefineHand:
    """Pinned in frames 8 and 13."""
    true, hand = clip()
    pins = hand.pins.copy()
    pins[[8, 13], TIP] = shown(true)[[8, 13], TIP]
    return replace(hand, pins=pins, **fields)


@pytest.mark.parametrize("smoothing", [0.0, 3.0])
def test_range_equals_capture(smoothing: float) -> None:
    """At its own frame rate, with a missing picture and a gap."""
    hand = clip()[1]
    seen = hand.detections.select(hand.detections.frame != 4)
    track = replace(track_of("right", [None] * COUNT, 12.0), detections=seen, holes=(9,))
    capture = fit_track(smoothing, model_of("right"), track, CAMERA, lambda: None)
    hand = replace(hand.posed_at(np.zeros(COUNT, dtype=bool)), betas=capture.betas, detections=seen)
    found = refit_range(replace(hand, smoothing=smoothing, holes=(9,), fps=12.0))
    assert distance(joints_of(found), joints_of(capture)).max() < 1e-5


def test_range_pins_mend_frames_between() -> None:
    true, plain = clip()[0], refit_range(clip()[1])
    hand = corrected_clip()
    mended = refit_range(hand)
    assert missed(hand, mended).max() < 1.5
    before, after = (distance(shown(r), shown(true))[:, TIP] for r in (plain, mended))
    assert before[6:15].mean() > 7.0
    between = [7, 9, 10, 11, 12, 14]
    assert after[between].mean() < 0.6 * before[between].mean()
    far = distance(shown(mended), shown(plain))[[0, 1, 20]]
    assert far.max() < 2.5
    assert far.mean() < 0.3
    # Drawn outwards, the finger misses its pin rather than that the hand comes nearer.
    outward = drag(clip()[1], {TIP: 15.0 * outwards(shown(true)[10], TIP)}, 10)
    found = refit_range(outward)
    assert distance(shown(found), shown(plain))[10, TIP] > 5.0
    assert np.abs(joints_of(found) - joints_of(plain))[:, 0, 2].max() < 0.001


def test_locks_hold_over_time() -> None:
    """Also in a gap, whose locked joints stay as they were."""
    hand = corrected_clip(locked=locked(1, 2, 5, 15))
    hand = replace(hand, detections=hand.detections.select(~np.isin(hand.detections.frame, [2, 3])))
    found = refit_range(hand)
    assert found.present.all()
    joints = np.repeat(hand.locked[1:], 3)
    np.testing.assert_array_equal(found.hand_pose[:, joints], hand.hand_pose[:, joints])
    assert np.abs(found.hand_pose[:, ~joints] - hand.hand_pose[:, ~joints]).max() > 1e-2
    wrist = refit_range(replace(hand, locked=locked(0)))
    np.testing.assert_array_equal(wrist.global_orient, hand.global_orient)
    np.testing.assert_array_equal(wrist.transl, hand.transl)
    assert np.abs(wrist.hand_pose - hand.hand_pose).max() > 1e-2


def test_gaps_of_a_range() -> None:
    """Short ones are filled, long ones stay empty, and a pin in one with a pose is met."""
    true, hand = clip()
    count = COUNT + 40
    rows = np.minimum(np.arange(count), COUNT - 1)
    pose = [each[rows] for each in true.pose]
    pose[0][[50, 51]] = np.nan  # poses are no more than a start
    seen = hand.detections
    early, late = seen.select(~np.isin(seen.frame, [2, 3])), seen.select(slice(20))
    late = replace(late, frame=late.frame + COUNT + 20)
    blank = np.full((count, 21, 2), np.nan)
    hand = posed(hand, *pose, detections=early.concatenate([early, late]), pins=blank)
    assert not refit_range(hand).present[COUNT : COUNT + 20].any()
    # With the pin there are two short gaps in place of the long one.
    pinned = drag(hand, {TIP: (8.0, 0.0)}, 30)
    found = refit_range(pinned)
    assert found.present.all()
    assert missed(pinned, found).max() < 2.0


def test_a_range_can_be_stopped() -> None:
    with pytest.raises(Cancelled):
        refit_range(corrected_clip(), lambda: True)
    asked = []
    refit_range(corrected_clip(), lambda: bool(asked.append(1)))
    assert len(asked) >= 2


def test_kept_model(tmp_path: Path) -> None:
    path = save_model_npz(model_of("right"), tmp_path / "MANO_RIGHT.npz")
    first = kept_model(str(path), "right")
    assert kept_model(str(path), "right") is first
    assert kept_model(str(tmp_path), "right").digest == first.digest
    save_model_npz(replace(model_of("right"), v_template=model_of("right").v_template * 1.1), path)
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
