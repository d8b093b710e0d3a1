"""Re-fitting of a corrected hand: frame by frame while the artist drags, a range over time, or a grip on a
prop."""

from __future__ import annotations

import numpy as np

from handfit_core.common.errors import HandModelError
from handfit_core.common.skeleton import NUM_BETAS, NUM_JOINTS, NUM_KEYPOINTS, SIDES, Side
from handfit_core.detect.keypoints import Detections
from handfit_core.edit.hand import Prop, RefineHand
from handfit_core.edit.handles import landmark_points
from handfit_core.fit.solvers import ShouldStop, never
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model import OPEN_HAND, HandModel
from handfit_core.hand_model.files import kept_model
from handfit_core.hand_model.motion import HandMotion


def _solving():
    """Import and return the module that solves, which is slow to load: Blender does not need it to start."""
    from handfit_core.edit import solving

    return solving


def refit_each(hand: RefineHand, guess: HandMotion | None = None, *, draft: bool = False) -> HandMotion:
    """Fit every frame by itself, with the shape as it is.

    A frame with a pose is held to that pose, except for what its pins move: without pins it stays exactly as
    it is, and with pins the joints of fingers that none of them moves do. Where the pinned fingers reach
    their pins by themselves, the palm stays too, and only what they fall short of moves it (see `pins`). A
    frame without a pose is fitted to its detection and pins; without a detection too it stays empty. A hand
    that a person has added is posed anew by its pins, where these tell how it lies (see `free`).

    `draft`: a few steps from `guess`, an earlier result for the same hand, for the time until a mouse button
    is released. Otherwise the guess does not count: the result depends on where the pins are alone.

    Raises HandModelError.
    """
    return _solving().solve_each(hand, kept_model(hand.model, hand.side), guess, draft=draft)


def refit_range(hand: RefineHand, should_stop: ShouldStop = never) -> HandMotion:
    """Fit all frames anew from their detections and pins, over time, with the shape as it is.

    Motion is as smooth as `hand.smoothing` says, and short gaps are filled from both sides, as in a capture.
    Pinned frames without a detection are held loosely to their pose. The pose is otherwise no more than a
    start for the solver, but for locked joints. Frames that are neither detected nor pinned nor in a short
    gap come back empty.

    Raises HandModelError; Cancelled when `should_stop` said so.
    """
    return _solving().solve_range(hand, kept_model(hand.model, hand.side), should_stop)


def refit_grip(hand: RefineHand, prop: Prop, should_stop: ShouldStop = never) -> HandMotion:
    """Fit all frames with the fingers that are near a prop laid on its surface.

    Each frame stays near its pose. Fingers out of reach stay exactly as they are, and so does the wrist,
    unless the palm has to leave the prop. Frames without a pose stay empty.

    Raises HandModelError; OptionError, in an artist's words, where the prop cannot be held; Cancelled when
    `should_stop` said so.
    """
    from handfit_core.edit.gripping import solve_grip

    return solve_grip(hand, prop, kept_model(hand.model, hand.side), should_stop)


def warm_up(model: str = OPEN_HAND) -> None:
    """Load all that re-fitting needs, and use it once, so that the first drag is as fast as any.

    Raises HandModelError if there is no hand of either side in `model`.
    """
    _solving().load()
    errors: list[HandModelError] = []
    for side in SIDES:
        try:
            loaded = kept_model(model, side)
        except HandModelError as error:  # a MANO file of one side is enough
            errors.append(error)
            continue
        hand = _seen_hand(loaded, model, side)
        hand.pins[0, 8] = hand.detections.keypoints_2d[0, 8] + 10.0  # a fingertip is pulled
        refit_each(hand)
    if len(errors) == len(SIDES):
        raise errors[0]


def _seen_hand(loaded: HandModel, model: str, side: Side) -> RefineHand:
    """Return a relaxed hand before a camera, as a detector sees it, to be used once in `warm_up`."""
    camera = Intrinsics(600.0, 600.0, 320.0, 240.0)
    pose = np.array([[-np.pi / 2, 0.0, 0.0]]), loaded.hands_mean[None], np.array([[0.0, 0.0, 0.5]])
    points = landmark_points(loaded, np.zeros(NUM_BETAS), *pose)
    pixels = camera.project(points)
    pins = np.full((1, NUM_KEYPOINTS, 2), np.nan)
    depth = (points[..., 2:] - points[:, :1, 2:]) * camera.fx / points[..., 2:].mean()
    keypoints, world = np.concatenate([pixels, depth], axis=2), points - points.mean(axis=1)
    detections = Detections.hand(side, 0.9, keypoints[0], world[0])
    locked = np.zeros(NUM_JOINTS, dtype=bool)
    return RefineHand(side, np.zeros(NUM_BETAS), *pose, camera, detections, pins, locked, model)
