"""Orders in which programs write the points of a hand, and how a hand's bones tell its order."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from handfit_core.common.skeleton import KEYPOINT_PARENTS, NUM_KEYPOINTS, Side
from handfit_core.geometry.similarity import laid_over
from handfit_core.hand_model import load_model
from handfit_core.interchange.lift import canonical_plane, lifter

LARGEST_ERROR: Final = 0.10
"""How far the points of an order may be off after the fit, in parts of the hand's length from the wrist to
the middle finger's tip, for the order to be taken"""
_PALM: Final = [0, 5, 9, 13, 17]
_MOST_BENT: Final = np.radians(115.0)
"""The largest angle in radians between two bones of a finger that follow one another"""
_DIFFER: Final = 1.3
"""The factor by which bones may be longer or shorter than the open hand's"""
_PLANE: Final = 0.2
"""How far points in pictures may be off `Plane`, in parts of a hand's size"""
_LOOKED_AT: Final = 60
"""How many hands of a file the orders are tried with, at most"""


@dataclass(frozen=True)
class PointOrder:
    """Where a file has each of MediaPipe's 21 points."""

    title: str
    points: str
    """The file's points, one after the other, by letters for fingers (T, I, M, R, P: thumb to little finger)
    with numbers from the root to the tip, W for the wrist, and - for other points"""

    @property
    def count(self) -> int:
        """The number of points that the file has for a hand."""
        return len(self.points.split())

    @property
    def indices(self) -> np.ndarray:
        """(21,) int: for each of MediaPipe's points its index among the file's; -1 where the file has
        none."""
        names = ["W", *(f"{finger}{joint}" for finger in "TIMRP" for joint in "1234")]
        told = self.points.split()
        return np.array([told.index(name) if name in told else -1 for name in names])

    def of(self, points: np.ndarray) -> np.ndarray:
        """Return points (..., K, C) of the file as (..., 21, C) in MediaPipe's order, NaN where the file has
        none."""
        chosen = np.array(points[..., self.indices, :], dtype=np.float64)
        chosen[..., self.indices < 0, :] = np.nan
        return chosen


def _fingers(fingers: str, joints: str = "1234") -> str:
    return " ".join(finger + joint for finger in fingers for joint in joints)


_MANO: Final = f"W {_fingers('IMPRT', '123')}"
ORDERS: Final = {
    "mediapipe": PointOrder("MediaPipe's", f"W {_fingers('TIMRP')}"),
    "interhand": PointOrder("InterHand2.6M's", f"{_fingers('TIMRP', '4321')} W"),
    "rhd": PointOrder("RHD's", f"W {_fingers('TIMRP', '4321')}"),
    "mano": PointOrder("that of MANO's joints, then tips", f"{_MANO} {_fingers('TIMRP', '4')}"),
    "mano-tips": PointOrder("that of MANO's joints, then tips", f"{_MANO} {_fingers('IMPRT', '4')}"),
    "aria": PointOrder(
        "Aria's", f"{_fingers('TIMRP', '4')} W T2 T3 {_fingers('IMRP', '123')} -"
    ),
    "umetrack": PointOrder(
        "UmeTrack's", f"{_fingers('TIMRP', '4')} W T2 T3 {_fingers('IMRP', '123')}"
    ),
    "bighand": PointOrder(
        "BigHand2.2M's (FPHA)", f"W {' '.join(f + '1' for f in 'TIMRP')} {_fingers('TIMRP', '234')}"
    ),
    "joints": PointOrder("joint by joint", "W " + " ".join(_fingers("TIMRP", j) for j in "1234")),
    "stb": PointOrder("STB's", f"W {_fingers('PRMIT')}"),
    "msra": PointOrder("MSRA's", f"W {_fingers('IMRPT')}"),
    "without-wrist": PointOrder("fingers without a wrist", _fingers("TIMRP")),
}  # fmt: skip
"""The known orders by their names on the command line, the likeliest first"""


def _sides(left: Sequence[int], right: Sequence[int]) -> Mapping[Side, Sequence[int]]:
    return {"left": left, "right": right}


WHOLE_BODIES: Final = {
    135: _sides((9, *range(25, 45)), (10, *range(45, 65)))  # OpenPose's, whose wrists are the body's
} | {
    count: _sides(range(left, left + 21), range(right, right + 21))
    for count, left, right in (
        (42, 0, 21),  # both hands
        (59, 17, 38),  # COCO's body
        (60, 18, 39),  # OpenPose's older body
        (65, 23, 44),  # COCO's body with feet
        (67, 25, 46),  # OpenPose's body
        (75, 33, 54),  # MediaPipe Holistic, without a face
        (130, 88, 109),  # an older body of OpenPose and a face
        (133, 91, 112),  # COCO-WholeBody
        (134, 92, 113),  # DWPose
        (136, 94, 115),  # Halpe
        (137, 95, 116),  # OpenPose's body and a face
        (543, 468, 522),  # MediaPipe Holistic: face, left hand, body, right hand
        (553, 54, 33),  # FreeMoCap 1: body, right hand, left hand, face
    )
}
"""For each number of points of a whole body, the places of its hands, which are in MediaPipe's order"""
BODIES: Final = frozenset((14, 15, 16, 17, 18, 19, 23, 25, 26, 33, 68, 70, 468, 478))
"""The numbers of points that bodies and faces without hands have"""
HANDS: Final = frozenset(order.count for order in ORDERS.values())
"""The numbers of points that hands have"""


def width_of(numbers: int, widths: Iterable[int]) -> int:
    """Return which of these widths, the numbers that stand for one point, divides a row of so many numbers
    into a hand or body; 0 where none does."""
    for counts in (HANDS, WHOLE_BODIES, BODIES):
        for width in sorted(widths):
            if numbers % width == 0 and numbers // width in counts:
                return width
    return 0


@lru_cache(maxsize=1)
def _open_hand() -> np.ndarray:
    """Return (21, 3) metres: the keypoints of the flat right hand."""
    zero = np.zeros((1, 3))
    return np.asarray(load_model(None, "right").keypoints(None, zero, np.zeros((1, 45)), zero)[0])


def _length(points: np.ndarray) -> float:
    """Return the length from the wrist to the middle finger's tip, in the points' unit, of a relaxed hand
    whose points (N, K, D) reach as far as these."""
    middle = np.nanmean(points, axis=1, keepdims=True)
    reach = np.sqrt(np.nanmean(np.square(points - middle).sum(axis=-1), axis=1))
    return 2.6 * float(np.nanpercentile(reach, 90.0))


def _off_in_space(points: np.ndarray) -> np.ndarray:
    """Return (N,) how far hands (N, 21, 3) are off hands with the open hand's bones, whose palm is rigid and
    whose fingers bend as joints can: RMS over the points. NaN for a hand without a palm."""
    rest, parents = _open_hand(), np.array(KEYPOINT_PARENTS)
    ours = np.linalg.norm(rest - rest[parents], axis=-1)
    bones = points - points[:, parents]
    lengths = np.linalg.norm(bones, axis=-1)
    there = np.isfinite(lengths[:, 1:])
    scale = np.nanmedian(np.nansum(lengths[:, 1:], axis=1) / np.maximum((ours[1:] * there).sum(axis=1), 1e-9))
    # Hands differ, and so do programs in where on a joint its point lies.
    usual = scale * ours
    ours = np.clip(np.nan_to_num(np.nanmedian(lengths, axis=0), nan=0.0), usual / _DIFFER, usual * _DIFFER)
    palm = points[:, _PALM]
    middle = palm.mean(axis=1, keepdims=True)
    flat = scale * (rest[_PALM] - rest[_PALM].mean(axis=0))
    fitted = np.full_like(points, np.nan)
    best = np.full(len(points), np.inf)
    for mirrored in (1.0, -1.0):
        theirs = np.broadcast_to(flat * [mirrored, 1.0, 1.0], palm.shape)
        laid = theirs @ np.swapaxes(laid_over(theirs, palm - middle)[0], 1, 2) + middle
        off = np.square(laid - palm).sum(axis=(1, 2))
        fitted[:, _PALM] = np.where((off < best)[:, None, None], laid, fitted[:, _PALM])
        best = np.fmin(best, off)
    ways = bones / np.maximum(lengths, 1e-9)[..., None]
    ways[:, [5, 9, 13, 17]] = fitted[:, [5, 9, 13, 17]] - fitted[:, :1]
    ways /= np.maximum(np.linalg.norm(ways, axis=-1, keepdims=True), 1e-9)
    for point in range(1, NUM_KEYPOINTS):
        parent = parents[point]
        if point in _PALM:
            continue
        start, way = fitted[:, parent], ways[:, point]
        if parent > 0 and point != 2:
            way = ways[:, point] = _bent(ways[:, parent], way)
        # A joint that the file lacks, such as the thumb's first one, is no reason to lack the next ones.
        fitted[:, point] = start + ours[point] * way
        lost = ~np.isfinite(fitted[:, point]).all(axis=-1) & np.isfinite(points[:, point]).all(axis=-1)
        fitted[lost, point] = points[lost, point]
    return np.sqrt(np.nanmean(np.square(fitted - points).sum(axis=-1), axis=1))


def _bent(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return directions (N, 3) of bones; one that is bent farther from the bone `before` it than joints bend
    is turned back to that bound."""
    along = (before * after).sum(axis=-1, keepdims=True)
    across = after - along * before
    across /= np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-9)
    most = np.cos(_MOST_BENT) * before + np.sin(_MOST_BENT) * across
    return np.where(along < np.cos(_MOST_BENT), most, after)


def _off_in_plane(points: np.ndarray) -> np.ndarray:
    """Return (N,) how far hands (N, 21, 2) are off hands as they lie in pictures (`Plane`): RMS over the
    points."""
    plane = lifter().plane
    sure = np.isfinite(points).all(axis=-1)
    pull = plane.covariance @ np.linalg.inv(plane.covariance + _PLANE**2 * np.eye(len(plane.mean)))
    found = []
    for left in (False, True):
        seen = canonical_plane(plane, points, sure.astype(float), np.full(len(points), left))
        there = seen.fused[..., :2].reshape(len(points), -1) - plane.mean
        off = (there - there @ pull.T).reshape(points.shape)
        off[~sure] = np.nan
        found.append(np.sqrt(np.nanmean(np.square(off).sum(axis=-1), axis=1)) * seen.size)
    return np.fmin(*found)


def errors(points: np.ndarray) -> dict[str, float]:
    """Return how far off each order of that many points is for hands (N, K, 3), or (N, K, 2) in the plane, in
    parts of the hand's length; orders of which nothing can be said are left out."""
    off = _off_in_space if points.shape[-1] == 3 else _off_in_plane
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        length = _length(points)
        if not length > 1e-6 * np.nanmax(np.abs(points), initial=0.0):
            return {}
        every = {
            name: float(np.nanmedian(off(order.of(points)))) / length
            for name, order in ORDERS.items()
            if order.count == points.shape[1]
        }
    return {name: error for name, error in every.items() if np.isfinite(error)}


def order_by_bones(points: np.ndarray, *, in_space: bool, parts: bool) -> tuple[str, str]:
    """Return the name of the order of hands (N, K, 3) and a phrase about it. `in_space`: whether z is as good
    as x and y; `parts`: whether x and y are parts of pictures of unknown shape. Raises ValueError where none
    fits."""
    hands = points[np.isfinite(points[..., :2]).all(axis=-1).sum(axis=1) >= min(12, points.shape[1])]
    hands = hands[:: max(1, len(hands) // _LOOKED_AT)]
    shapes = (1.0, 16.0 / 9.0, 9.0 / 16.0) if parts and not in_space else (1.0,)
    found: dict[str, float] = {}
    for shape in shapes if len(hands) else ():
        for name, error in errors(hands if in_space else hands[..., :2] * [shape, 1.0]).items():
            found[name] = min(error, found.get(name, np.inf))
    usual = next((name for name, order in ORDERS.items() if order.count == points.shape[1]), "")
    if not found and points.shape[1] != NUM_KEYPOINTS:
        raise ValueError(f"which points its {points.shape[1]} are cannot be told; --order decides")
    if not found:
        return usual, "the order of its points cannot be told, as too few are there: MediaPipe's"
    best, *others = sorted(found, key=lambda name: (found[name] * (1.0 if name == usual else 1.1), name))
    off = {name: f"{name} {100 * error:.0f} %" for name, error in found.items()}
    if found[best] > LARGEST_ERROR:
        raise ValueError(
            f"its points are in no order that is known, of which {best} fits best; --order decides (parts of "
            f"the hand that they are off: {', '.join(off[name] for name in (best, *others))})"
        )
    next_best = f"; next {off[others[0]]}" if others else ""
    said = f"the order of its points is {ORDERS[best].title}, as the bones tell: {off[best]} of the hand off"
    return best, said + next_best
