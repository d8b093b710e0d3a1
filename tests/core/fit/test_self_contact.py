"""Parts of a hand that meet: derivatives, what is seen of them, and hands that are solid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from handfit_core.common.skeleton import SIDES, Side
from handfit_core.fit.fast import FastFitter, fitter_of, smooth_track
from handfit_core.fit.gaps import Times
from handfit_core.fit.observation import Observation, SelfContact
from handfit_core.fit.problem import Problem
from handfit_core.fit.self_contact import CROSSING, PINCH_BONES, find_self_contact
from handfit_core.fit.solution import Solution
from handfit_core.fit.terms import Contact, Interpenetration, OrdinalDepth
from handfit_core.hand_model import load_model
from handfit_core.hand_model.chain import State
from handfit_core.hand_model.surface import PAIRS, Surface
from tests.core.fit.differences import close, of_increments, random
from tests.core.fit.hands import MIRROR, make_state, observe, repeated

THUMB = np.radians([[0, 8, 26], [0, 0, 42], [0, 0, 45]]).reshape(9)
CURLED = np.radians([[0, 0, 78], [0, 0, 95], [0, 0, 55]]).reshape(9)
"""A fist, whose thumb stands in the fingers"""
PINCH = np.radians([[-5, -4, 40], [2, 0, 55], [0, 0, 28]]).reshape(9)
OPPOSED = np.radians([[-8, 12, 29], [0, 0, 24], [0, 0, 36]]).reshape(9)


def fitter(side: Side = "right") -> FastFitter:
    return fitter_of(load_model(None, side))


def posed_as(*fingers: np.ndarray, side: Side = "right", batch: int = 1, seed: int = 0) -> State:
    """Hands of the mean shape that look about into the camera, fingers bent like that."""
    chain = fitter(side).chain
    state = make_state(batch, chain, seed=seed, spread=0.02)
    angles = np.stack(fingers) * (1.0 if side == "right" else MIRROR)
    return replace(state, angles=np.broadcast_to(angles, (batch, 5, 9)), betas=np.zeros((batch, 10)))


def fists(side: Side = "right", batch: int = 4) -> State:
    return posed_as(THUMB, CURLED, CURLED, CURLED, CURLED, side=side, batch=batch)


def seen_of(state: State, side: Side = "right", **noise: float) -> Observation:
    return observe(fitter(side).chain.pose(state).points, **noise)  # type: ignore[arg-type]


def depths(state: State, side: Side = "right") -> np.ndarray:
    surface = fitter(side).surface
    return surface.depths(surface.capsules(fitter(side).chain.pose(state)))


def gaps(state: State, bones: np.ndarray) -> np.ndarray:
    """(B,) metres between the skins of two bones."""
    surface, chain = fitter().surface, fitter().chain
    pair = np.flatnonzero((bones == PAIRS).all(axis=1)).repeat(len(state))
    return surface.gaps(surface.capsules(chain.pose(state)), np.arange(len(state)), pair).gap


def anything(batch: int) -> SelfContact:
    """Everything crosses and touches, whatever is seen."""
    rng, many = np.random.default_rng(3), (batch, len(CROSSING))
    return SelfContact(
        along=rng.random((*many, 2)),
        front=rng.choice([-1.0, 1.0], many),
        separation=np.full(many, 0.01),
        in_contact=rng.random(many),
        lifted=np.zeros(batch, dtype=bool),
        pinch=rng.random((batch, len(PINCH_BONES))),
    )


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("term", [Interpenetration, OrdinalDepth, Contact])
def test_gradients_are_those_of_the_cost(term: Callable[[Surface], Any], side: Side) -> None:
    own, state = fitter(side), fists(side, 2)
    touches = np.where(np.isin(np.arange(21), [8, 12, 20]), [[4.0] * 21, [0.0] * 21], np.nan)
    seen = replace(seen_of(state, side), self_contact=anything(2), touches=touches)
    bare = Problem(own.chain, seen, own._terms[:1])
    with_term = replace(bare, terms=(*bare.terms, term(own.surface)))
    for row in range(2):
        more = partial(added_by_term, with_term, bare, state, row)
        cost, gradient = more(np.zeros((1, 52)))
        assert cost[0] > 1.0
        close(gradient[0], of_increments(lambda by, more=more: more(by)[0], 52) / 2.0, rtol=1e-4, atol=1e-3)


def added_by_term(
    problem: Problem, bare: Problem, state: State, row: int, by: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """By how much the cost (N,) and its gradient (N, 52) of one hand, moved by increments (N, 52), are more
    than those of the bare problem."""
    rows = np.full(len(by), row)
    moved = state.select(rows).moved(by[:, :7], by[:, 7:].reshape(-1, 5, 9))
    ours, theirs = (one.select(rows).blocks(moved) for one in (problem, bare))
    of_hand, of_fingers = ours.hand - theirs.hand, (ours.finger - theirs.finger).reshape(len(by), 45, -1)
    return ours.cost - theirs.cost, np.concatenate([of_hand[..., -1], of_fingers[..., -1]], axis=1)


def solved(state: State, side: Side = "right", **noise: float) -> tuple[Solution, Observation, Solution]:
    """Without and with the terms that keep hands solid."""
    own, seen = fitter(side), seen_of(state, side, **noise)
    plain = own.solve_each(own.problem(seen), state)
    return plain, *own.solve_solid(seen, plain)


@pytest.mark.parametrize("side", SIDES)
def test_fist_becomes_solid(side: Side) -> None:
    plain, _, solid = solved(fists(side), side)
    assert depths(plain.state, side).min() > 0.006
    assert depths(solid.state, side).max() < 0.004
    assert solid.converged.all()


def test_random_hands_become_solid() -> None:
    state, (least, most) = make_state(40, fitter().chain, spread=0.7), fitter().angle_bounds
    plain, _, solid = solved(replace(state, angles=np.clip(state.angles, least, most), betas=random(40, 10)))
    assert (depths(plain.state) > 0.004).mean() > 0.1
    assert (depths(solid.state) > 0.004).mean() < 0.05


def test_open_hands_are_left_as_they_are() -> None:
    state = make_state(3, fitter().chain, spread=0.05)
    plain, _, solid = solved(replace(state, betas=np.zeros((3, 10))))
    assert solid is plain


def facing(state: State, towards: float) -> State:
    """The same hands, the palm turned to the camera (1) or away from it (-1), fingers up."""
    root = np.stack([[0.0, 1.0, 0.0], [0.0, 0.0, towards], [towards, 0.0, 0.0]], axis=1)
    wrist = np.tile([0.0, 0.05, 0.5], (len(state), 1))
    return replace(state, root=np.broadcast_to(root, state.root.shape), wrist=wrist)


@pytest.mark.parametrize("towards", [1.0, -1.0])
def test_depth_order_of_crossings(towards: float) -> None:
    """Of a fist's thumb that lies over the fingers: in front as the palm shows, behind from the back."""
    own, state = fitter(), facing(fists(batch=1), towards)
    found = find_self_contact(own.surface, seen_of(state), state)
    over = found.front[0] != 0.0
    middle = own.surface.capsules(own.chain.pose(state)).ends[0].mean(axis=1)[:, 2]
    first, second = CROSSING[over].T
    sure = np.abs(middle[second] - middle[first]) > 0.008
    assert sure.any()
    assert np.array_equal(found.front[0, over][sure], np.sign(middle[second] - middle[first])[sure])
    assert (found.separation[0, over] < 0.03).all()


@pytest.mark.parametrize(
    ("frames", "cuts", "vote"),
    [(np.arange(9), [], True), (100 * np.arange(9), [], False), (np.arange(9), [3, 4], False)],
    ids=["neighbours", "far apart", "another shot"],
)
def test_neighbours_vote_on_order(frames: np.ndarray, cuts: list[int], vote: bool) -> None:
    own, state = fitter(), repeated(facing(fists(batch=1), 1.0), 9)
    seen = seen_of(state)
    seen.depth[4] *= -1.0
    times = Times.between(frames, np.isin(np.arange(8), cuts), 25.0)
    alone = find_self_contact(own.surface, seen, state).front[4]
    told = find_self_contact(own.surface, seen, state, times).front
    assert not np.array_equal(alone, told[3])
    assert np.array_equal(told[4], told[3] if vote else alone)


def test_the_thumb_is_kept_on_its_side() -> None:
    """From a start on the other side, through the fingers."""
    own, state = fitter(), facing(fists(batch=1), 1.0)
    lifted = state.angles.copy()
    lifted[0, 0, 2] -= 0.5
    seen = seen_of(replace(state, angles=lifted), noise=1.0)
    seen, solid = own.solve_solid(seen, own.solve_each(own.problem(seen), state))
    contact, ends = seen.self_contact, own.surface.capsules(own.chain.pose(solid.state)).ends[0, CROSSING]
    places = ends[:, :, 0] + contact.along[0, ..., None] * (ends[:, :, 1] - ends[:, :, 0])
    behind = (places[:, 0] - places[:, 1]) @ seen.ray[0] * contact.front[0]
    assert (behind[contact.front[0] != 0.0] < 0.0).all()
    assert depths(solid.state).max() < 0.003


def test_pinches_are_closed() -> None:
    state = facing(posed_as(OPPOSED, PINCH, *np.zeros((3, 9)), batch=6), 1.0)
    assert 0.0 < gaps(state, PINCH_BONES[0]).max() < 0.02
    plain, seen, solid = solved(state, noise=2.0)
    assert seen.self_contact.pinch[:, 0].min() > 0.5
    assert seen.self_contact.pinch[:, 1:].max() == 0.0
    assert np.abs(gaps(plain.state, PINCH_BONES[0])).mean() > 0.003
    assert np.abs(gaps(solid.state, PINCH_BONES[0])).max() < 0.002


def test_smoothed_clips_stay_solid() -> None:
    """A hand that opens and closes, with noise."""
    own, count = fitter(), 40
    closed = (1.0 - np.cos(np.arange(count) / 3.0)) / 2.0
    state = facing(fists(batch=count), 1.0)
    state = replace(state, angles=state.angles * closed[:, None, None])
    seen = seen_of(state, noise=1.0)
    assert 0.2 < (depths(state) > 0.004).mean() < 0.9
    frames = np.arange(count)
    times = Times.between(frames, np.zeros(count - 1, dtype=bool), 25.0)
    seen, solid = own.solve_solid(seen, own.solve_each(own.problem(seen), state), times)
    _, smooth = smooth_track(own, seen, solid.state, frames, np.zeros(count - 1, dtype=bool), 1.0, 25.0)
    assert depths(smooth).max() < 0.004
    rough = np.abs(np.diff(solid.state.angles, 2, axis=0)).mean()
    assert np.abs(np.diff(smooth.angles, 2, axis=0)).mean() < 0.8 * rough
