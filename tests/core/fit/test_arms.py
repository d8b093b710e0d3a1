"""Arms: terms by finite differences, known people found again, and what keeps a hand from getting one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from handfit_core.capturing import arms as takes
from handfit_core.capturing.arms import _seen, arms_of
from handfit_core.detect.body import ELBOWS, SHOULDERS, WRISTS, BodyTrack
from handfit_core.fit.arms import (
    ARMS,
    FREE,
    TERMS,
    ArmFit,
    Arms,
    ArmsSeen,
    first_guess,
    fit_arms,
    shoulder_width,
    solve_arms,
)
from handfit_core.hand_model.arm import ArmMotion
from handfit_core.take import HandTrack
from tests.core.fit.differences import by_each, close, random, unit
from tests.persons import CAMERA, FPS, body_of, person
from tests.takes import seen_as as seen_hand

PERSON = person()


def without(hand: HandTrack, rows: slice) -> HandTrack:
    """The hand gone in those frames."""
    gone = np.zeros(len(hand.detected), dtype=bool)
    gone[rows] = True
    joints = np.where(gone[:, None, None], np.nan, hand.joints_3d)
    hand = seen_hand(hand, detected=hand.detected & ~gone)
    return replace(hand.posed_at(~gone), joints_3d=joints)


def at(arm: ArmMotion | None) -> np.ndarray:
    """(T, 3, 3) shoulder, elbow and wrist."""
    assert arm is not None
    return np.stack([arm.shoulder, arm.elbow, arm.wrist], axis=1)


def degrees_off(arm: ArmMotion | None, truth: np.ndarray) -> np.ndarray:
    """(T, 2) of upper arm and forearm."""
    cosine = (unit(np.diff(at(arm), axis=1)) * unit(np.diff(truth, axis=1))).sum(axis=2)
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


def problem(count: int = 4) -> tuple[Arms, ArmsSeen]:
    """Arms of both sides, some degrees and centimetres from what is seen. The left hand is missing in the
    first frame, and the right wrist is bent too far in the second."""
    known = person(count, bend=0.4)
    hands = without(known.hands[0], slice(0, 1)), known.hands[1]
    seen = _seen(hands, known.body, CAMERA, slice(0, count))
    shoulder, elbow, wrist = known.points.transpose(2, 1, 0, 3)
    arms = Arms(
        wrist + random(*wrist.shape, scale=0.02),
        unit(unit(wrist - elbow) + random(*wrist.shape, seed=1, scale=0.2)),
        unit(unit(elbow - shoulder) + random(*wrist.shape, seed=2, scale=0.2)),
        1.1 * seen.lengths,
    )
    arms.forearm[1, 1] = -arms.forearm[1, 1]
    return arms, seen


@pytest.mark.parametrize("term", [*TERMS, shoulder_width], ids=lambda term: term.__name__)
def test_terms_lead_downhill(term):
    """Their derivatives give the slope of their cost by every unknown, also where outliers count less."""
    arms, seen = problem()
    residual, jacobian = term(arms, seen)
    raw = np.einsum(
        "t...k,t...kv->t...v" if term is not shoulder_width else "tk,tkav->tav", residual, jacobian
    )
    slope = np.einsum("tav,tavu->tau", raw, arms.derivatives())
    still, alike = np.zeros((*raw.shape[:2], FREE)), np.zeros((len(raw), 2))
    cost = by_each(lambda step: np.square(term(arms.moved(step, alike), seen)[0]).sum(), still)
    assert np.abs(cost).max() > 1.0
    close(2.0 * slope[..., :FREE].ravel(), cost, rtol=1e-4, atol=1e-5 * np.abs(cost).max())
    cost = by_each(lambda longer: np.square(term(arms.moved(still, longer), seen)[0]).sum(), alike)
    close(
        2.0 * slope[..., FREE:].sum(axis=1).ravel(), cost, rtol=1e-4, atol=1e-5 * max(np.abs(cost).max(), 1.0)
    )


def test_the_fit_leads_downhill():
    """All terms with the motion and the lengths: the gradient is that of the cost."""
    arms, seen = problem()
    fit = ArmFit(seen, FPS)
    count, number = arms.wrist.shape[:2]
    still, alike = np.zeros((count, number, FREE)), np.zeros((count, 2))
    system = fit.blocks(arms)
    cost = by_each(lambda step: fit.blocks(arms.moved(step, alike)).cost.sum(), still)
    close(2.0 * system.gradient.ravel(), cost, rtol=1e-4, atol=1e-5 * np.abs(cost).max())
    cost = by_each(
        lambda longer: fit.blocks(arms.moved(still, np.tile(longer, (count, 1)))).cost.sum(), np.zeros(2)
    )
    close(2.0 * system.by_length, cost, rtol=1e-4, atol=1e-5 * np.abs(cost).max())


@pytest.mark.parametrize(("count", "rate"), [(1, 24.0), (40, 1000.0)])
def test_short_and_fast_clips_have_arms(count, rate):
    """A photo is one of one frame."""
    short = person(count, speed=FPS / rate)
    for hand, truth in zip(arms_of(short.hands, [short.body], CAMERA, rate), short.points, strict=True):
        assert degrees_off(hand.arm, truth).max() < 3.0


@pytest.mark.parametrize("bend", [0.0, 0.5, -0.5])
def test_people_are_found_again(bend):
    """Both arms, in their lengths, with the wrist where the hand's is; a bent wrist draws hardly."""
    known = person(bend=bend)
    for hand, truth in zip(arms_of(known.hands, [known.body], CAMERA, FPS), known.points, strict=True):
        assert hand.arm is not None
        assert hand.arm.present.all()
        assert hand.no_arm == ""
        hand.check(len(truth))
        close(hand.arm.wrist, hand.joints_3d[:, 0])
        lengths = np.linalg.norm(np.diff(at(hand.arm), axis=1), axis=2)
        close(lengths, np.broadcast_to(hand.arm.lengths, lengths.shape))
        assert np.median(degrees_off(hand.arm, truth)) < 2.5
        assert degrees_off(hand.arm, truth).max() < 6.0


def test_a_persons_lengths_are_learned():
    """Of somebody with long upper arms and short forearms."""
    known = person(200, build=(1.12, 0.92))
    for hand, truth in zip(arms_of(known.hands, [known.body], CAMERA, FPS), known.points, strict=True):
        assert np.median(degrees_off(hand.arm, truth), axis=0).max() < 3.0
        assert hand.arm is not None
        close(hand.arm.lengths, np.linalg.norm(np.diff(truth, axis=1), axis=2)[0], rtol=0.04)


def test_noise_falls():
    """Of somebody who holds still, where the networks' points tremble by 19 mm."""
    still = person(speed=0.0)
    found = arms_of(still.hands, [body_of(still.points, 0.019)], CAMERA, FPS)
    for hand, truth in zip(found, still.points, strict=True):
        points = at(hand.arm)
        moved = np.linalg.norm(np.diff(points[:, 2] - points[:, 0], axis=0), axis=1)
        assert np.median(moved) < 0.002
        assert np.percentile(moved, 95) < 0.005
        assert np.median(degrees_off(hand.arm, truth), axis=0).max() < 5.0


def test_long_clips_are_solved_in_windows():
    """Windows give what one system over the whole clip gives, to a millimetre."""
    long = person(720)
    seen = _seen(long.hands, body_of(long.points, 0.019), CAMERA, slice(0, 720))
    parts = fit_arms(seen, FPS)
    start = replace(first_guess(seen), lengths=parts.lengths)
    whole = solve_arms(ArmFit(seen, FPS, learn=False), start)
    shoulders = (arms.points[..., 0, :] for arms in (whole, parts))
    assert np.linalg.norm(np.subtract(*shoulders), axis=-1).max() < 0.001


def test_shoulders_of_one_person_are_joined():
    """By their width; alone, the arm that is hardly seen would hang somewhere else."""
    visibility = PERSON.body.visibility.copy()
    visibility[:, [SHOULDERS["left"], ELBOWS["left"]]] = 0.01
    seen = _seen(PERSON.hands, replace(PERSON.body, visibility=visibility), CAMERA, slice(0, 60))
    shoulders = fit_arms(seen, FPS).points[..., 0, :]
    apart = np.linalg.norm(shoulders[:, 0] - shoulders[:, 1], axis=1)
    assert np.abs(apart - ARMS.shoulders * seen.hand_length).max() < 0.02


def test_a_hand_that_leaves_keeps_its_arm():
    """While it is away there is none, and then the shoulder is where it would have been."""
    whole = at(arms_of(PERSON.hands, [PERSON.body], CAMERA, FPS)[0].arm)
    left = without(PERSON.hands[0], slice(20, 40))
    arm = arms_of([left, PERSON.hands[1]], [PERSON.body], CAMERA, FPS)[0].arm
    assert arm is not None
    assert arm.present.tolist() == left.present.tolist()
    assert np.linalg.norm(at(arm) - whole, axis=2)[arm.present].max() < 0.01


def test_several_people_and_shots():
    """Each hand hangs on the body at whose wrist it is, whatever the order, and anew after a cut."""
    other = person(60, distance=2.5)
    moved = replace(other.body, keypoints=other.body.keypoints + [500.0, 0.0])
    alone = at(arms_of(PERSON.hands, [PERSON.body], CAMERA, FPS)[1].arm)
    for bodies in [PERSON.body, moved], [moved, PERSON.body]:
        close(at(arms_of(PERSON.hands, bodies, CAMERA, FPS)[1].arm), alone)
    # Another camera from the 30th frame on: far away, and no body is found there at its wrists
    keypoints = PERSON.body.keypoints + np.where(np.arange(60) < 30, 0.0, 600.0)[:, None, None]
    arm = arms_of(PERSON.hands, [replace(PERSON.body, keypoints=keypoints)], CAMERA, FPS)[1].arm
    assert arm is not None
    assert arm.present.tolist() == [True] * 30 + [False] * 30


@pytest.mark.parametrize(("jump", "cut", "last"), [(0.0, False, 40), (600.0, False, 30), (0.0, True, 30)])
def test_an_arm_without_a_body_ends(jump, cut, last):
    """Soon after it is lost, and at once at a cut: where one was seen, or the hand jumps."""
    lost = np.arange(60) >= 30
    hand = PERSON.hands[0]
    moved = seen_hand(hand, keypoints_2d=hand.keypoints_2d + np.where(lost, jump, 0.0)[:, None, None])
    body = replace(PERSON.body, present=~lost, cut=cut & (np.arange(60) == 30))
    arm = arms_of([moved], [body], CAMERA, FPS)[0].arm
    assert arm is not None
    assert np.flatnonzero(arm.present).tolist() == list(range(last))


def test_a_hand_that_returns_without_its_body_has_no_arm():
    """The body that was there meanwhile does not count: it may be somebody else's."""
    hand, lost = without(PERSON.hands[0], slice(20, 40)), np.arange(60) >= 38
    arm = arms_of([hand], [replace(PERSON.body, present=~lost)], CAMERA, FPS)[0].arm
    assert arm is not None
    assert np.flatnonzero(arm.present).tolist() == list(range(20))


def seen_as(**arrays: np.ndarray | float) -> Callable[[BodyTrack], BodyTrack]:
    def changed(body: BodyTrack) -> BodyTrack:
        shapes = {name: getattr(body, name) for name in arrays}
        return replace(body, **{n: np.broadcast_to(v, shapes[n].shape).copy() for n, v in arrays.items()})

    return changed


def hidden(of: dict[str, int]) -> Callable[[BodyTrack], BodyTrack]:
    def changed(body: BodyTrack) -> BodyTrack:
        visibility = body.visibility.copy()
        visibility[:, of["left"]] = 0.3
        return replace(body, visibility=visibility)

    return changed


def mirrored(body: BodyTrack) -> BodyTrack:
    order = np.arange(body.keypoints.shape[1])
    for of in SHOULDERS, ELBOWS, WRISTS:
        order[[of["left"], of["right"]]] = of["right"], of["left"]
    return replace(body, keypoints=body.keypoints[:, order], world=body.world[:, order])


BODIES: dict[str, tuple[Callable[[BodyTrack], BodyTrack], str]] = {
    "none": (lambda body: replace(body, present=~body.present), takes.NO_BODY),
    "elsewhere": (lambda body: replace(body, keypoints=body.keypoints + 300.0), takes.APART),
    "other side": (mirrored, takes.OTHER_SIDE),
    "hardly a body": (seen_as(score=0.6), takes.NO_PERSON),
    "too small": (lambda body: replace(body, world=4.0 * body.world), takes.FOREARM_ONLY),
    "shoulder": (hidden(SHOULDERS), takes.HIDDEN[0]),
    "elbow": (hidden(ELBOWS), takes.HIDDEN[1]),
    "wrist": (hidden(WRISTS), takes.HIDDEN[2]),
}


@pytest.mark.parametrize(("change", "why"), BODIES.values(), ids=BODIES)
def test_no_arm_is_better_than_a_wrong_one(change, why):
    """The sentence says which gate a body does not pass."""
    hand = arms_of(PERSON.hands[:1], [change(PERSON.body)], CAMERA, FPS)[0]
    assert hand.arm is None
    assert hand.no_arm == why
    assert len(why) <= 200


def test_a_take_without_bodies_or_hands_gets_sentences():
    assert [hand.no_arm for hand in arms_of(PERSON.hands, [], CAMERA, FPS)] == [takes.NO_BODY] * 2
    assert arms_of([], [PERSON.body], CAMERA, FPS) == ()
    never = without(PERSON.hands[0], slice(None))
    found = arms_of([never, PERSON.hands[1]], [PERSON.body], CAMERA, FPS)
    assert [hand.no_arm for hand in found] == [takes.NO_BODY, ""]
