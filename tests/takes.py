"""Takes of the open hand, made of poses that are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from handfit_core.common.skeleton import SIDES, Side
from handfit_core.detect.keypoints import Detections
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.hand_model.arm import ArmMotion
from handfit_core.media.source import Source
from handfit_core.take import HandTrack, Take
from handfit_core.take.found import FoundRows
from handfit_core.take.views import Cameras, SeenHand, Verdict, View

Seen = TypeVar("Seen", HandTrack, SeenHand)


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
        "reprojection_error": np.full(count, 0.5),
        "detections": found(side, camera.project(points), np.ones(count, dtype=bool)),
    }
    return HandTrack(side=side, **values | fields)


def found(side: Side, keypoints: np.ndarray, detected: np.ndarray) -> Detections:
    """A hand whose keypoints (T, 21, 2) alone were detected, in those frames (T,), with a score of 0.9."""
    return FoundRows(keypoints, detected, np.full(len(detected), 0.9)).detections(side)


def seen_as(hand: Seen, **columns: Any) -> Seen:
    """The hand with other arrays of `FoundRows`."""
    side = hand.side if isinstance(hand, HandTrack) else SIDES[hand.detections.side[0]]
    return replace(hand, detections=replace(hand.rows, **columns).detections(side))


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
        hands.append(seen_as(hand, keypoints_depth=0.0 * points[..., 2], world_landmarks=points))
    return replace(take, hands=tuple(hands))


def of_two_views(sources: tuple[Source, Source]) -> Take:
    """A take of a hand that turns and goes aside, of two views: clips of 40 frames with 30 and 25 per second,
    whose second one begins 0.143 s later, 640 x 480 pixels, from 63 degrees aside."""
    model, count, offset = load_model("open-hand", "right"), 40, 0.143
    lens, other = Intrinsics(600.0, 600.0, 320.0, 240.0), Intrinsics(500.0, 500.0, 300.0, 250.0)
    turn = rotvec_to_rotmat(np.array([0.1, 1.1, 0.0]))
    move = np.array([0.0, 0.0, 0.55]) - turn @ [0.0, 0.0, 0.5]

    def motion(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        orient = np.stack([-1.4 + 0.4 * np.sin(2.0 * t), 0.3 * t, 0.2 * np.cos(t)], axis=1)
        place = np.stack([0.06 * np.sin(3.0 * t) - 0.1, 0.02 * t, 0.5 + 0.02 * np.cos(t)], axis=1)
        return orient, (0.3 + 0.4 * np.sin(t) ** 2)[:, None] * model.hands_mean, place

    numbers = np.arange(1, count + 1)
    of_first = {"source": sources[0], "fps": 30.0, "frame_numbers": numbers}
    hand = track_of("right", *motion((numbers - 1) / 30.0), lens)
    take = correctable(take_of([hand], lens, 640, 480, **of_first))
    cameras = Cameras(
        np.stack([np.eye(3), turn]),
        np.stack([np.zeros(3), move]),
        np.array([list(vars(each).values()) for each in (lens, other)]),
        np.array([0.0, offset]),
        (View(sources[1], 25.0, 640, 480, numbers),),
    )
    seconds = cameras.seconds(1)
    there = cameras.camera(1).seen_from(model.keypoints(None, *motion(seconds)))
    seen = SeenHand(
        seconds < (count - 1) / 30.0, found("right", other.project(there), np.ones(count, dtype=bool))
    )
    depth = (there - there[:, :1])[..., 2] * other.fx / 0.55
    world = there - there.mean(axis=1, keepdims=True)
    seen = seen_as(seen, keypoints_depth=depth, world_landmarks=world)
    verdict = Verdict("good", "Offset 4.3 frames: good.")
    return replace(take, hands=(replace(take.hands[0], seen_by=(seen,)),), cameras=cameras, verdict=verdict)


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
