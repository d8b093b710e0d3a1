"""Fingers laid on a prop: first by spheres inside them, which tell where they came in, then by their skin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from handfit_core.common.errors import OptionError
from handfit_core.common.skeleton import JOINTS_BY_FINGER
from handfit_core.edit import pins as pinning
from handfit_core.edit.hand import Prop, RefineHand
from handfit_core.edit.settings import EDITS, GRIPS
from handfit_core.edit.solving import (
    check_stop,
    chunks_of,
    fixed_at,
    posed_in_front,
    states_of,
    with_fixed,
)
from handfit_core.fit.fast import FastFitter, fitter_of
from handfit_core.fit.grip import Grip, GripPoints
from handfit_core.fit.observation import PoseAnchor, observation_of
from handfit_core.fit.prop import PropSurface, outward
from handfit_core.fit.solvers import ShouldStop
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.chain import State
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.motion import HandMotion


def solve_grip(hand: RefineHand, prop: Prop, model: HandModel, should_stop: ShouldStop) -> HandMotion:
    """Lay the hand on the prop in all T frames, each frame by itself; the wrist moves in all of them or in
    none."""
    if len(prop.placed) != len(hand):
        raise OptionError(f"prop: placed has {len(prop.placed)} rows, expected {len(hand)}")
    posed, landmarks = posed_in_front(hand, model)
    pose = [np.where(posed[:, None], np.asarray(rows, dtype=np.float64), np.nan) for rows in hand.pose]
    fixed, rows = np.tile(posed[:, None], 16), np.flatnonzero(posed)
    vertices = np.asarray(prop.vertices, dtype=np.float64)
    triangles = outward(vertices, prop.triangles)
    if not len(rows):
        return with_fixed(hand, fixed, pose)
    turn, place = prop.placed[..., :3], prop.placed[..., 3]
    seen_from = (landmarks[rows] - place[rows, None]) @ turn[rows]
    low, high = (pick(seen_from, axis=(0, 1)) for pick in (np.min, np.max))
    surface = PropSurface(vertices, triangles, low - GRIPS.margin, high + GRIPS.margin)
    if not len(surface):
        return with_fixed(hand, fixed, pose)
    fitter = fitter_of(model)
    own = states_of(fitter, hand, hand, posed[rows], rows)
    points, skin = (make(model, own.betas[0]) for make in (GripPoints.spheres, GripPoints.skin))
    grip = Grip(surface, points, turn[rows], place[rows], np.zeros((len(rows), 10)), own, GRIPS.margin)
    grip, joints = _wanted(fitter, grip, skin, prop.fingers)
    fixed[rows] = joints | np.asarray(hand.locked, dtype=bool)
    busy = np.flatnonzero(~fixed[rows].all(axis=1))
    for _, part in chunks_of(busy):
        check_stop(should_stop)
        at = busy[part]
        state = _laid(fitter, hand.intrinsics, grip.select(at), skin, fixed[rows[at]])
        for all_rows, found in zip(pose, fitter.chain.parameters(state)[1:], strict=True):
            all_rows[rows[at]] = found
    return with_fixed(hand, fixed, pose)


def _wanted(fitter: FastFitter, grip: Grip, skin: GripPoints, fingers: np.ndarray) -> tuple[Grip, np.ndarray]:
    """Return the grip with the pads that are to be drawn to the prop, and the joints (B, 16) bool that are to
    stay fixed."""
    posed, points = fitter.chain.pose(grip.captured), grip.points
    gaps = grip.gaps(posed)[1]
    firm = skin.select(np.isin(skin.weights.argmax(axis=1), [0, *JOINTS_BY_FINGER[fingers, 0]]))
    depth = -replace(grip, points=firm).gaps(posed)[1].min(axis=0)
    palm, roots = (depth[at].max(initial=0.0) for at in (firm.palm, ~firm.palm))
    for name, deep, most in (
        ("the palm", palm, GRIPS.deepest_palm),
        ("the roots of fingers", roots, GRIPS.deepest_root),
    ):
        if deep > most:
            raise OptionError(
                f"the prop is up to {1000 * deep:.0f} mm inside {name}; move it out, or grip in fewer frames"
            )
    gap = points.of_pads(gaps).min(axis=2).reshape(-1, 5, 2)
    near, far = np.array([GRIPS.middle_reach, GRIPS.reach]).T
    drawn = np.clip((far - gap) / (far - near), 0.0, 1.0) * fingers[:, None]
    drawn[..., 0] *= GRIPS.middle_share * drawn[..., 1]
    of_finger = (points.finger == np.arange(5)[:, None]) & ~points.palm
    sunk = np.stack([(gaps[:, own] < 0.0).any(axis=1) for own in of_finger], axis=1) & fingers
    fixed = np.ones((len(gaps), 16), dtype=bool)
    fixed[:, 0] = palm <= GRIPS.palm_gives_way
    fixed[:, JOINTS_BY_FINGER] = ~((drawn[..., 1] > 0.0) | sunk)[..., None]
    return replace(grip, drawn=drawn.reshape(-1, 10)), fixed


def _laid(
    fitter: FastFitter, intrinsics: Intrinsics, grip: Grip, skin: GripPoints, joints: np.ndarray
) -> State:
    """Lay B hands on the prop, but for the `joints` (B, 16) bool that are fixed; returns their states."""
    own, fixed = grip.captured, fixed_at(joints, grip.captured)
    seen = pinning.landmarks_of_pose(fitter.chain.points(own), intrinsics)
    seen = replace(
        seen, pixel_sigma=GRIPS.loosened * seen.pixel_sigma, depth_sigma=GRIPS.loosened * seen.depth_sigma
    )
    anchor = PoseAnchor.at(own, angle_sigma=GRIPS.angle_sigma, limits_sigma=pinning.PINS.limits_sigma)
    observed = replace(observation_of(seen, intrinsics), anchor=anchor)
    along = (fitter.chain.points(own) * observed.ray[:, None]).sum(axis=2).mean(axis=1)

    def fitted(state: State, aim: Grip, *, solid: bool) -> State:
        problem = fitter.problem(replace(observed, grip=aim), fixed=fixed, solid=solid)
        limits = EDITS.max_iterations, GRIPS.tolerances[solid], GRIPS.first_damping
        return fitter.solve_each(problem, state, *limits).state

    state = fitted(replace(own, depth_zero=along), grip, solid=False)
    moved = skin.select(skin.weights @ ~joints.all(axis=0) > 0.0)
    on_skin = replace(grip, points=moved, within=GRIPS.skin_reach)
    near = np.isfinite(on_skin.gaps(fitter.chain.pose(state))[1].min(axis=0))
    return fitted(state, replace(on_skin, points=moved.select(near)), solid=True)
