"""A picture or a clip with everything in it decided, before anything is drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model import OPEN_HAND
from handfit_core.media.source import Source
from handfit_core.skeleton import Side
from handfit_core.take import HandTrack, Take

from .arm import Arm
from .kinematics import model_of
from .meshes import Mesh

FPS = 25.0


@dataclass(frozen=True, eq=False)
class ShotHand:
    """One hand over a shot's F key frames, in MANO's parameters, camera frame."""

    side: Side
    betas: np.ndarray
    """(10,)"""
    global_orient: np.ndarray
    """(F, 3) radians"""
    hand_pose: np.ndarray
    """(F, 45) radians"""
    transl: np.ndarray
    """(F, 3) metres"""
    arm: Arm

    def keypoints(self) -> np.ndarray:
        """(F, 21, 3) metres, camera frame."""
        return model_of(self.side).keypoints(self.betas, self.global_orient, self.hand_pose, self.transl)


@dataclass(frozen=True, eq=False)
class Shot:
    """A still (one key frame) or a clip (one key frame before its first picture and one after its last)."""

    files: tuple[str, ...]
    """One per picture, relative to the benchmark's folder"""
    clip: str | None
    size: int
    """pixels a side"""
    focal_mm: float
    camera: Intrinsics
    hands: tuple[ShotHand, ...]
    props: tuple[Mesh, ...]
    """Camera frame (of the first key frame where the surroundings move)"""
    surroundings: np.ndarray
    """(F, 4, 4) where background and props go, from the camera frame into itself"""
    tags: tuple[Mapping[str, str], ...]
    """One per picture"""
    look_seed: tuple[int, ...]
    """Seeds everything that the labels do not depend on: colours, light, background, noise"""

    @property
    def lead(self) -> int:
        """Key frames before the first picture."""
        return 0 if self.clip is None else 1

    def take(self) -> Take:
        """The shot as a take, whose frame numbers are the key frames' rows."""
        tracks = []
        for hand in self.hands:
            points = hand.keypoints()
            tracks.append(
                HandTrack(
                    side=hand.side,
                    betas=hand.betas,
                    global_orient=hand.global_orient,
                    hand_pose=hand.hand_pose,
                    transl=hand.transl,
                    joints_3d=points,
                    keypoints_2d=self.camera.project(points),
                    reprojection_error=np.zeros(len(points)),
                    detected=np.ones(len(points), dtype=bool),
                    score=np.ones(len(points)),
                )
            )
        count = len(self.surroundings)
        return Take(
            source=Source("sequence", tuple(f"{i}" for i in range(count))),
            fps=FPS,
            frame_numbers=np.arange(count),
            width=self.size,
            height=self.size,
            intrinsics=self.camera,
            solver="rendered",
            model=OPEN_HAND,
            model_digests={hand.side: model_of(hand.side).digest for hand in self.hands},
            hands=tuple(tracks),
        )
