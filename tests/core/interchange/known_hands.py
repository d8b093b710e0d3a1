"""Hands whose parameters are known, as other programs would store them; and what a reader makes of files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from handfit_core.capturing.options import CaptureOptions
from handfit_core.common.skeleton import SIDES, Side
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.hand_model.anatomy import anatomical_axes, rotmats_from_angles
from handfit_core.hand_model.motion import HandMotion
from handfit_core.interchange.opening import read_recording
from handfit_core.interchange.recording import Recording
from tests.imitation_mano import imitation_arrays, write_mano_pickle

EXACT = 1e-5
"""radians and metres"""
FRAMES = 7
TURN = np.array([1.0, -1.0, -1.0])
"""What a mirror at x = 0 does to an axis-angle"""


def matrices(rotvec: np.ndarray) -> np.ndarray:
    """(T, 3 J) axis-angle -> (T, J, 3, 3)"""
    return rotvec_to_rotmat(rotvec.reshape(len(rotvec), -1, 3))


def joints_turned(hand: HandMotion) -> np.ndarray:
    """(T, 16, 3, 3)"""
    return matrices(np.concatenate([hand.global_orient, hand.hand_pose], axis=1))


def known_hand(side: Side, seed: int = 0, *, bend: tuple[float, float] = (10.0, 60.0)) -> HandMotion:
    """Fingers that bend by some degrees of that range, spread and twist a little, and move from frame to
    frame; a hand half a metre from the camera."""
    rng = np.random.default_rng(100 * seed + SIDES.index(side))
    angles = np.radians(rng.uniform(-4.0, 4.0, (FRAMES, 15, 3)))
    angles[..., 2] = np.radians(rng.uniform(*bend, (FRAMES, 15)))
    pose = rotmat_to_rotvec(rotmats_from_angles(angles, anatomical_axes(load_model(None, side))))
    place = np.array([0.1 if side == "left" else -0.1, 0.0, 0.6])
    return HandMotion(
        side,
        rng.normal(size=10),
        rng.uniform(-1.0, 1.0, (FRAMES, 3)),
        pose.reshape(FRAMES, 45),
        place + rng.uniform(-0.05, 0.05, (FRAMES, 3)),
    )


HANDS = {side: known_hand(side) for side in SIDES}


def own_mano(folder: Path) -> Path:
    """A folder with both sides of a model in MANO's format."""
    folder.mkdir(exist_ok=True)
    for side in SIDES:
        write_mano_pickle(folder / f"MANO_{side.upper()}.pkl", imitation_arrays(side))
    return folder


def mean_of(side: Side) -> np.ndarray:
    """(45,) of `own_mano`'s models."""
    return imitation_arrays(side)["hands_mean"]


def coefficients_of(pose: np.ndarray, side: Side) -> np.ndarray:
    """(T, 45) of poses (T, 45), without mean, in `own_mano`'s directions: its basis is orthonormal."""
    return pose @ imitation_arrays(side)["hands_components"].T


def wrist_of(side: Side, model: Path | None = None, betas: np.ndarray | None = None) -> np.ndarray:
    """(3,) metres: the wrist of a model at rest."""
    return load_model(model, side).shaped(betas).joints[0]


def read(path: Path, **options: Any) -> Recording:
    """What a file holds, with these of a capture's options."""
    return read_recording(path, CaptureOptions(**options).read_options())


def hand_of(recording: Recording, side: Side) -> HandMotion:
    (hand,) = [hand for hand in recording.posed if hand.side == side]
    return hand


def assert_same_turns(ours: np.ndarray, theirs: np.ndarray, exact: float = EXACT) -> None:
    """Check that axis-angles (T, 3 J) turn alike, to `exact` radians."""
    turned = np.swapaxes(matrices(ours), -1, -2) @ matrices(theirs)
    off = np.linalg.norm(rotmat_to_rotvec(turned), axis=-1)
    assert off.max() < exact, f"off by {np.degrees(off.max()):.3g} degrees"


def assert_same_hand(found: HandMotion, known: HandMotion, *, placed: bool = True) -> None:
    """Check that a hand is the known one in the frames that have it."""
    there = found.present
    assert_same_turns(found.global_orient[there], known.global_orient[there])
    assert_same_turns(found.hand_pose[there], known.hand_pose[there])
    if placed:
        np.testing.assert_allclose(found.transl[there], known.transl[there], atol=EXACT)


def says(recording: Recording, words: str) -> bool:
    """True if one of the phrases has these words."""
    return any(words in phrase for phrase in recording.assumed)
