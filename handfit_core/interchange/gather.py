"""Hands as files tell of them, one by one and half known, made into a recording's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from handfit_core.arrays import LARGEST
from handfit_core.batch import Batch
from handfit_core.errors import InputError
from handfit_core.interchange.recording import LEAST_POINTS, PointsHand, SeenHands, known
from handfit_core.skeleton import NUM_KEYPOINTS, SIDES, Side

UNKNOWN: Final = -1
"""A side that is not told"""


@dataclass(frozen=True, eq=False)
class ToldHands(Batch):
    """N hands of a file, in its own coordinates."""

    row: np.ndarray
    """(N,) int: which frame"""
    side: np.ndarray
    """(N,) int: which of SIDES, or UNKNOWN"""
    hand: np.ndarray
    """(N,) int: which of a frame's hands, where the file counts them"""
    score: np.ndarray
    """(N,) 0..1"""
    points: np.ndarray
    """(N, 21, 3), NaN: not told, as z is for points in the plane"""
    confidence: np.ndarray
    """(N, 21) 0..1"""
    world: np.ndarray
    """(N, 21, 3) metres about the hand's middle; NaN: not told"""

    @property
    def in_plane(self) -> np.ndarray:
        """(N, 21, 2) x and y of points that are trusted at all."""
        trusted = (self.confidence > 0.0)[..., None]
        return np.where(trusted & np.isfinite(self.points[..., :2]), self.points[..., :2], np.nan)


class Gathering:
    """`ToldHands` while they are being read."""

    def __init__(self) -> None:
        self._hands: list[tuple[int, int, int, float, np.ndarray, np.ndarray, np.ndarray]] = []

    def add(
        self,
        row: int,
        points: np.ndarray,
        side: Side | None,
        confidence: np.ndarray | None = None,
        score: float | None = None,
        world: np.ndarray | None = None,
        hand: int = 0,
    ) -> None:
        """One hand: points (21, 2) or (21, 3) in the file's coordinates, NaN or a confidence of 0 where one
        is missing; `world` (21, 3) in metres. `score` None: the mean of what is known of points. Hands
        without any point are left out. Raises ValueError for points that no hand has."""
        whole = np.full((NUM_KEYPOINTS, 3), np.nan)
        if points.ndim != 2 or len(points) != NUM_KEYPOINTS or points.shape[1] not in (2, 3):
            raise ValueError(f"a hand has points of the shape {points.shape}; expected 21 of 2 or 3 numbers")
        whole[:, : points.shape[1]] = points
        if np.any(np.abs(whole) > LARGEST):
            raise ValueError(f"a point lies beyond {LARGEST:g}")
        whole[~np.isfinite(whole)] = np.nan
        there = known(whole[:, :2])
        sure = np.ones(NUM_KEYPOINTS) if confidence is None else np.nan_to_num(confidence).clip(0.0, 1.0)
        sure = np.where(there, sure, 0.0)
        if not sure.any() and (world is None or not known(world).any()):
            return
        certain = (
            float(sure.mean()) if score is None or not np.isfinite(score) else float(np.clip(score, 0, 1))
        )
        space = np.full((NUM_KEYPOINTS, 3), np.nan) if world is None else world
        code = UNKNOWN if side is None else SIDES.index(side)
        self._hands.append((row, code, hand, certain, whole, sure, space))

    def hands(self) -> ToldHands:
        """All of them, frame by frame."""
        order = sorted(range(len(self._hands)), key=lambda i: self._hands[i][0])
        columns = zip(*(self._hands[i] for i in order), strict=True) if order else [()] * 7
        row, side, hand, score, points, sure, world = (np.array(column) for column in columns)
        shape = (-1, NUM_KEYPOINTS)
        return ToldHands(
            row.astype(int),
            side.astype(int),
            hand.astype(int),
            score.astype(float),
            points.reshape(*shape, 3),
            sure.reshape(shape),
            world.reshape(*shape, 3),
        )


def seen_hands(hands: ToldHands, by: Sequence[float] = (1.0, 1.0)) -> SeenHands:
    """Hands of known sides whose points are in the plane; `by` scales x, with the depth, and y.

    Depth and world landmarks are kept where every hand has them.
    """
    keypoints = hands.in_plane * np.asarray(by)
    depth = hands.points[..., 2] * by[0]
    return SeenHands(
        hands.row,
        hands.side == SIDES.index("left"),
        hands.score,
        keypoints,
        np.where(known(keypoints), hands.confidence, 0.0),
        depth if len(hands) and np.isfinite(depth).all() else None,
        hands.world if len(hands) and np.isfinite(hands.world).all() else None,
    )


def hands_in_space(
    hands: ToldHands, frames: int, points: np.ndarray, *, on_joints: bool, sigma: float
) -> tuple[PointsHand, ...]:
    """One hand of each side, `points` (N, 21, 3) in metres in the camera frame; of several hands of one side
    in a frame, the surest."""
    found = []
    order = np.argsort(hands.score, kind="stable")
    for code, side in enumerate(SIDES):
        mine = order[hands.side[order] == code]
        if len(mine):
            track = np.full((frames, NUM_KEYPOINTS, 3), np.nan)
            track[hands.row[mine]] = np.where((hands.confidence > 0.0)[mine, :, None], points[mine], np.nan)
            found.append(PointsHand(side, track, on_joints=on_joints, sigma=sigma))
    return tuple(found)


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


def share_left(points: np.ndarray) -> float:
    """From -1 (right) to 1 (left): what hands (N, 21, 3) look like by how their fingers bend; 0: unknown."""
    bent = bent_as_left(points)
    bent = bent[np.isfinite(bent)]
    total = float(np.abs(bent).sum())
    return float(bent.sum()) / total if total > 0.0 else 0.0


def with_sides(hands: ToldHands, wanted: str, shapes: np.ndarray | None) -> tuple[ToldHands, tuple[str, ...]]:
    """The hands, all with a side, and what was assumed for it.

    `wanted` is the option of the sides that are to be kept: where it names one, hands of unknown side are of
    it. `shapes` (N, 21, 3): what they look like in space, None: not known.
    """
    unknown = hands.side == UNKNOWN
    if not unknown.any():
        return hands, ()
    side, how = hands.side.copy(), set()
    for hand in np.unique(hands.hand[unknown]):
        mine = unknown & (hands.hand == hand)
        looks = 0.0 if shapes is None else share_left(shapes[mine])
        if wanted in SIDES:
            side[mine] = SIDES.index(wanted)
            how.add(f"which hand it is is not told: a {wanted} hand, as asked for")
        elif abs(looks) > LEAST_SURE:
            said = SIDES[0 if looks > 0.0 else 1]
            side[mine] = SIDES.index(said)
            how.add(f"which hand it is is not told: a {said} hand, as its fingers bend")
        else:
            side[mine] = SIDES.index("right")
            how.add("which hand it is is not told: a right hand (--hands left for a left one)")
    return replace(hands, side=side), tuple(sorted(how))


LEAST_SURE: Final = 0.3
"""What `share_left` must differ from 0 before it is believed"""


def check_some(hands: ToldHands, what: str) -> None:
    """Raise InputError where no hand has enough points. `what`: the sentence's beginning."""
    if not np.any(known(hands.in_plane).sum(axis=1) >= LEAST_POINTS):
        raise InputError(f"{what}, but none of its frames has a hand with at least {LEAST_POINTS} points")


def without_hidden(hands: ToldHands, least: float) -> tuple[ToldHands, tuple[str, ...]]:
    """The hands whose points have a mean confidence of `least` or more, and what was left out: programs that
    look for whole people tell of hidden hands, too."""
    count = np.maximum((hands.confidence > 0.0).sum(axis=1), 1)
    kept = hands.confidence.sum(axis=1) / count >= least
    if kept.all():
        return hands, ()
    said = f"{int((~kept).sum())} of {len(kept)} hands are left out: their mean confidence is below {least:g}"
    return hands.select(np.flatnonzero(kept)), (said,)


def of_person(people: Sequence[object], person: int | None) -> list[tuple[int, object]]:
    """The people of a frame that are wanted, each with its number, counted from 1."""
    numbered = list(enumerate(people, 1))
    return numbered if person is None else [each for each in numbered if each[0] == person]


def check_person(person: int | None, most: int, path: str) -> None:
    """Raise InputError for a person that no frame has."""
    if person is not None and person > most:
        raise InputError(f"{path}: there is no person {person}; its frames have at most {most}")
