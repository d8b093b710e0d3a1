"""The gap between a hand and the prop that it holds: pads of fingers touch it, and nothing penetrates it."""

from __future__ import annotations

import numpy as np

from handfit_core.fit.grip import LEVELS, Grip
from handfit_core.fit.observation import Observation
from handfit_core.fit.settings import TERMS
from handfit_core.fit.terms.rows import HAND, Rows, SkinRows
from handfit_core.geometry.rotations import rotmat_to_rotvec
from handfit_core.hand_model.chain import PLACE, ROOT, Posed
from handfit_core.hand_model.surface import cross


def grip(posed: Posed, seen: Observation) -> SkinRows:
    """Return one row for each point of `seen.grip`, which must be there, that penetrates the prop: r = depth
    / prop_penetration_sigma; and one row for the nearest point of each pad that is drawn to it: r = drawn gap
    / prop_touch_sigma."""
    assert seen.grip is not None
    aim: Grip = seen.grip
    places, gaps, out = aim.gaps(posed)
    hand, point = np.nonzero(gaps < 0.0)
    weight = np.full(len(hand), 1.0 / TERMS.prop_penetration_sigma)
    for pad in range(5 * LEVELS):
        of_pad = np.where(aim.points.pad == pad, gaps, np.inf)
        nearest, drawn = of_pad.argmin(axis=1), aim.drawn[:, pad]
        rows = np.flatnonzero(np.isfinite(of_pad.min(axis=1)) & (drawn > 0.0))
        hand, point = np.append(hand, rows), np.append(point, nearest[rows])
        weight = np.append(weight, drawn[rows] / TERMS.prop_touch_sigma)
    finger, place, towards = aim.points.finger[point], places[hand, point], out[hand, point]
    columns = np.empty((len(hand), 16))
    arms = place[:, None] - posed.origins[hand, finger, :3]
    turned = (cross(arms, towards[:, None])[:, :, None] @ posed.axes[hand, finger, :3])[:, :, 0]
    columns[:, :9] = (turned * aim.points.follows[point, :, None]).reshape(-1, 9)
    by_root = cross(place - posed.state.wrist[hand], towards)
    columns[:, 9:12] = (by_root[:, None] @ posed.state.root[hand])[:, 0]
    columns[:, 12:15], columns[:, 15] = towards, gaps[hand, point]
    return SkinRows(hand, finger, columns * weight[:, None])


def near_wrist(posed: Posed, seen: Observation) -> Rows:
    """Return six rows for each hand: how far its wrist is turned from the captured one, over grip_turn_sigma,
    and moved from it, over grip_place_sigma."""
    assert seen.grip is not None
    state, captured = posed.state, seen.grip.captured
    rows = Rows.zeros(HAND, len(state), 6)
    rows.jacobian[:, 0, :3, ROOT] = np.eye(3) / TERMS.grip_turn_sigma
    rows.jacobian[:, 0, 3:, PLACE] = np.eye(3) / TERMS.grip_place_sigma
    turn = rotmat_to_rotvec(captured.root.swapaxes(1, 2) @ state.root)
    rows.residual[:, 0, :3] = turn / TERMS.grip_turn_sigma
    rows.residual[:, 0, 3:] = (state.wrist - captured.wrist) / TERMS.grip_place_sigma
    return rows
