"""Acceleration of rotations and places over consecutive frames, with derivatives. NumPy.

Rotations turn by w_t = log(R_t' R_t+1) from one frame to the next; r_t = w_t - w_t-1. With
increments on the right, R <- R exp(d), and the inverse right and left Jacobians of SO(3),

    d w_t = Jr^-1(w_t) d_t+1 - Jl^-1(w_t) d_t

(Sola, Deray, Atchuthan, "A micro Lie theory for state estimation in robotics", 2018).
"""

from __future__ import annotations

import numpy as np

from handfit_core.geometry.rotations import rotmat_to_rotvec, skew

SMALL = 1e-4
"""radians below which the series is exact to double precision"""


def rotation_acceleration(rotations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the accelerations (T - 2, ..., 3) of rotations (T, ..., 3, 3), in radians per frame squared, and
    their derivatives (T - 2, 3, ..., 3, 3) by the increments of frames t - 1, t and t + 1."""
    turn = rotmat_to_rotvec(np.swapaxes(rotations[:-1], -1, -2) @ rotations[1:])
    right, left = inverse_right_jacobian(turn), inverse_right_jacobian(-turn)
    residual = turn[1:] - turn[:-1]
    jacobian = np.stack([left[:-1], -left[1:] - right[:-1], right[1:]], axis=1)
    return residual, jacobian


def place_acceleration(places: np.ndarray) -> np.ndarray:
    """Return the second differences (T - 2, 3) of places (T, 3), in metres per frame squared; their
    derivatives by the three frames are 1, -2 and 1."""
    return places[2:] - 2 * places[1:-1] + places[:-2]


def inverse_right_jacobian(rotvec: np.ndarray) -> np.ndarray:
    """Return the inverse right Jacobians (..., 3, 3) of axis-angle vectors w (..., 3) of t radians: I + [w]/2
    + (1/t^2 - (1 + cos t) / (2 t sin t)) [w]^2. The inverse left one of w is the right one of -w."""
    angle = np.linalg.norm(rotvec, axis=-1)[..., None, None]
    safe = np.maximum(angle, SMALL)
    # (1 + cos t) / sin t, written so that it stays finite at pi.
    factor = np.where(angle < SMALL, 1.0 / 12.0, 1.0 / safe**2 - 0.5 / (safe * np.tan(safe / 2.0)))
    across = skew(rotvec)
    return np.eye(3) + across / 2.0 + factor * (across @ across)
