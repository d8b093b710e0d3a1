"""Hands of points as files have them, half known, made into a recording's: order, sides, units. To `said`,
phrases for people, each function adds what it assumed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from handfit_core.common.skeleton import SIDES, Side, other_side
from handfit_core.interchange.frames import Frames
from handfit_core.interchange.orders import ORDERS, order_by_bones
from handfit_core.interchange.recording import UNKNOWN, PointsHand, SeenHands, known

LEAST_SURE: Final = 0.3
"""How much `share_left` must differ from 0 before it is believed"""


def ordered(
    hands: SeenHands, frames: Frames, order: str | None, said: list[str], *, parts: bool
) -> SeenHands:
    """Return the hands in MediaPipe's order. `order`: the one that is asked for, if any; `parts`: whether
    points in the plane are parts of the picture's size. Raises ValueError if none fits."""
    name, count = order or frames.order, hands.points.shape[1]
    if not name:
        deep = known(hands.world).all(axis=1).any()
        shapes = hands.world if deep else np.where((hands.confidence > 0.0)[..., None], hands.points, np.nan)
        if frames.size is not None and parts:
            shapes = shapes * [frames.size[0] / frames.size[1], 1.0, 1.0]
        in_space = bool(deep) or frames.in_space or is_world(hands)
        name, told = order_by_bones(shapes, in_space=in_space, parts=parts and frames.size is None)
        said.append(told)
    of = ORDERS[name]
    if of.count != count:
        raise ValueError(f"its hands have {count} points, and the order {name} has {of.count}")
    sure = np.nan_to_num(of.of(hands.confidence[..., None])[..., 0])
    turns = None if hands.turns is None else of.of(hands.turns)
    return replace(hands, points=of.of(hands.points), confidence=sure, world=of.of(hands.world), turns=turns)


def is_world(hands: SeenHands) -> bool:
    """Return whether the numbers that stand for points are metres about each hand's middle."""
    points = hands.points[known(hands.points).sum(axis=1) > 15]
    if not len(points):
        return False
    middles, reach = np.abs(np.nanmean(points, axis=1)), np.nanmax(np.abs(points), axis=(1, 2))
    return bool(np.median(middles[:, :2].max(axis=1)) < 0.05 and np.median(reach) < 0.2)


def in_metres(hands: SeenHands) -> bool:
    """Return whether points with a depth are in metres before a camera, rather than parts of a picture, where
    a depth counts from a point of the hand, whose own depth is then zero."""
    points = hands.points[known(hands.points).all(axis=1)]
    if not len(points) or (np.abs(points[..., 2]) < 1e-5).all(axis=0).any() or is_world(hands):
        return False
    reach = np.median(np.ptp(points, axis=1).max(axis=-1))
    return bool(0.07 < reach < 0.3 and np.median(points[..., 2]) > 0.1)


def tracks_of(
    hands: SeenHands, frames: int, said: list[str], *, counted: bool
) -> list[tuple[Side, np.ndarray]]:
    """Return the side and the points x, y, z (T, 21, 3) of hands over all T frames, or with quaternions (T,
    21, 7) if there are any: each hand that is `counted`, else one of each side, in a frame the surest, and of
    equally sure ones the first."""
    found = []
    values = np.where((hands.confidence > 0.0)[..., None], hands.points, np.nan)
    if hands.turns is not None:
        values = np.concatenate([values, hands.turns], axis=-1)
    which = hands.hand if counted else hands.side
    for number in np.unique(which):
        mine = np.flatnonzero(which == number)[::-1]
        side = SIDES[hands.side[mine[0]]]
        if np.any(hands.side[mine] != hands.side[mine[0]]):
            raise ValueError(f"hand {number} is a left and a right one; expected always the same side")
        mine = mine[np.argsort(hands.score[mine], kind="stable")]
        track = np.full((frames, *values.shape[1:]), np.nan)
        track[hands.row[mine]] = values[mine]
        found.append((side, track))
        _, times = np.unique(hands.row[mine], return_counts=True)
        if several := int((times > 1).sum()):
            have = "frame has" if several == 1 else "frames have"
            said.append(f"{several} {have} several {side} hands: the first was taken")
    return found


def metres_of(hands: Sequence[PointsHand], units: Mapping[str, float], said: list[str]) -> float:
    """Return how many metres the file's unit is, by the palm's length. Raises ValueError where none of the
    `units` makes a hand of it."""
    usual = next(iter(units))
    palms = np.concatenate([np.linalg.norm(h.points[:, 9] - h.points[:, 0], axis=-1) for h in hands])
    palm = float(np.nanmedian(palms)) if np.isfinite(palms).any() else np.nan
    for name, unit in units.items():
        if 0.036 < palm * unit < 0.225:
            said += [] if name == usual else [f"its unit is {name}, by the palm's length"]
            return unit
    raise ValueError(
        f"its palms are {palm:.3g} long from the wrist to the middle finger's knuckle; expected about "
        f"{0.09 / units[usual]:g}, in {usual}"
    )


def bent_as_left(points: np.ndarray) -> np.ndarray:
    """Return (N,) how far the fingers of hands (N, 21, 3) bend out of the palm's plane, in parts of its
    length: positive for left hands, negative for right ones, as fingers bend towards the palm.

    In axes that form a right-handed frame, such as the camera's. NaN where points are missing.
    """
    along, across = points[:, 9] - points[:, 0], points[:, 5] - points[:, 17]
    normal = np.cross(along, across)
    size = np.maximum(np.linalg.norm(normal, axis=-1) * np.linalg.norm(along, axis=-1), 1e-12)
    fingers = (points[:, [8, 12, 16, 20]] - points[:, [5, 9, 13, 17]]).mean(axis=1)
    return np.einsum("nk,nk->n", fingers, normal) / size


def share_left(points: np.ndarray, signs: np.ndarray | float = 1.0) -> float:
    """Return from -1 (right) to 1 (left) what side hands (N, 21, 3) look like by how their fingers bend; 0
    where unknown. `signs` (N,): with -1 for right hands, from -1 (the other side) to 1 (the side that they
    are said to be of)."""
    bent = bent_as_left(points) * signs
    bent = bent[np.isfinite(bent)]
    total = float(np.abs(bent).sum())
    return float(bent.sum()) / total if total > 0.0 else 0.0


def odd_sides(hands: Sequence[PointsHand]) -> list[str]:
    """Return phrases about hands that look like the other side's."""
    return [
        f"its {hand.side} hand bends like a {other_side(hand.side)} one: its files may be swapped or mirrored"
        for hand in hands
        if share_left(hand.points, 1.0 if hand.side == "left" else -1.0) < -LEAST_SURE
    ]


def own_sides(hands: SeenHands, shapes: np.ndarray, said: list[str], *, mirrored: bool) -> SeenHands:
    """Return the hands, left and right swapped where labels hold for mirrored pictures.

    `shapes` (N, 21, 3): what is known of their shape in space. `mirrored`: what the file's layout says.
    """
    told = hands.side != UNKNOWN
    signs = np.where(hands.side == SIDES.index("left"), 1.0, -1.0)
    share = share_left(shapes[told], signs[told])
    by_fingers = abs(share) > LEAST_SURE
    if not told.any() or not (share < 0.0 if by_fingers else mirrored):
        return hands
    how = "as its fingers bend" if by_fingers else "as multi_handedness names them for mirrored pictures"
    said.append(f"left and right are swapped, {how}")
    return replace(hands, side=np.where(told, 1 - hands.side, hands.side))


def with_sides(hands: SeenHands, wanted: str, shapes: np.ndarray, said: list[str]) -> SeenHands:
    """Return the hands that are wanted, all with a side.

    `wanted` is the option of the sides that are to be kept: where it names one, hands of unknown side are of
    it. `shapes` (N, 21, 3): what they look like in space; NaN: not known.
    """
    unknown = hands.side == UNKNOWN
    side, ways = hands.side.copy(), set()
    for hand in np.unique(hands.hand[unknown]):
        mine = unknown & (hands.hand == hand)
        looks = share_left(shapes[mine])
        if wanted in SIDES:
            told, how = wanted, "as asked for"
        elif abs(looks) > LEAST_SURE:
            told, how = SIDES[0 if looks > 0.0 else 1], "as its fingers bend"
        else:
            told, how = "right", ""
        side[mine] = SIDES.index(told)
        ways.add(f"a {told} hand" + (f", {how}" if how else " (--hands left for a left one)"))
    said += [f"which hand it is is not told: {way}" for way in sorted(ways)]
    return replace(hands, side=side)


def without_hidden(hands: SeenHands, least: float, said: list[str]) -> SeenHands:
    """Return the hands whose points have a mean confidence of `least` or more: programs that look for whole
    people tell of hidden hands, too."""
    count = np.maximum((hands.confidence > 0.0).sum(axis=1), 1)
    shown = hands.confidence.sum(axis=1) / count >= least
    if shown.all():
        return hands
    out = int((~shown).sum())
    said.append(f"{out} of {len(shown)} hands are left out: their mean confidence is below {least:g}")
    return hands.select(shown)
