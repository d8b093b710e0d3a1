"""The gap between a hand and the prop that it holds: pads of fingers touch it, and nothing penetrates it."""

from __future__ import annotations

import numpy as np

from handfit_core.fit.grip import Grip
from handfit_core.fit.observation import Observation
from handfit_core.fit.settings import TERMS
from handfit_core.fit.terms.rows import HAND, Rows, SkinRows
from handfit_core.hand_model.chain import PLACE, ROOT, Posed
from handfit_core.hand_model.surface import cross


def grip(posed: Posed, seen: Observation) -> SkinRows:
    """Return one row for each point of `seen.grip`, which must be there, that is inside the prop, or nearly:
    r = depth / prop_penetration_sigma; and one row for the nearest point of each pad that is drawn to it: r =
    drawn gap / prop_touch_sigma."""
    assert seen.grip is not None
    aim: Grip = seen.grip
    places, gaps, out = aim.gaps(posed)
    hand, point = np.nonzero(gaps < TERMS.prop_softness)
    gap = gaps[hand, point]
    # Near the surface a parabola leads over to zero, so that a step knows what it is about to push inside.
    over = np.minimum(TERMS.prop_softness - gap, 2.0 * TERMS.prop_softness) / (2.0 * TERMS.prop_softness)
    depth = np.where(over < 1.0, TERMS.prop_softness * over**2, -gap) / TERMS.prop_penetration_sigma
    slope = -over / TERMS.prop_penetration_sigma
    of_pad = aim.points.of_pads(gaps)
    row, pad = np.nonzero(np.isfinite(of_pad.min(axis=2)) & (aim.drawn > 0.0))
    near = of_pad[row, pad].argmin(axis=1)
    drawn = aim.drawn[row, pad] / TERMS.prop_touch_sigma
    residual, slope = np.append(depth, drawn * gaps[row, near]), np.append(slope, drawn)
    hand, point = np.append(hand, row), np.append(point, near)
    finger, place, towards = aim.points.finger[point], places[hand, point], out[hand, point]
    columns = np.empty((len(hand), 16))
    arms = place[:, None] - posed.origins[hand, finger, :3]
    turned = (cross(arms, towards[:, None])[:, :, None] @ posed.axes[hand, finger, :3])[:, :, 0]
    columns[:, :9] = (turned * aim.points.follows[point, :, None]).reshape(-1, 9)
    by_root = cross(place - posed.state.wrist[hand], towards)
    columns[:, 9:12] = (by_root[:, None] @ posed.state.root[hand])[:, 0]
    columns[:, 12:15] = towards
    columns *= slope[:, None]
    columns[:, 15] = residual
    return SkinRows(hand, finger, columns)


def near_wrist(posed: Posed, seen: Observation) -> Rows:
    """Return six rows for each hand: the sine of its wrist's turn from the captured one, over
    grip_turn_sigma, and its way from it, over grip_place_sigma."""
    assert seen.grip is not None
    state, captured = posed.state, seen.grip.captured
    rows = Rows.zeros(HAND, len(state), 6)
    rows.jacobian[:, 0, :3, ROOT] = np.eye(3) / TERMS.grip_turn_sigma
    rows.jacobian[:, 0, 3:, PLACE] = np.eye(3) / TERMS.grip_place_sigma
    turn = captured.root.swapaxes(1, 2) @ state.root
    sine = 0.5 * (turn - turn.swapaxes(1, 2))[:, [2, 0, 1], [1, 2, 0]]
    rows.residual[:, 0, :3] = sine / TERMS.grip_turn_sigma
    rows.residual[:, 0, 3:] = (state.wrist - captured.wrist) / TERMS.grip_place_sigma
    return rows
