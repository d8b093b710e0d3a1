"""Hands that were projected into two cameras, as takes and as what a view has of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from handfit_core.capturing.fitting import hand_track
from handfit_core.capturing.views.cameras import HandPair
from handfit_core.capturing.views.hands import ViewedHand
from handfit_core.capturing.views.readings import ViewTake
from handfit_core.common.skeleton import Side
from handfit_core.detect.keypoints import Landmarked
from handfit_core.fit.fast import fitter_of
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.hand_model.chain import State
from handfit_core.hand_model.motion import HandMotion
from handfit_core.interchange.taking import seen_of
from handfit_core.media.source import Source
from handfit_core.take import Take
from tests.core.fit.hands import RELAXED, observe

CAMERA = Intrinsics(600.0, 600.0, 320.0, 240.0)
TURN = rotvec_to_rotmat(np.array([0.1, 0.9, -0.2]))
SHIFT = np.array([-0.45, 0.03, 0.25])
OFFSET = 0.11
"""seconds from the first view's start to the second one's, 3.3 frames"""
FRAMES, FPS = 70, 30.0


def moving(times: np.ndarray, side: Side = "right", seed: int = 0) -> State:
    """A hand that opens and closes and turns, half a metre before the first camera."""
    rng = np.random.default_rng(seed)
    rate, phase = rng.uniform(2.0, 5.0, size=5), rng.uniform(0.0, 6.0, size=5)
    angles = np.tile(RELAXED, (len(times), 1, 1))
    angles[..., 2::3] += 0.35 * np.sin(times[:, None] * rate + phase)[..., None]
    if side == "left":
        angles *= np.tile([-1.0, -1.0, 1.0], 3)
    times = times * (1.0 + 0.4 * seed) + seed
    turns = np.stack([1.2 + 0.3 * np.sin(times), 0.6 * np.sin(2.0 * times), 0.4 * np.cos(times)], axis=1)
    wrist = np.stack([0.05 * np.sin(times), 0.04 * np.cos(2.0 * times), 0.5 + 0.03 * np.sin(times)], axis=1)
    return State(rotvec_to_rotmat(turns), angles, wrist, np.zeros((len(times), 10)), np.full(len(times), 0.5))


def from_second(state: State) -> State:
    return replace(state, root=TURN @ state.root, wrist=state.wrist @ TURN.T + SHIFT)


def viewed(state: State, times: np.ndarray, side: Side = "right") -> ViewedHand:
    """What a view has that errs nowhere in the picture, but in depth."""
    chain = fitter_of(load_model(None, side)).chain
    points = chain.points(state)
    seen = observe(points)
    table = Landmarked(seen.pixels, seen.pixel_sigma, 0.7 * seen.depth, seen.depth_sigma)
    bent = replace(state, angles=state.angles + 0.1, wrist=state.wrist * 1.1)
    return ViewedHand(
        times, table, FPS, np.arange(len(times)), points, bent, chain.points(bent), side, CAMERA
    )


def pair(side: Side = "right", seed: int = 0) -> HandPair:
    times = np.arange(FRAMES) / FPS
    first = viewed(moving(times, side, seed), times, side)
    second = viewed(from_second(moving(times + OFFSET, side, seed)), times, side)
    return HandPair(fitter_of(load_model(None, side)), first, second)


def take_of(state: State, name: str, side: Side = "right") -> Take:
    """A take of a hand that was detected where it is."""
    model = load_model(None, side)
    betas, orient, pose, transl = fitter_of(model).chain.parameters(state)
    motion = HandMotion(side, betas[0], orient, pose, transl)
    track = seen_of(model, motion, CAMERA, FPS)
    return Take(
        source=Source("video", (name,)),
        fps=FPS,
        frame_numbers=np.arange(1, 1 + len(state)),
        width=640,
        height=480,
        intrinsics=CAMERA,
        solver="fast",
        model="open-hand",
        model_digests={},
        hands=(hand_track(model, track, motion, CAMERA),),
    )


def takes(seed: int = 0, other: int | None = None) -> tuple[ViewTake, ViewTake]:
    times = np.arange(FRAMES) / FPS
    second = from_second(moving(times + OFFSET, seed=seed if other is None else other))
    return (
        ViewTake(take_of(moving(times, seed=seed), "/a.mp4"), lens_known=True),
        ViewTake(take_of(second, "/b.mp4"), lens_known=True),
    )
