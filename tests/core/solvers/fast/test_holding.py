"""Which variables belong to a held joint, and where its value comes from."""

from __future__ import annotations

import numpy as np

from handfit_core.skeleton import FINGER_JOINTS, FINGERS
from handfit_core.solvers.fast.holding import Held
from tests.core.solvers.fast.hands import chain_of, energy_of, make_state, observe

CHAIN = chain_of()


def held(*joints: int) -> Held:
    """In the first of two hands."""
    which = np.zeros((2, 16), dtype=bool)
    which[0, list(joints)] = True
    return Held(which, make_state(2, CHAIN, seed=1))


def test_every_joint_has_its_three_variables() -> None:
    for f, finger in enumerate(FINGERS):
        for level, joint in enumerate(FINGER_JOINTS[finger]):
            first = 3 + 9 * f + 3 * level
            assert np.flatnonzero(held(joint).variables()[0]).tolist() == [first, first + 1, first + 2]
    assert np.flatnonzero(held(0).variables()[0]).tolist() == [0, 1, 2, 48, 49, 50]
    assert not held(0, 5, 7).variables()[1].any()


def test_a_step_moves_what_is_free() -> None:
    state = make_state(2, CHAIN)
    seen = observe(CHAIN.pose(make_state(2, CHAIN, seed=3)).points)
    blocks = energy_of(CHAIN).of(CHAIN.pose(state), seen, shape=False)
    of_hand, of_fingers = held(0, 1, 14).of(blocks).step(np.full((2,), 1e-3))
    assert (of_hand[0, :6] == 0).all()
    assert of_hand[0, 6] != 0
    still = (of_fingers[0].reshape(5, 3, 3) == 0).all(axis=-1)
    assert np.argwhere(still).tolist() == [[0, 1], [1, 0]]  # the thumb's second, the index finger's first
    assert (of_hand[1] != 0).all()
    assert (of_fingers[1] != 0).all()


def test_values_are_put_back() -> None:
    state, other = make_state(2, CHAIN), held(0, 1, 14)
    found = other.put(state)
    assert np.array_equal(found.root[0], other.state.root[0])
    assert np.array_equal(found.wrist[0], other.state.wrist[0])
    assert np.array_equal(found.local[0, 1, 0], other.state.local[0, 1, 0])
    assert np.array_equal(found.local[0, 0, 1], other.state.local[0, 0, 1])
    assert np.array_equal(found.local[0, 2:], state.local[0, 2:])
    for name in ("root", "local", "wrist", "betas", "offsets"):
        assert np.array_equal(getattr(found, name)[1], getattr(state, name)[1])
    part = other.select(np.array([1]))
    assert np.array_equal(part.put(state.select(np.array([1]))).local, state.local[1:])
