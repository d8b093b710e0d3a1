"""Hands of points as files tell of them, one by one and half known, made into a recording's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from handfit_core.common.arrays import LARGEST
from handfit_core.common.batch import Batch
from handfit_core.common.errors import InputError
from handfit_core.common.skeleton import NUM_KEYPOINTS, SIDES, other_side
from handfit_core.geometry.camera import Intrinsics
from handfit_core.interchange.json_points import several_hands
from handfit_core.interchange.orders import ORDERS, order_by_bones
from handfit_core.interchange.recording import LEAST_POINTS, PointsHand, SeenHands, known

UNKNOWN: Final = -1
"""A side that is not told"""
LEAST_SURE: Final = 0.3
"""What `share_left` must differ from 0 before it is believed"""


@dataclass(frozen=True, eq=False)
class ParsedHands(Batch):
    """N hands of a file, in its own coordinates."""

    row: np.ndarray
    """(N,) int: which frame; not decreasing"""
    side: np.ndarray
    """(N,) int: which of SIDES, or UNKNOWN"""
    hand: np.ndarray
    """(N,) int: which of a frame's hands, where the file counts them"""
    score: np.ndarray
    """(N,) 0..1"""
    points: np.ndarray
    """(N, K, 3) in the file's order, which `in_order` makes MediaPipe's; NaN: not told, as z is for points in
    the plane"""
    confidence: np.ndarray
    """(N, K) 0..1; 0 for points that are missing"""
    world: np.ndarray
    """(N, K, 3) metres about the hand's middle; NaN: not told"""

    @classmethod
    def of(cls, row: Any, side: Any, hand: Any, score: Any, told: Any, world: Any = np.nan) -> ParsedHands:
        """The hands of N that have any point. `score`, NaN: the mean of the points' confidence; `told`
        (N, K, 3) or, with confidences, (N, K, 4), NaN: not told. Raises ValueError for points that no hand
        has."""
        row, side, hand = (np.array(each, dtype=int) for each in (row, side, hand))
        told = np.array(told, dtype=np.float64) if len(row) else np.empty((0, NUM_KEYPOINTS, 4))
        points = told[..., :3]
        sure = told[..., 3] if told.shape[-1] > 3 else np.full(points.shape[:2], np.nan)
        if sure.size and np.nanmax(sure, initial=0.0) > 10.0:
            sure = sure / 100.0  # percent
        world = np.broadcast_to(np.array(world, dtype=np.float64), points.shape) if len(row) else points
        if np.any(np.abs(points) > LARGEST) or np.any(np.abs(world) > LARGEST):
            raise ValueError(f"a point lies beyond {LARGEST:g}")
        points, world = (np.where(np.isfinite(each), each, np.nan) for each in (points, world))
        there = known(points[..., :2]) & np.any(points[..., :2] != 0.0, axis=-1)
        sure = np.where(there, np.where(np.isnan(sure), 1.0, sure).clip(0.0, 1.0), 0.0)
        score = np.array(score, dtype=np.float64)
        score = np.where(np.isfinite(score), score, sure.mean(axis=1)).clip(0.0, 1.0)
        kept = np.flatnonzero(sure.any(axis=1) | known(world).any(axis=1))
        order = kept[np.argsort(row[kept], kind="stable")]
        return cls(row, side, hand, score, points, sure, world).select(order)

    @property
    def in_plane(self) -> np.ndarray:
        """(N, 21, 2) x and y of points that are trusted at all."""
        trusted = (self.confidence > 0.0)[..., None]
        return np.where(trusted & np.isfinite(self.points[..., :2]), self.points[..., :2], np.nan)


@dataclass(frozen=True, eq=False)
class ParsedPoints:
    """What a file tells: T frames with hands, and what surrounds them."""

    numbers: np.ndarray
    """(T,) int, increasing"""
    hands: ParsedHands
    fps: float = 0.0
    """0: not told"""
    size: tuple[int, int] | None = None
    intrinsics: Intrinsics | None = None
    in_space: bool = False
    """Whether points are in space, rather than in the plane with a depth"""
    mirrored: bool | None = None
    """Whether sides count for mirrored pictures; None: not known"""
    halved: bool = False
    """Whether parts of the picture's size are from -1 to 1, rather than from 0"""
    assumed: tuple[str, ...] = ()
    order: str = ""
    """Of `ORDERS`, as the file tells; empty: it does not"""
    guessed: bool = False
    """Whether which hand is the left one is guessed by its place in a list"""


def in_order(parsed: ParsedPoints, order: str | None, *, parts: bool) -> tuple[ParsedHands, tuple[str, ...]]:
    """The hands in MediaPipe's order, and what is said of it. `order`: the one that is asked for, if any;
    `parts`: whether points in the plane are parts of the picture's size. Raises ValueError if none fits."""
    hands, said = parsed.hands, ""
    name, count = order or parsed.order, hands.points.shape[1]
    if not name:
        deep = known(hands.world).all(axis=1).any()
        shapes = hands.world if deep else np.where((hands.confidence > 0.0)[..., None], hands.points, np.nan)
        if parsed.size is not None and parts:
            shapes = shapes * [parsed.size[0] / parsed.size[1], 1.0, 1.0]
        in_space = bool(deep) or parsed.in_space or is_world(hands)
        name, said = order_by_bones(shapes, in_space=in_space, parts=parts and parsed.size is None)
    layout = ORDERS[name]
    if layout.count != count:
        raise ValueError(f"its hands have {count} points, and the order {name} has {layout.count}")
    sure = np.nan_to_num(layout.of(hands.confidence[..., None])[..., 0])
    hands = replace(hands, points=layout.of(hands.points), confidence=sure, world=layout.of(hands.world))
    return hands, (said,) if said else ()


def is_world(hands: ParsedHands) -> bool:
    """True if what stands for points is in metres about each hand's middle."""
    points = hands.points[known(hands.points).sum(axis=1) > 15]
    if not len(points):
        return False
    middles, reach = np.abs(np.nanmean(points, axis=1)), np.nanmax(np.abs(points), axis=(1, 2))
    return bool(np.median(middles[:, :2].max(axis=1)) < 0.05 and np.median(reach) < 0.2)


def in_metres(hands: ParsedHands) -> bool:
    """True if points with a depth are in metres before a camera, rather than parts of a picture, where a
    depth counts from a point of the hand: whose own is then zero."""
    points = hands.points[known(hands.points).all(axis=1)]
    if not len(points) or (np.abs(points[..., 2]) < 1e-5).all(axis=0).any() or is_world(hands):
        return False
    reach = np.median(np.ptp(points, axis=1).max(axis=-1))
    return bool(0.07 < reach < 0.3 and np.median(points[..., 2]) > 0.1)


def seen_hands(hands: ParsedHands) -> SeenHands:
    """Hands of known sides whose points are in the plane. Depth and world landmarks are kept where every hand
    has them."""
    depth = hands.points[..., 2]
    return SeenHands(
        hands.row,
        hands.side == SIDES.index("left"),
        hands.score,
        hands.in_plane,
        np.where(known(hands.in_plane), hands.confidence, 0.0),
        depth if len(hands) and np.isfinite(depth).all() else None,
        hands.world if len(hands) and np.isfinite(hands.world).all() else None,
    )


def hands_in_space(
    hands: ParsedHands, frames: int, *, counted: bool, on_joints: bool, sigma: float | None
) -> tuple[tuple[PointsHand, ...], tuple[str, ...]]:
    """The hands over all frames, and what was assumed: each that is `counted`, else one of each side, in a
    frame the surest, and of those that are as sure the first."""
    found, said = [], []
    which = hands.hand if counted else hands.side
    for number in np.unique(which):
        mine = np.flatnonzero(which == number)[::-1]
        side = SIDES[hands.side[mine[0]]]
        if np.any(hands.side[mine] != hands.side[mine[0]]):
            raise ValueError(f"hand {number} is a left and a right one; expected always the same side")
        mine = mine[np.argsort(hands.score[mine], kind="stable")]
        track = np.full((frames, NUM_KEYPOINTS, 3), np.nan)
        track[hands.row[mine]] = np.where((hands.confidence > 0.0)[mine, :, None], hands.points[mine], np.nan)
        found.append(PointsHand(side, track, on_joints=on_joints, sigma=sigma))
        _, times = np.unique(hands.row[mine], return_counts=True)
        said += several_hands({side: int((times > 1).sum())})
    return tuple(found), tuple(said)


def metres_of(hands: tuple[PointsHand, ...], units: Mapping[str, float]) -> tuple[float, tuple[str, ...]]:
    """Metres of one of the file's units, by the palm's length, and what is said where it is not the first.
    Raises ValueError where none of the units makes a hand of it."""
    usual = next(iter(units))
    palms = np.concatenate([np.linalg.norm(h.points[:, 9] - h.points[:, 0], axis=-1) for h in hands])
    palm = float(np.nanmedian(palms)) if np.isfinite(palms).any() else np.nan
    for name, unit in units.items():
        if 0.036 < palm * unit < 0.225:
            return unit, () if name == usual else (f"its unit is {name}, by the palm's length",)
    raise ValueError(
        f"its palms are {palm:.3g} long from the wrist to the middle finger's knuckle; expected about "
        f"{0.09 / units[usual]:g}, in {usual}"
    )


def bent_as_left(points: np.ndarray) -> np.ndarray:
    """(N,) how far the fingers of hands (N, 21, 3) bend out of the palm's plane, in its length: positive for
    left hands, negative for right ones, as fingers bend towards the palm.

    In axes that form a right-handed frame, such as the camera's. NaN where points are missing.
    """
    along, across = points[:, 9] - points[:, 0], points[:, 5] - points[:, 17]
    normal = np.cross(along, across)
    size = np.maximum(np.linalg.norm(normal, axis=-1) * np.linalg.norm(along, axis=-1), 1e-12)
    fingers = (points[:, [8, 12, 16, 20]] - points[:, [5, 9, 13, 17]]).mean(axis=1)
    return np.einsum("nk,nk->n", fingers, normal) / size


def share_left(points: np.ndarray, signs: np.ndarray | float = 1.0) -> float:
    """From -1 (right) to 1 (left): what hands (N, 21, 3) look like by how their fingers bend; 0: unknown.
    `signs` (N,): with -1 for right hands, from -1 (the other ones) to 1 (as they are called)."""
    bent = bent_as_left(points) * signs
    bent = bent[np.isfinite(bent)]
    total = float(np.abs(bent).sum())
    return float(bent.sum()) / total if total > 0.0 else 0.0


def odd_sides(hands: tuple[PointsHand, ...]) -> tuple[str, ...]:
    """What is said of hands that look like the other side's."""
    return tuple(
        f"its {hand.side} hand bends like a {other_side(hand.side)} one: its files may be swapped or mirrored"
        for hand in hands
        if share_left(hand.points, 1.0 if hand.side == "left" else -1.0) < -LEAST_SURE
    )


def own_sides(
    hands: ParsedHands, shapes: np.ndarray, mirrored: bool | None
) -> tuple[ParsedHands, tuple[str, ...]]:
    """The hands, left and right swapped where labels count for mirrored pictures, and what is said of it.

    `shapes` (N, 21, 3): what is known of their shape in space. `mirrored`: what the file's layout says.
    """
    told = hands.side != UNKNOWN
    signs = np.where(hands.side == SIDES.index("left"), 1.0, -1.0)
    share = share_left(shapes[told], signs[told])
    swap = share < 0.0 if abs(share) > LEAST_SURE else bool(mirrored)
    if not told.any() or not swap:
        return hands, ()
    how = (
        "as its fingers bend"
        if abs(share) > LEAST_SURE
        else "as multi_handedness names them for mirrored pictures"
    )
    said = f"left and right are swapped, {how}"
    return replace(hands, side=np.where(told, 1 - hands.side, hands.side)), (said,)


def with_sides(hands: ParsedHands, wanted: str, shapes: np.ndarray) -> tuple[ParsedHands, tuple[str, ...]]:
    """The hands, all with a side, and what was assumed for it.

    `wanted` is the option of the sides that are to be kept: where it names one, hands of unknown side are of
    it. `shapes` (N, 21, 3): what they look like in space; NaN: not known.
    """
    unknown = hands.side == UNKNOWN
    side, said = hands.side.copy(), set()
    for hand in np.unique(hands.hand[unknown]):
        mine = unknown & (hands.hand == hand)
        looks = share_left(shapes[mine])
        if wanted in SIDES:
            told, how = wanted, f"a {wanted} hand, as asked for"
        elif abs(looks) > LEAST_SURE:
            told = SIDES[0 if looks > 0.0 else 1]
            how = f"a {told} hand, as its fingers bend"
        else:
            told, how = "right", "a right hand (--hands left for a left one)"
        side[mine] = SIDES.index(told)
        said.add(f"which hand it is is not told: {how}")
    return replace(hands, side=side), tuple(sorted(said))


def check_some(hands: ParsedHands, what: str, hint: str) -> None:
    """Raise InputError where no hand has enough points. `what`, `hint`: how the sentence begins and ends."""
    if not np.any(known(hands.in_plane).sum(axis=1) >= LEAST_POINTS):
        raise InputError(f"{what}, none of its frames has a hand with at least {LEAST_POINTS} points{hint}")


def without_hidden(hands: ParsedHands, least: float) -> tuple[ParsedHands, tuple[str, ...]]:
    """The hands whose points have a mean confidence of `least` or more, and what was left out: programs that
    look for whole people tell of hidden hands, too."""
    count = np.maximum((hands.confidence > 0.0).sum(axis=1), 1)
    kept = hands.confidence.sum(axis=1) / count >= least
    if kept.all():
        return hands, ()
    said = f"{int((~kept).sum())} of {len(kept)} hands are left out: their mean confidence is below {least:g}"
    return hands.select(np.flatnonzero(kept)), (said,)
