"""A picture or a clip with everything in it decided, before anything is drawn; its labels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from handfit_core.common.skeleton import Side
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model import OPEN_HAND
from handfit_core.media.source import Source
from handfit_core.take import HandTrack, Take
from handfit_core.take.found import FoundRows

from .arm import Arm
from .kinematics import model_of
from .meshes import Mesh

FPS = 25.0
NAME: Final = "rendered benchmark"
NOTES: Final = (
    "Rendered with Blender Cycles from the bundled open hand: its joints and fingertips are the labels, "
    "exact, and other models have theirs elsewhere in the hand.",
    "Keypoints that are hidden, or lie outside of a picture (its tag framing is cut), are labelled all the "
    "same.",
)


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
    arm: Arm | None = None

    @property
    def arm_parts(self) -> dict[str, Mesh]:
        """Forearm and sleeve, those that there are, in the model's frame."""
        parts = {"forearm": self.arm.skin, "sleeve": self.arm.sleeve} if self.arm else {}
        return {name: mesh for name, mesh in parts.items() if mesh is not None}

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
    readout: float = 0.0
    """Share of a frame's time between the first and the last line of a picture; 0: all lines at once"""

    @property
    def lead(self) -> int:
        """Key frames before the first picture."""
        return 0 if self.clip is None else 1

    def take(self) -> Take:
        """The shot as a take, whose frame numbers are the key frames' rows."""
        count = len(self.surroundings)
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
                    reprojection_error=np.zeros(count),
                    detections=FoundRows(
                        self.camera.project(points), np.ones(count, dtype=bool), np.ones(count)
                    ).detections(hand.side),
                )
            )
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


def entries(shot: Shot) -> list[dict[str, Any]]:
    """One entry of the plain folder form's `index.json` per picture, in order."""
    points = [hand.keypoints() for hand in shot.hands]
    pixels = [shot.camera.project(p) for p in points]
    found = []
    for number, (file, tags) in enumerate(zip(shot.files, shot.tags, strict=True)):
        t = number + shot.lead
        entry: dict[str, Any] = {
            "file": file,
            "hands": [
                {
                    "hand": hand.side,
                    "joints_3d_mm": rounded(p[t] * 1000.0, 5),
                    "keypoints_2d_px": rounded(uv[t], 4),
                    "mano": {
                        **{"model": OPEN_HAND, "digest": model_of(hand.side).digest},
                        "betas": rounded(hand.betas, 9),
                        **{key: rounded(getattr(hand, key)[t], 9) for key in _PER_FRAME},
                    },
                }
                for hand, p, uv in zip(shot.hands, points, pixels, strict=True)
            ],
            "K": matrix_of(shot.camera),
            "time": number / FPS,
            "tags": dict(tags),
        }
        found.append(entry | ({} if shot.clip is None else {"clip": shot.clip}))
    return found


_PER_FRAME = ("global_orient", "hand_pose", "transl")


def matrix_of(camera: Intrinsics) -> list[list[float]]:
    """(3, 3) the camera's matrix, for JSON."""
    return [[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]]


def rounded(values: np.ndarray, decimals: int) -> list:
    """Digits enough for the labels to be exact to a nanometre, and files that people can read."""
    return np.round(values, decimals).tolist()
