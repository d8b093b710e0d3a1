"""What takes are written as in MANO's parameters: takes, animations of SMPL-X, and keywords of smplx."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

from handfit_core.common.skeleton import SIDES, Side
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model.motion import POSE_ARRAYS
from handfit_core.interchange.every_frame import EveryFrame
from handfit_core.interchange.skeletons import UP_AXES
from handfit_core.interchange.writers import Writer
from handfit_core.take import Take

_COLUMNS: Final[dict[Side, tuple[slice, slice]]] = {
    "left": (slice(60, 63), slice(75, 120)),
    "right": (slice(63, 66), slice(120, 165)),
}
"""Of a wrist and of its fingers among a body's poses"""


def _write_smplx(take: Take, path: Path) -> None:
    """The wrists are those of a body that stands still with its arms out, y-up; their place is not kept, as
    it depends on the body."""
    frames = EveryFrame.of(take)
    poses = np.zeros((len(frames.numbers), 165))
    present = np.zeros((len(poses), 2), dtype=bool)
    for side, hand in frames.hands.items():
        wrist, fingers = _COLUMNS[side]
        poses[:, wrist] = rotmat_to_rotvec(UP_AXES["y"] @ rotvec_to_rotmat(hand.global_orient))
        poses[:, fingers] = hand.hand_pose
        present[:, SIDES.index(side)] = frames.present[side]
    _written(
        path,
        trans=np.zeros((len(poses), 3)),
        gender=np.array("neutral"),
        betas=np.zeros(16),
        poses=poses,
        mocap_frame_rate=np.array(frames.fps),
        surface_model_type=np.array("smplx"),
        hands_present=present,
    )


def _write_keywords(take: Take, path: Path) -> None:
    frames, camera = EveryFrame.of(take), take.intrinsics
    arrays: dict[str, Any] = {
        "frame_numbers": frames.numbers,
        "fps": np.array(frames.fps),
        "picture_size": np.array([take.width, take.height]),
        "intrinsics": np.array([camera.fx, camera.fy, camera.cx, camera.cy]),
        "flat_hand_mean": np.array(True),
    }
    for side, hand in frames.hands.items():
        for name, rows in zip(POSE_ARRAYS, hand.pose, strict=True):
            arrays[f"{side}_{name}"] = rows
        arrays[f"{side}_betas"] = hand.betas[None]
        arrays[f"{side}_present"] = frames.present[side]
    _written(path, **arrays)


def _written(path: Path, **arrays: Any) -> None:
    with path.open("wb") as stream:  # to a path, np.savez would add an ending
        np.savez_compressed(stream, **arrays)


def _write_take(take: Take, path: Path) -> None:
    take.save(path)


TAKE: Final = Writer("Take", (".take.npz", ".npz"), _write_take)
SMPLX: Final = Writer("SMPL-X", (".smplx.npz",), _write_smplx)
SMPLX_KEYWORDS: Final = Writer("smplx's parameters", (".mano.npz",), _write_keywords)
