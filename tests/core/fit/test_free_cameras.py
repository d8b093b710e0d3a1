"""Derivatives of terms by two cameras' places, lenses and offset in time."""

from __future__ import annotations

import numpy as np

from handfit_core.fit.fast import fitter_of
from handfit_core.fit.terms.free_cameras import CAMERA_SIZE, CameraPrior, Filmed, FilmedState, projected
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.hand_model.chain import HAND_SIZE
from tests.core.fit.differences import close, of_increments
from tests.core.fit.hands import make_state, observe

TURN = rotvec_to_rotmat(np.array([0.1, 0.9, -0.2]))
SHIFT = np.array([-0.45, 0.03, 0.25])
OFFSET = 0.11


def test_derivatives_by_cameras():
    chain = fitter_of(load_model(None, "right")).chain
    count = HAND_SIZE + CAMERA_SIZE
    state = make_state(1, chain).select(np.zeros(2 * count, dtype=int))
    many = len(state)
    filmed = FilmedState(
        **vars(state),
        rotation=np.tile(TURN, (many, 1, 1)),
        translation=np.tile(SHIFT, (many, 1)),
        log_focal=np.full((many, 2), np.log(600.0)),
        offset=np.full(many, OFFSET),
    )
    speed = np.tile(np.random.default_rng(0).normal(size=(1, 21, 2)) * 30.0, (many, 1, 1))
    pixels = observe(chain.points(state)).pixels
    prior = CameraPrior(np.log([500.0, 700.0]), np.array([0.3, 0.2]), 0.0, 0.03)
    seen = observe(chain.points(state))

    def rows(state: FilmedState, camera: int):
        there = pixels - camera * speed * (state.offset - OFFSET)[:, None, None]
        view = Filmed(there, speed, np.array([320.0, 240.0]), np.full(there.shape, 4.0))
        return projected(chain.pose(state), view, camera)

    for camera in (0, 1):
        found = of_increments(
            lambda shift, c=camera: rows(filmed.moved(shift, np.zeros((many, 5, 9))), c).residual, count
        )
        whole = chain.jacobian(chain.pose(filmed), rows(filmed, camera).columns, shape=True)[0]
        close(whole[..., 9:-1], found, rtol=1e-5, atol=1e-4)
    found = of_increments(
        lambda shift: prior(chain.pose(filmed.moved(shift, np.zeros((many, 5, 9)))), seen).residual, count
    )
    close(prior(chain.pose(filmed), seen).jacobian[0], found, rtol=1e-5, atol=1e-4)
