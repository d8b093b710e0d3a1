"""One hand as one view has it: its detections, and the fit to them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from handfit_core.common.skeleton import Side
from handfit_core.detect.correction.corrected import landmarked
from handfit_core.fit.fast import FastFitter
from handfit_core.fit.observation import Observation, observation_of
from handfit_core.fit.seen_over_time import SeenOverTime
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.chain import State
from handfit_core.take import HandTrack


@dataclass(frozen=True, eq=False)
class ViewedHand(SeenOverTime):
    """A hand in the N frames of a view in which it was detected, whose `times` begin at the view's start."""

    rows: np.ndarray
    """(N,) int, the view's frames, increasing"""
    world: np.ndarray
    """(N, 21, 3) metres about the hand's centre, as detected"""
    state: State
    """N hands as the view alone has them"""
    points: np.ndarray
    """(N, 21, 3) metres, this camera's frame: the landmarks of `state`"""
    side: Side
    intrinsics: Intrinsics
    """The camera that `state` was fitted with"""

    @classmethod
    def of(
        cls,
        fitter: FastFitter,
        hand: HandTrack,
        times: np.ndarray,
        fps: float,
        intrinsics: Intrinsics,
    ) -> ViewedHand:
        """A hand of a take whose frames lie at `times` (T,) seconds."""
        rows = np.flatnonzero(np.asarray(hand.detected) & np.isfinite(hand.transl).all(axis=1))
        found = hand.detections_at(rows)
        betas = np.broadcast_to(hand.betas, (len(rows), len(hand.betas)))
        state = fitter.chain.state(
            betas, hand.global_orient[rows], hand.hand_pose[rows], hand.transl[rows], np.ones(len(rows))
        )
        points = fitter.chain.points(state)
        distance = np.linalg.norm(points.mean(axis=1), axis=1)
        state = State(state.root, state.angles, state.wrist, state.betas, distance)
        seen = landmarked(found, hand.side)
        return cls(times[rows], seen, fps, rows, found.world, state, points, hand.side, intrinsics)

    def placed(self, focal: float) -> State:
        """The N hands at the distance at which a camera of that focal length in pixels sees them so."""
        centre = self.points.mean(axis=1)
        shift = centre * [0.0, 0.0, focal / self.intrinsics.fx - 1.0]
        distance = np.linalg.norm(centre + shift, axis=1)
        return replace(self.state, wrist=self.state.wrist + shift, depth_zero=distance)

    def observed(self, camera: Intrinsics) -> Observation:
        """The N hands as seen through that camera."""
        return observation_of(self.seen, camera)

    @cached_property
    def centre(self) -> np.ndarray:
        """(2,) pixels"""
        return np.array([self.intrinsics.cx, self.intrinsics.cy])
