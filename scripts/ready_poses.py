"""The add-on's ready poses, made from a table of joint angles and of what touches what.

`python scripts/ready_poses.py` writes `handfit_core/hand_model/data/poses.npz` anew; `--sheet FILE` draws
those that are in it. A pose is the one nearest to the table's in which skin meets where it should, and no
part stands in another (`hand_model/surface.py`), within the active ranges of a right hand.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from scipy.optimize import least_squares

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from handfit_core.hand_model.anatomy import relaxed_pose
from handfit_core.hand_model.drawing import colored, drawn_pose
from handfit_core.hand_model.poses import FILE, ready_poses
from handfit_core.hand_model.surface import PAIRS, surface_of
from handfit_core.skeleton import FINGER_JOINTS, FINGERS
from scripts.benchmark.kinematics import hand_pose_from_angles, model_of, right_axes, right_limits
from scripts.benchmark.poses import DIP, FAN, LONG

Bend = tuple[float, float] | tuple[float, float, float]
"""Degrees of knuckle and middle joint; the last joint follows them unless it is given"""

STRAIGHT, CURLED, ROD, LOOSE = (0.0, 3.0), (82.0, 98.0), (62.0, 86.0), (52.0, 62.0)
TUCKED = (84.0, 80.0)
"""Over a thumb"""


@dataclass(frozen=True)
class Spot:
    """A place on the skin."""

    finger: str
    bone: int
    """0 to 2, from the knuckle on; the thumb's own root counts"""
    side: str = "palm"
    """"palm", "back", "thumb" or "little", as the flat hand lies"""
    along: float = 0.6
    """0 to 1, towards the fingertip"""


@dataclass(frozen=True)
class Ready:
    """A line of the table."""

    name: str
    fingers: tuple[Bend, ...]
    """Index, middle, ring and little finger"""
    thumb: tuple[float, float, float, float]
    """Degrees: the root's bend and spread, then the other two bends"""
    fan: float = 0.0
    """Degrees by which the index finger is spread"""
    touches: tuple[tuple[Spot, Spot], ...] = ()
    last: tuple[str, ...] = ("thumb",)
    """What closes last"""
    spreads: tuple[float, ...] = ()
    """Degrees of the four fingers, in place of `fan`; towards the thumb is positive"""
    turned: float = 25.0
    """Degrees from which the preview shows it; see `drawn_pose`"""


def pad(finger: str, along: float = 0.6) -> Spot:
    """Of a fingertip."""
    return Spot(finger, 2, "palm", along)


def tips(*fingers: str) -> tuple[tuple[Spot, Spot], ...]:
    """The pads of these fingers on that of the thumb."""
    return tuple((pad(finger, 0.75), pad("thumb", 0.75)) for finger in fingers)


def thumb_on(finger: str, bone: int, side: str, along: float = 0.5) -> tuple[tuple[Spot, Spot], ...]:
    """The thumb's pad on another finger."""
    return ((pad("thumb"), Spot(finger, bone, side, along)),)


BESIDE, OUT, ACROSS, OPPOSED = (
    (16.0, -8.0, 4.0, 4.0),
    (-14.0, 10.0, -4.0, -6.0),
    (34.0, 8.0, 40.0, 40.0),
    (22.0, -4.0, 18.0, 26.0),
)
OVER = (20.0, 18.0, 46.0, 60.0)
CLENCHED = (
    (Spot("thumb", 2, "palm", 0.1), Spot("index", 1, "back", 0.8)),
    (Spot("thumb", 2, "palm", 0.7), Spot("middle", 1, "back", 0.8)),
)
"""A thumb across index and middle finger"""

TABLE: Final = (
    Ready("Flat", (STRAIGHT,) * 4, BESIDE, -13.0),
    Ready("Spread", ((-5.0, 2.0),) * 4, OUT, 17.0, turned=0.0),
    Ready(
        "Cupped",
        ((26.0, 22.0), (28.0, 24.0), (30.0, 24.0), (32.0, 24.0)),
        (14.0, -2.0, 8.0, 12.0),
        turned=-40.0,
    ),
    Ready("Claw", ((-4.0, 62.0, 42.0),) * 4, (0.0, 12.0, 22.0, 40.0), 12.0),
    Ready("Fist", (CURLED,) * 4, OVER, touches=CLENCHED),
    Ready(
        "Loose Fist",
        (LOOSE, (58.0, 66.0), (62.0, 68.0), (66.0, 68.0)),
        ACROSS,
        touches=thumb_on("index", 1, "back", 0.8),
    ),
    Ready("Point", (STRAIGHT, CURLED, CURLED, CURLED), OVER, touches=thumb_on("middle", 1, "back", 0.5)),
    Ready("Thumbs Up", (CURLED,) * 4, (-6.0, 2.0, -8.0, -14.0), turned=45.0),
    Ready("Gun", (STRAIGHT, STRAIGHT, CURLED, CURLED), (-10.0, 4.0, -8.0, -12.0), -13.0),
    Ready("Horns", (STRAIGHT, CURLED, CURLED, STRAIGHT), OVER, 6.0, thumb_on("middle", 1, "back", 0.6)),
    Ready("I Love You", (STRAIGHT, CURLED, CURLED, STRAIGHT), OUT, 10.0),
    Ready("Three", (STRAIGHT, STRAIGHT, CURLED, CURLED), OUT, 14.0),
    Ready("Four", ((-4.0, 2.0),) * 4, ACROSS, 13.0, turned=0.0),
    Ready(
        "Pinch",
        ((46.0, 48.0), (36.0, 40.0), (34.0, 38.0), (32.0, 36.0)),
        OPPOSED,
        3.0,
        tips("index"),
        turned=-55.0,
    ),
    Ready(
        "Pinch Middle",
        ((20.0, 26.0), (50.0, 52.0), (34.0, 40.0), (28.0, 34.0)),
        OPPOSED,
        3.0,
        tips("middle"),
        turned=-55.0,
    ),
    Ready(
        "Pinch Two",
        ((50.0, 44.0), (52.0, 46.0), (48.0, 52.0), (46.0, 52.0)),
        OPPOSED,
        0.0,
        tips("index", "middle"),
        turned=-55.0,
    ),
    Ready(
        "Pinch All",
        ((56.0, 34.0), (58.0, 38.0), (62.0, 34.0), (70.0, 34.0)),
        OPPOSED,
        -10.0,
        (*tips("index", "middle", "ring"), (pad("little", 0.8), Spot("ring", 2, "little", 0.7))),
        turned=-55.0,
    ),
    Ready(
        "Key Pinch",
        ((56.0, 72.0), (62.0, 78.0), (66.0, 80.0), (70.0, 80.0)),
        BESIDE,
        0.0,
        thumb_on("index", 1, "thumb", 0.6),
        turned=45.0,
    ),
    Ready(
        "Rod Grip",
        (ROD,) * 4,
        (26.0, 10.0, 26.0, 34.0),
        touches=thumb_on("index", 2, "back", 0.4),
        turned=45.0,
    ),
    Ready(
        "Glass Grip",
        ((34.0, 42.0), (38.0, 42.0), (40.0, 42.0), (42.0, 40.0)),
        (24.0, 8.0, 8.0, 20.0),
        4.0,
        turned=-55.0,
    ),
    Ready(
        "Ball Grip", ((14.0, 36.0), (18.0, 36.0), (18.0, 36.0), (18.0, 38.0)), (12.0, 14.0, 4.0, 18.0), 14.0
    ),
    Ready(
        "Pen Grip",
        ((44.0, 44.0), (50.0, 56.0), (58.0, 66.0), (62.0, 66.0)),
        OPPOSED,
        0.0,
        (*tips("index"), *thumb_on("middle", 2, "thumb", 0.5)),
        turned=-45.0,
    ),
    Ready("Hook Grip", ((10.0, 84.0), (12.0, 86.0), (14.0, 86.0), (16.0, 84.0)), BESIDE, turned=60.0),
    Ready(
        "Plate Grip",
        ((62.0, 6.0), (64.0, 6.0), (64.0, 6.0), (64.0, 8.0)),
        (34.0, 16.0, -6.0, -4.0),
        -4.0,
        turned=-60.0,
    ),
    Ready(
        "Trigger",
        ((30.0, 52.0), ROD, ROD, ROD),
        (22.0, 8.0, 22.0, 24.0),
        touches=thumb_on("middle", 1, "thumb", 0.6),
        turned=60.0,
    ),
    Ready(
        "Typing",
        ((24.0, 38.0), (28.0, 42.0), (28.0, 40.0), (24.0, 36.0)),
        (4.0, 6.0, 4.0, 10.0),
        5.0,
        turned=-40.0,
    ),
    Ready("Letter A", (CURLED,) * 4, BESIDE, touches=thumb_on("index", 1, "thumb", 0.3), turned=0.0),
    Ready("Letter B", (STRAIGHT,) * 4, ACROSS, -13.0, turned=0.0),
    Ready(
        "Letter C",
        ((28.0, 46.0), (30.0, 46.0), (30.0, 46.0), (30.0, 46.0)),
        (22.0, 14.0, 0.0, 20.0),
        -5.0,
        turned=-60.0,
    ),
    Ready(
        "Letter D",
        (STRAIGHT, (50.0, 58.0), (54.0, 60.0), (60.0, 66.0)),
        OPPOSED,
        0.0,
        tips("middle", "ring"),
        turned=45.0,
    ),
    Ready(
        "Letter E",
        ((30.0, 96.0, 60.0),) * 4,
        ACROSS,
        turned=0.0,
        touches=(
            (Spot("index", 2, "palm", 0.95), Spot("thumb", 1, "back", 0.9)),
            (Spot("middle", 2, "palm", 0.95), Spot("thumb", 2, "back", 0.5)),
        ),
        last=LONG,
    ),
    Ready(
        "Letter F", ((46.0, 50.0), STRAIGHT, STRAIGHT, STRAIGHT), OPPOSED, 12.0, tips("index"), turned=-30.0
    ),
    Ready(
        "Letter G, Q",
        ((34.0, 6.0), CURLED, CURLED, CURLED),
        (4.0, 0.0, 0.0, 0.0),
        turned=50.0,
        touches=thumb_on("middle", 1, "thumb", 0.3),
    ),
    Ready(
        "Letter H, U",
        (STRAIGHT, STRAIGHT, CURLED, CURLED),
        ACROSS,
        -13.0,
        thumb_on("ring", 1, "back", 0.4),
        turned=0.0,
    ),
    Ready("Letter I", (CURLED, CURLED, CURLED, STRAIGHT), OVER, touches=CLENCHED, turned=0.0),
    Ready(
        "Letter K, P",
        (STRAIGHT, (36.0, 6.0), CURLED, CURLED),
        (12.0, 18.0, 10.0, 6.0),
        6.0,
        thumb_on("middle", 0, "thumb", 0.9),
        turned=40.0,
    ),
    Ready("Letter L", (STRAIGHT, CURLED, CURLED, CURLED), OUT, turned=0.0),
    Ready(
        "Letter M",
        (TUCKED, TUCKED, TUCKED, CURLED),
        ACROSS,
        0.0,
        thumb_on("ring", 1, "palm", 0.3),
        LONG,
        turned=0.0,
    ),
    Ready(
        "Letter N",
        (TUCKED, TUCKED, CURLED, CURLED),
        ACROSS,
        last=LONG,
        turned=0.0,
        touches=(
            (Spot("thumb", 1, "back", 0.8), Spot("index", 1, "palm", 0.5)),
            (Spot("thumb", 2, "back", 0.5), Spot("middle", 1, "palm", 0.5)),
        ),
    ),
    Ready(
        "Letter O",
        ((46.0, 46.0), (48.0, 48.0), (50.0, 48.0), (52.0, 48.0)),
        OPPOSED,
        -2.0,
        tips("index", "middle"),
        turned=-60.0,
    ),
    Ready(
        "Letter R",
        ((12.0, 6.0), (-8.0, 16.0), CURLED, CURLED),
        ACROSS,
        0.0,
        thumb_on("ring", 1, "back", 0.3),
        spreads=(-14.0, 14.0, 0.0, 0.0),
        turned=0.0,
    ),
    Ready("Letter S", (CURLED,) * 4, OVER, touches=thumb_on("index", 1, "back", 0.9), turned=0.0),
    Ready(
        "Letter T",
        (TUCKED, CURLED, CURLED, CURLED),
        ACROSS,
        0.0,
        thumb_on("index", 1, "palm", 0.3),
        LONG,
        turned=0.0,
    ),
    Ready(
        "Letter V",
        (STRAIGHT, STRAIGHT, CURLED, CURLED),
        ACROSS,
        17.0,
        thumb_on("ring", 1, "back", 0.4),
        turned=0.0,
    ),
    Ready(
        "Letter W",
        (STRAIGHT, STRAIGHT, STRAIGHT, (60.0, 56.0)),
        ACROSS,
        15.0,
        tips("little"),
        ("thumb", "little"),
        turned=0.0,
    ),
    Ready(
        "Letter X",
        ((12.0, 88.0, 50.0), CURLED, CURLED, CURLED),
        OVER,
        touches=thumb_on("middle", 1, "back", 0.4),
    ),
    Ready("Letter Y", (CURLED, CURLED, CURLED, STRAIGHT), OUT, 14.0, turned=0.0),
)

_SIGMAS: Final = np.radians([2.0, 4.0, 12.0])
"""How far twist, spread and bend may be from the table's"""
_MEET, _CUT, _LEFT = 0.002, 0.0004, 0.0008
"""metres: how near skin is to be that meets; how much a cut beyond the last of these counts"""
_THUMBS_TRIED: Final = 600
_STEP: Final = 1e-4
_PREVIEW: Final = 128
"""Pixels of a preview's side"""
_COARSE: Final = 3
"""Levels of light that become one, which halves the file; 255 is one of them"""


def solved(ready: Ready) -> np.ndarray:
    """(45,) radians of a right hand."""
    model, limits = model_of("right"), right_limits()
    surface = surface_of(model)
    wanted = np.clip(_angles(ready), limits.lower, limits.upper)
    spots = np.array([[_vertex(spot) for spot in touch] for touch in ready.touches], dtype=int).reshape(-1, 2)
    sigmas = np.broadcast_to(_SIGMAS, (15, 3)).copy()
    moving = {*ready.last, "thumb", *(first.finger for first, _ in ready.touches)}
    for finger, joints in FINGER_JOINTS.items():
        rows = [j - 1 for j in joints]
        sigmas[rows[1:], :2] = np.radians(1.0)
        sigmas[rows] *= 1.0 if finger in moving else 0.4
    thumb = [j - 1 for j in FINGER_JOINTS["thumb"]]
    sigmas[thumb[0]] = np.radians([4.0, 12.0, 14.0])
    every = np.arange(len(PAIRS))

    def residuals(angles: np.ndarray) -> np.ndarray:
        """(B, 45) -> (B, M)"""
        pose = hand_pose_from_angles(angles.reshape(-1, 15, 3), "right")
        count, zero = len(pose), np.zeros((len(pose), 3))
        capsules = surface.of(np.zeros((count, 10)), pose)
        gaps = surface.gaps(capsules, np.repeat(np.arange(count), len(PAIRS)), np.tile(every, count)).gap
        cuts = np.maximum(-gaps.reshape(count, -1) - _LEFT, 0.0) / _CUT
        parts = [(angles - wanted.ravel()) / sigmas.ravel(), cuts]
        if len(spots):
            points = model._skinned(spots.ravel(), None, zero, pose, zero)[0].reshape(count, -1, 2, 3)
            parts.append((points[:, :, 0] - points[:, :, 1]).reshape(count, -1) / _MEET)
        return np.concatenate(parts, axis=1)

    def jacobian(x: np.ndarray) -> np.ndarray:
        both = residuals(x + _STEP * np.concatenate([np.eye(45), -np.eye(45)]))
        return (both[:45] - both[45:]).T / (2.0 * _STEP)

    low, high = limits.lower.ravel(), limits.upper.ravel()
    starts = [wanted.ravel()]
    if ready.touches:
        rng = np.random.default_rng(0)
        trials = np.repeat(wanted[None], _THUMBS_TRIED, axis=0)
        trials[:, thumb] = rng.uniform(limits.lower[thumb], limits.upper[thumb], (_THUMBS_TRIED, 3, 3))
        trials[:, thumb[1:], :2] = 0.0
        trials = trials.reshape(-1, 45)
        cost = np.minimum(residuals(trials) ** 2, 400.0).sum(axis=1)
        starts += list(trials[np.argsort(cost)[:4]])
    if ready.last != ("thumb",):
        opened = [s.reshape(15, 3).copy() for s in starts]
        rows = [j - 1 for f in ready.last for j in FINGER_JOINTS[f] if f != "thumb"]
        for start in opened:
            start[rows, 2] *= 0.35
        starts += [s.ravel() for s in opened]
    found = [
        least_squares(
            lambda x: residuals(x[None])[0],
            np.clip(start, low + 1e-6, high - 1e-6),
            jacobian,  # type: ignore[arg-type]
            bounds=(low, high),
            max_nfev=40,
        )
        for start in starts
    ]
    best = min(found, key=lambda one: one.cost)
    return hand_pose_from_angles(best.x.reshape(15, 3), "right")


def _angles(ready: Ready) -> np.ndarray:
    angles = np.zeros((15, 3))
    bends = {finger: _followed(finger, bend) for finger, bend in zip(LONG, ready.fingers, strict=True)}
    spreads = dict(zip(LONG, ready.spreads, strict=False)) or {f: ready.fan * FAN[f] for f in LONG}
    root, spread, second, third = ready.thumb
    for finger, bend in {**bends, "thumb": (root, second, third)}.items():
        rows = [j - 1 for j in FINGER_JOINTS[finger]]
        angles[rows, 2] = bend
        angles[rows[0], 1] = {**spreads, "thumb": spread}[finger]
    return np.radians(angles)


def _followed(finger: str, bend: Bend) -> tuple[float, float, float]:
    if len(bend) == 3:
        return bend
    slope, offset = DIP[finger]
    return (*bend, max(slope * bend[1] + offset, 0.3 * bend[1]))


def _vertex(spot: Spot) -> int:
    """The vertex of the flat hand that is nearest to where the spot's own line out of the bone leaves it."""
    model = model_of("right")
    shaped, joints = model.shaped(), FINGER_JOINTS[spot.finger]
    joint = joints[spot.bone]
    ends = [*shaped.joints[list(joints[1:])], shaped.tips[FINGERS.index(spot.finger)]]
    _, back, bend = right_axes()[joint - 1].T
    little = bend if bend[2] < 0.0 else -bend  # the right hand's thumb lies towards +z
    out = {"palm": -back, "back": back, "thumb": -little, "little": little}[spot.side]
    here = shaped.joints[joint] + spot.along * (ends[spot.bone] - shaped.joints[joint])
    owned = np.flatnonzero(model.weights.argmax(axis=1) == joint)
    off = shaped.vertices[owned] - here
    outwards = off @ out
    aside = np.linalg.norm(off - outwards[:, None] * out, axis=1)
    return int(owned[np.argmin(aside - 0.3 * outwards + 1.0 * (outwards < 0.0))])


def sheet(names: list[str], poses: np.ndarray, views: list[float], size: int, columns: int) -> np.ndarray:
    """RGB: every pose from all views, with its name."""
    cells = []
    for name, pose in zip(names, poses, strict=True):
        row = colored(np.concatenate([drawn_pose(model_of("right"), pose, size, v) for v in views], axis=1))
        alpha = row[..., 3:] / 255.0
        cell = (row[..., :3] * alpha + 58.0 * (1.0 - alpha)).astype(np.uint8)
        cell = np.concatenate([cell, np.full((24, cell.shape[1], 3), 40, np.uint8)])
        cv2.putText(
            cell, name, (6, cell.shape[0] - 7), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (235,) * 3, 1, cv2.LINE_AA
        )
        cells.append(np.pad(cell, ((2, 2), (2, 2), (0, 0)), constant_values=25))
    while len(cells) % columns:
        cells.append(np.full_like(cells[0], 25))
    return np.concatenate(
        [np.concatenate(cells[i : i + columns], axis=1) for i in range(0, len(cells), columns)]
    )


def main() -> None:
    """Make the data file, and the picture of all of it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--sheet", type=Path, metavar="FILE", help="draw the poses of the file that is there, and make none"
    )
    parser.add_argument(
        "--turned", type=float, nargs="+", default=[0.0, 60.0], metavar="DEG", help="sides to draw them from"
    )
    parser.add_argument("--size", type=int, default=220, metavar="PX", help="width of one drawing")
    parser.add_argument("--columns", type=int, default=4)
    arguments = parser.parse_args()
    if arguments.sheet:
        ready = ready_poses()
        poses = np.array([one.pose.hand_pose for one in ready.values()])
        picture = sheet(list(ready), poses, arguments.turned, arguments.size, arguments.columns)
        cv2.imwrite(str(arguments.sheet), picture[..., ::-1], [cv2.IMWRITE_WEBP_QUALITY, 85])
        return
    model = model_of("right")
    names, turned = ["Relaxed", *(r.name for r in TABLE)], [25.0, *(r.turned for r in TABLE)]
    poses = np.array([relaxed_pose(model), *map(solved, TABLE)], dtype=np.float32)
    drawn = np.array([drawn_pose(model, pose, _PREVIEW, v) for pose, v in zip(poses, turned, strict=True)])
    np.savez_compressed(FILE, names=np.array(names), hand_poses=poses, drawn=drawn // _COARSE * _COARSE)
    print(f"{FILE.relative_to(ROOT)}: {len(names)} poses, {FILE.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
