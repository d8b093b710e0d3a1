"""Residuals of hands seen by two cameras of which nothing is certain, with derivatives by the cameras."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handfit_core.common.batch import Batch
from handfit_core.fit.observation import Observation
from handfit_core.fit.settings import TERMS, VIEWS
from handfit_core.fit.terms.rows import HAND, POINTS, Rows
from handfit_core.geometry.rotations import rotvec_to_rotmat, skew
from handfit_core.hand_model.chain import HAND_SIZE, Posed, State

CAMERA_SIZE = 9
"""Number of the cameras' variables: the second camera's turn (3) and place (3), the logarithms of both focal
lengths, and the offset in time"""
TURN, SHIFT, FOCAL, OFFSET = slice(0, 3), slice(3, 6), slice(6, 8), 8


@dataclass(frozen=True, eq=False)
class FilmedState(State):
    """B hands, and the two cameras that film them, which are equal in all rows: x_2 = rotation x_1 +
    translation."""

    rotation: np.ndarray
    """(B, 3, 3) rotations from the first camera's frame to the second one's"""
    translation: np.ndarray
    """(B, 3) metres: the translation from the first camera's frame to the second one's"""
    log_focal: np.ndarray
    """(B, 2) logarithms of the focal lengths in pixels, of the first and the second camera"""
    offset: np.ndarray
    """(B,) seconds from the first view's start to the second one's"""

    def moved(self, of_hand: np.ndarray, of_fingers: np.ndarray) -> FilmedState:
        """Return the state after increments (B, 26) of the hand's and the cameras' variables, and (B, 5, 9)
        of the fingers' angles."""
        hand, cameras = of_hand[:, :HAND_SIZE], of_hand[:, HAND_SIZE:]
        return FilmedState(
            **vars(State.moved(self, hand, of_fingers)),
            rotation=rotvec_to_rotmat(cameras[:, TURN]) @ self.rotation,
            translation=self.translation + cameras[:, SHIFT],
            log_focal=self.log_focal + cameras[:, FOCAL],
            offset=self.offset + cameras[:, OFFSET],
        )


@dataclass(frozen=True, eq=False)
class CameraPrior:
    """Four rows for each hand, that hold the logarithms of both focal lengths, their difference, and the
    offset in time near what is expected."""

    log_focal: np.ndarray
    """(2,) expected logarithms of both cameras' focal lengths in pixels"""
    focal_sigma: np.ndarray
    """(2,) expected errors of these logarithms"""
    offset: float
    """seconds: the expected offset in time of the second view"""
    offset_sigma: float

    def __call__(self, posed: Posed, seen: Observation) -> Rows:  # noqa: ARG002 (a term)
        """Return the rows of B posed hands, each of which has its share of the evidence."""
        state = posed.state
        assert isinstance(state, FilmedState)
        weight = 1.0 / np.sqrt(VIEWS.evidence)
        columns = np.zeros((len(state), 1, 4, HAND_SIZE + CAMERA_SIZE + 1))
        first, second, late = (HAND_SIZE + np.array([6, 7, 8])).tolist()
        columns[:, 0, [0, 1, 2], [first, second, late]] = 1.0
        columns[:, 0, 3, [first, second]] = 1.0, -1.0
        of_focal = state.log_focal - self.log_focal
        columns[:, 0, :2, -1], columns[:, 0, 2, -1] = of_focal, state.offset - self.offset
        columns[:, 0, 3, -1] = of_focal[:, 0] - of_focal[:, 1]
        sigma = np.array([*self.focal_sigma, self.offset_sigma, VIEWS.focal_ratio_sigma])
        columns *= (weight / sigma)[:, None]
        return Rows(HAND, columns)


@dataclass(frozen=True, eq=False)
class Filmed(Batch):
    """The landmarks of B hands that one camera sees."""

    pixels: np.ndarray
    """(B, 21, 2) pixels at which the camera sees the landmarks"""
    speed: np.ndarray | None
    """(B, 21, 2) pixels per second at which the landmarks move in the picture; None for the first view, whose
    moment is certain"""
    centre: np.ndarray
    """(2,) pixels: the camera's principal point"""
    sigma: np.ndarray
    """(B, 21, 2) pixels: expected errors of the landmarks; infinite where the camera saw nothing"""


def projected(posed: Posed, filmed: Filmed, camera: int) -> Rows:
    """Return two rows for each point seen by camera 0 or 1: the error of its projection u = f x / z + c
    against the pixels of `filmed` at the state's offset in time."""
    state = posed.state
    assert isinstance(state, FilmedState)
    points, turn = posed.points, np.eye(3)[None]
    if camera == 1:
        turn = state.rotation
        points = points @ turn.swapaxes(1, 2) + state.translation[:, None]
    inverse = 1.0 / np.maximum(points[..., 2:], TERMS.nearest)
    slope = points[..., :2] * inverse
    focal = np.exp(state.log_focal[:, camera])[:, None, None] / filmed.sigma
    by_point = np.zeros((*slope.shape, 3))
    by_point[..., [0, 1], [0, 1]] = focal * inverse
    by_point[..., 2] = -slope * focal * inverse
    columns = np.zeros((*slope.shape, 4 + CAMERA_SIZE + 1))
    columns[..., :3] = by_point @ turn[:, None]
    at = columns[..., 4:]
    at[..., 6 + camera] = slope * focal
    if camera == 1:
        at[..., TURN] = -by_point @ skew(points - state.translation[:, None])
        at[..., SHIFT] = by_point
        assert filmed.speed is not None
        # The picture that belongs to a moment is an earlier one where the offset is greater.
        at[..., OFFSET] = filmed.speed / filmed.sigma
    off = (filmed.centre - filmed.pixels) / filmed.sigma
    at[..., CAMERA_SIZE] = slope * focal + off
    return Rows(POINTS, columns, np.zeros(slope.shape[:2], dtype=bool))
