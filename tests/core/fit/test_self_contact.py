"""Parts of a hand that meet: derivatives, what is seen of them, and hands that are solid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from handfit_core.fit.fast import FastFitter, fitter_of, smooth_track
from handfit_core.fit.gaps import Times
from handfit_core.fit.observation import Observation, SelfContact
from handfit_core.fit.problem import Problem
from handfit_core.fit.self_contact import CROSSING, PINCH_BONES, find_self_contact
from handfit_core.fit.terms import Contact, Interpenetration, OrdinalDepth
from handfit_core.hand_model import load_model
from handfit_core.hand_model.chain import State
from handfit_core.hand_model.surface import PAIRS, Surface
from handfit_core.skeleton import SIDES, Side
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
    rng = np.random.default_rng(3)
    many, tips = (batch, len(CROSSING)), (batch, len(PINCH_BONES))
    front = rng.choice([-1.0, 1.0], many)
    return SelfContact(
        rng.random((*many, 2)),
        front,
        np.full(many, 0.01),
        rng.random(many),
        np.zeros(batch, dtype=bool),
        rng.random(tips),
    )


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("term", [Interpenetration, OrdinalDepth, Contact])
def test_gradients_are_those_of_the_cost(
    term: Callable[[Surface], Interpenetration | OrdinalDepth | Contact], side: Side
) -> None:
    own = fitter(side)
    state = fists(side, 2)
    touches = np.where(np.isin(np.arange(21), [8, 12, 20]), [[4.0] * 21, [0.0] * 21], np.nan)
    seen = replace(seen_of(state, side), self_contact=anything(2), touches=touches)
    problem = Problem(own.chain, seen, (*own._terms[:1], term(own.surface)))
    bare = Problem(own.chain, seen, own._terms[:1])
    for row in (slice(0, 1), slice(1, 2)):
        one, bare_one, at = problem.select(row), bare.select(row), state.select(row)
        whole, without = one.blocks(at), bare_one.blocks(at)
        assert whole.cost[0] > without.cost[0] + 1.0
        slope = of_increments(partial(cost_of_moved, one, bare_one, at), 52) / 2.0
        of_hand = whole.hand[0, :, -1] - without.hand[0, :, -1]
        of_fingers = (whole.finger[..., -1] - without.finger[..., -1]).reshape(45)
        close(np.concatenate([of_hand, of_fingers]), slope, rtol=1e-4, atol=1e-3)


def cost_of_moved(problem: Problem, bare: Problem, state: State, shifts: np.ndarray) -> np.ndarray:
    """What a problem of one hand costs more than the bare one does, moved by increments (N, 52)."""
    rows = np.zeros(len(shifts), dtype=int)
    moved = state.select(rows).moved(shifts[:, :7], shifts[:, 7:].reshape(-1, 5, 9))
    return problem.select(rows).blocks(moved).cost - bare.select(rows).blocks(moved).cost


def test_batch_equals_loop() -> None:
    own = fitter()
    state = fists(batch=4)
    problem = own.problem(replace(seen_of(state), self_contact=anything(4)), solid=True)
    whole = problem.blocks(state)
    assert whole.between is not None
    close(whole.between, whole.between.swapaxes(1, 2))
    for i in range(4):
        one = problem.select(np.array([i])).blocks(state.select(np.array([i])))
        for name, values in one._rows():
            close(getattr(whole, name)[i], values[0], rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("side", SIDES)
def test_fist_becomes_solid(side: Side) -> None:
    own, state = fitter(side), fists(side)
    assert depths(state, side).min() > 0.004
    seen = seen_of(state, side)
    plain = own.solve_each(own.problem(seen), state)
    _, solid = own.solve_solid(seen, plain)
    assert depths(plain.state, side).min() > 0.006
    assert depths(solid.state, side).max() < 0.004
    assert solid.converged.all()


def test_open_hands_are_left_as_they_are() -> None:
    own, state = fitter(), make_state(3, fitter().chain, spread=0.05)
    state = replace(state, betas=np.zeros((3, 10)))
    seen = seen_of(state)
    plain = own.solve_each(own.problem(seen), state)
    _, solid = own.solve_solid(seen, plain)
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
    assert over.any()
    surface, posed = own.surface, own.chain.pose(state)
    middle = surface.capsules(posed).ends[0].mean(axis=1)[:, 2]
    first, second = CROSSING[over].T
    nearer = np.sign(middle[second] - middle[first])
    sure = np.abs(middle[second] - middle[first]) > 0.008
    assert sure.any()
    assert np.array_equal(found.front[0, over][sure], nearer[sure])
    assert (found.separation[0, over] < 0.03).all()


def at(frames: np.ndarray, cuts: tuple[int, ...] = ()) -> Times:
    """Detections in those frames, with cuts after some rows."""
    return Times.between(frames, np.isin(np.arange(len(frames) - 1), cuts), 25.0)


def test_neighbours_vote_on_order() -> None:
    own, state = fitter(), facing(fists(batch=1), 1.0)
    seen = seen_of(repeated(state, 9))
    spoilt = replace(seen, depth=seen.depth.copy())
    spoilt.depth[4] *= -1.0
    alone = find_self_contact(own.surface, spoilt, repeated(state, 9))
    told = find_self_contact(own.surface, spoilt, repeated(state, 9), at(np.arange(9)))
    assert not np.array_equal(alone.front[4], alone.front[3])
    assert np.array_equal(told.front[4], told.front[3])
    # Frames that are missing are no neighbours.
    far = find_self_contact(own.surface, spoilt, repeated(state, 9), at(100 * np.arange(9)))
    assert np.array_equal(far.front, alone.front)
    # So are those of another shot.
    cut = find_self_contact(own.surface, spoilt, repeated(state, 9), at(np.arange(9), (3, 4)))
    assert np.array_equal(cut.front[4], alone.front[4])


def test_the_thumb_is_kept_on_its_side() -> None:
    """From a start on the other side, through the fingers."""
    own, state = fitter(), facing(fists(batch=1), 1.0)
    lifted = THUMB.copy()
    lifted[2] -= 0.5
    true = replace(state, angles=np.stack([lifted, *state.angles[0, 1:]])[None])
    seen = seen_of(true, noise=1.0)
    seen, solid = own.solve_solid(seen, own.solve_each(own.problem(seen), state))
    assert seen.self_contact is not None
    ends = own.surface.capsules(own.chain.pose(solid.state)).ends[0]
    for pair in np.flatnonzero(seen.self_contact.front[0]):
        share = seen.self_contact.along[0, pair]
        places = [
            ends[b, 0] + s * (ends[b, 1] - ends[b, 0]) for b, s in zip(CROSSING[pair], share, strict=True)
        ]
        behind = (places[0] - places[1]) @ seen.ray[0] * seen.self_contact.front[0, pair]
        assert behind < 0.0
    assert depths(solid.state).max() < 0.003


def pinches(batch: int) -> State:
    return posed_as(OPPOSED, PINCH, *np.zeros((3, 9)), batch=batch)


def test_pinches_are_closed() -> None:
    own, state = fitter(), facing(pinches(6), 1.0)
    separation = gaps(state, PINCH_BONES[0])
    assert 0.0 < separation.max() < 0.02
    seen = seen_of(state, noise=2.0)
    plain = own.solve_each(own.problem(seen), state)
    seen, solid = own.solve_solid(seen, plain)
    assert seen.self_contact is not None
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
    seen, solid = own.solve_solid(seen, own.solve_each(own.problem(seen), state), at(frames))
    _, smooth = smooth_track(own, seen, solid.state, frames, np.zeros(count - 1, dtype=bool), 1.0, 25.0)
    assert depths(smooth).max() < 0.004
    rough = np.abs(np.diff(solid.state.angles, 2, axis=0)).mean()
    assert np.abs(np.diff(smooth.angles, 2, axis=0)).mean() < 0.8 * rough


def test_random_hands_become_solid() -> None:
    own, state = fitter(), make_state(40, fitter().chain, spread=0.7)
    least, most = own.angle_bounds
    state = replace(state, angles=np.clip(state.angles, least, most), betas=random(40, 10))
    seen = seen_of(state)
    plain = own.solve_each(own.problem(seen), state)
    _, solid = own.solve_solid(seen, plain)
    assert (depths(plain.state) > 0.004).mean() > 0.1
    assert (depths(solid.state) > 0.004).mean() < 0.05
