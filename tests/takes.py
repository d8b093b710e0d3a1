"""Takes of the open hand, made of poses that are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model import load_model
from handfit_core.hand_model.arm import ArmMotion
from handfit_core.media.source import Source
from handfit_core.skeleton import Side
from handfit_core.take import HandTrack, Take


def track_of(
    side: Side, orient: np.ndarray, pose: np.ndarray, transl: np.ndarray, camera: Intrinsics, **fields: Any
) -> HandTrack:
    """A hand of mean shape that was detected just where it is, in every one of T frames."""
    count, model = len(orient), load_model("open-hand", side)
    points = model.keypoints(None, orient, pose, transl)
    values: dict[str, Any] = {
        "betas": np.zeros(10),
        "global_orient": orient,
        "hand_pose": pose,
        "transl": transl,
        "joints_3d": points,
        "keypoints_2d": camera.project(points),
        "reprojection_error": np.full(count, 0.5),
        "detected": np.ones(count, dtype=bool),
        "score": np.full(count, 0.9),
    }
    return HandTrack(side=side, **values | fields)


def take_of(hands: Sequence[HandTrack], camera: Intrinsics, width: int, height: int, **fields: Any) -> Take:
    """A take of those hands, from a picture that is not there."""
    values: dict[str, Any] = {
        "source": Source("photo", ("/nowhere/picture.png",)),
        "fps": 25.0,
        "frame_numbers": np.arange(1, len(hands[0].detected) + 1),
        "solver": "fast",
        "model": "open-hand",
        "model_digests": {hand.side: load_model("open-hand", hand.side).digest for hand in hands},
    }
    return Take(hands=tuple(hands), intrinsics=camera, width=width, height=height, **values | fields)


def correctable(take: Take) -> Take:
    """The same take with what fitting again needs of its detections."""
    hands = []
    for hand in take.hands:
        points = hand.joints_3d - hand.joints_3d[:, :1]
        hands.append(replace(hand, keypoints_depth=0.0 * points[..., 2], world_landmarks=points))
    return replace(take, hands=tuple(hands))


def with_arms(take: Take, why_none: str = "") -> Take:
    """The same take with an arm at each hand, bent by 90 degrees: the forearm goes on from the palm, and the
    upper arm hangs from the shoulder in the picture; or without any, for that reason."""
    if why_none:
        return replace(take, hands=tuple(replace(hand, no_arm=why_none) for hand in take.hands))
    hands, lengths = [], np.array([0.28, 0.25])
    for hand in take.hands:
        wrist = hand.joints_3d[:, 0]
        along = wrist - hand.joints_3d[:, 9]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        up = np.array([0.0, -1.0, 0.0]) + along * along[:, 1:2]
        elbow = wrist + lengths[1] * along
        arm = ArmMotion(
            shoulder=elbow + lengths[0] * up / np.linalg.norm(up, axis=1, keepdims=True),
            elbow=elbow,
            wrist=wrist,
            lengths=lengths,
            present=hand.present,
            expected_error=np.where(hand.present[:, None], [0.2, 0.35], np.nan),
        )
        hands.append(replace(hand, arm=arm))
    return replace(take, hands=tuple(hands))
