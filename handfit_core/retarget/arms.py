"""A captured arm on a character's: every frame at once.

Only the directions of upper arm and forearm are taken over, from the shoulder on, so that a hand goes where
it is relative to the body whatever the character's size. They are told in the axes of a body that faces -Y,
with its left at +X, which are laid over the character's own: its shoulders' line, and its vertical. The
capture's vertical is the camera's; about it the capture is turned until the line from the right shoulder to
the left one, averaged over the clip, points to +X, but for 20 degrees, since so much of it may be wrong.
Where one arm was captured alone, its body counts as facing the camera.

A bone's rotation from rest `R` lays the frame of its direction and of the elbow's axis at rest over the same
two of the captured arm. It is told relative to the chest, which carries it along.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from handfit_core.common.skeleton import Side
from handfit_core.geometry.rotations import (
    perpendicular,
    rotmat_to_quat,
    rotvec_to_rotmat,
    smoothstep,
    swings,
    units,
)
from handfit_core.hand_model.axes import MIRROR_X, points_to_world
from handfit_core.retarget.bones import Bones
from handfit_core.retarget.recognition import named_arm
from handfit_core.take import HandTrack, Take

_FACING_ERROR = np.radians(20.0)
"""radians: how far the line of two captured shoulders is likely to be off, seen from above. A body counts as
turned by the rest of the angle alone. In rendered clips of a person at 0, 0, 35, -35 and 60 degrees the lines
were 13 to 44 degrees off, median 18, and their part beyond this error 0 to 37, median 7"""
_STRAIGHT, _BENT = 0.1, 0.35
"""Sines of the elbow's bend, up to the first of which it does not tell where the elbow points, and from the
second of which on it does"""
_REST_BENT = 0.1
"""Sine of the elbow's bend at rest below which it does not tell the elbow's axis, so that the body's axes
do"""
_REST_STRAIGHT = 0.87
"""Least share of its length that an arm at rest reaches: elbows rest bent by 60 degrees at most"""
_TWIST_SHARE = 0.5
"""Share of the hand's twist that the forearm takes over, as the skin of a wrist cannot take all of it"""
_REACH = 0.9999
"""Largest share of an arm's length to which it is stretched"""
_UPRIGHT = 0.9
"""Cosine of the angle to an axis of the armature's space up to which that is taken for the vertical"""
THICKNESS = 0.15
"""Half of a hand's thickness, as a share of the way from its wrist to its knuckles"""
_SMOOTH_SECONDS = 0.15
"""seconds before and after, in which a hand that is kept outside a body is moved already, or still"""
_EDGE = 0.6
"""Share of a capsule's radius, from its axis on, up to which a hand before it is moved towards the camera
alone"""
_MIDLINE = 0.2
"""Share of the shoulders' distance, from the body's middle on, up to which a bone belongs to trunk or head"""
_TRUNK = (5.0, 95.0)
"""Percentiles of a bone's vertices between which its capsule reaches: thin things that stick out of bodies do
not count"""
_FEW = 0.004
"""Share of a body's vertices below which a bone moves too few of them to be a part of the body's shape"""


@dataclass(frozen=True, eq=False)
class CapturedArm:
    """The motion of a captured arm on N frames."""

    upper: np.ndarray
    """(N, 3) unit vectors from the shoulder to the elbow, in the axes of a body that faces -Y"""
    fore: np.ndarray
    """(N, 3) unit vectors from the elbow to the wrist, in the axes of a body that faces -Y"""
    present: np.ndarray
    """(N,) bool: true where there is an arm; elsewhere the directions lie between the nearest ones"""
    facing: np.ndarray
    """(3, 3) the turn about Z from the world in which the capture's camera stands to the axes of a body that
    faces -Y"""

    @classmethod
    def of(cls, take: Take, track: HandTrack, numbers: np.ndarray) -> CapturedArm | None:
        """Return the arm of a take's hand at N frame numbers, whole or not; None for a hand without an
        arm."""
        arm = track.arm
        if arm is None or not arm.present.any():
            return None
        own = take.frame_numbers.astype(np.float64)
        facing = _facing(take, track)
        there = arm.present

        def between(ends: np.ndarray) -> np.ndarray:
            along = points_to_world(units(ends[there])) @ facing.T
            return units(np.stack([np.interp(numbers, own[there], part) for part in along.T], axis=-1))

        after = np.clip(np.searchsorted(own, numbers), 0, len(own) - 1)
        before = np.clip(np.searchsorted(own, numbers, side="right") - 1, 0, len(own) - 1)
        upper, fore = between(arm.elbow - arm.shoulder), between(arm.wrist - arm.elbow)
        return cls(upper, fore, there[before] & there[after], facing)

    def turned(self, angle: float) -> CapturedArm:
        """Return the arm of a body that is turned by `angle` radians about Z."""
        turn = rotvec_to_rotmat(np.array([0.0, 0.0, angle]))
        return CapturedArm(self.upper @ turn.T, self.fore @ turn.T, self.present, turn @ self.facing)

    def mirrored(self) -> CapturedArm:
        """Return the arm of the other side, as a mirror at x = 0 shows it."""
        return CapturedArm(
            self.upper @ MIRROR_X, self.fore @ MIRROR_X, self.present, MIRROR_X @ self.facing @ MIRROR_X
        )

    def weights(self, frames: np.ndarray, ease: float) -> np.ndarray:
        """Return how much the arm counts on frames (N,), increasing: (N,) weights, 0..1. The arm comes and
        goes within `ease` frames; gaps of at most twice as many are bridged."""
        found = np.zeros(len(frames))
        rows = np.flatnonzero(self.present)
        for run in np.split(rows, np.flatnonzero(np.diff(frames[rows]) > max(2.0 * ease, 1.5)) + 1):
            if not len(run):
                continue
            first, last = frames[run[0]], frames[run[-1]]
            some = slice(run[0], run[-1] + 1)
            within = min(ease, 0.5 * (last - first))
            part = np.ones(some.stop - some.start)
            if within > 0.0:
                part = np.minimum(frames[some] - first, last - frames[some]) / within
            found[some] = smoothstep(part)
        return found


def _facing(take: Take, track: HandTrack) -> np.ndarray:
    """Return the turn (3, 3) about Z of the capture's world, by which the mean line of the shoulders, from
    the right one to the left, points to +X within the error that it has; the unit matrix where there is one
    arm."""
    line = np.zeros(3)
    for other in take.hands:
        if other.side != track.side and other.arm is not None and track.arm is not None:
            both = other.arm.present & track.arm.present
            if both.any():
                pair = {track.side: track.arm, other.side: other.arm}
                line = (pair["left"].shoulder - pair["right"].shoulder)[both].mean(axis=0)
                break
    x, y, _ = points_to_world(line)
    turned = np.arctan2(y, x)
    return rotvec_to_rotmat(np.array([0.0, 0.0, np.clip(turned, -_FACING_ERROR, _FACING_ERROR) - turned]))


@dataclass(frozen=True, eq=False)
class TargetArm:
    """A character's arm at rest, in the armature's space and units."""

    bones: tuple[str, str]
    """Names of the bones of upper arm and forearm"""
    chest: str
    """Name of the bone that carries the arm along: the bone from which both arms hang, or the nearest one
    above; may be empty"""
    joints: np.ndarray
    """(3, 3) the places of shoulder, elbow and wrist at rest, in rows"""
    hinge: np.ndarray
    """(3,) unit vector, the elbow's axis, about which a positive turn bends it"""
    body: np.ndarray
    """(3, 3) from the axes of a body that faces -Y to the armature's: left, back and up of the body in
    columns"""

    @property
    def lengths(self) -> np.ndarray:
        """(2,) the lengths of upper arm and forearm, in the armature's units."""
        return np.linalg.norm(np.diff(self.joints, axis=0), axis=-1)

    @property
    def rest(self) -> np.ndarray:
        """(2, 3) unit vectors along upper arm and forearm at rest."""
        return units(np.diff(self.joints, axis=0))

    def wrist_at(self, upper: np.ndarray, fore: np.ndarray) -> np.ndarray:
        """Return where the wrist is, seen from the shoulder, while upper arm and forearm point along `upper`
        and `fore` (N, 3): (N, 3) in the armature's units."""
        return self.lengths[0] * upper + self.lengths[1] * fore

    def normals(self, upper: np.ndarray, fore: np.ndarray) -> np.ndarray:
        """Return the elbow's axis (N, 3) while upper arm and forearm point along `upper` and `fore` (N, 3),
        perpendicular to both.

        Of an arm that is nearly straight it is the axis that the smallest turn from rest gives.
        """
        across = np.cross(upper, fore)
        sine = np.linalg.norm(across, axis=-1, keepdims=True)
        part = smoothstep((sine - _STRAIGHT) / (_BENT - _STRAIGHT))
        carried = (swings(self.rest[0], upper) @ self.hinge[:, None])[..., 0]
        carried = units(perpendicular(carried, upper))
        return units(part * across / np.maximum(sine, 1e-9) + (1.0 - part) * carried)

    def turned(self, upper: np.ndarray, fore: np.ndarray, hand: np.ndarray) -> np.ndarray:
        """Return how upper arm and forearm turn from rest, (N, 2, 3, 3), to point along `upper` and `fore`
        (N, 3), while the hand is turned by `hand` (N, 3, 3) from rest; all relative to the chest at rest."""
        normals = self.normals(upper, fore)
        turned = np.stack(
            [
                _frames(along, normals) @ _frames(rest, self.hinge).T
                for along, rest in zip((upper, fore), self.rest, strict=True)
            ],
            axis=1,
        )
        quats = rotmat_to_quat(hand @ np.swapaxes(turned[:, 1], -1, -2))
        twist = 2.0 * np.arctan2(np.sum(quats[:, 1:] * fore, axis=-1), quats[:, 0])
        twist = (twist + np.pi) % (2.0 * np.pi) - np.pi
        # None is left where a twist of half a turn would change its sign.
        share = _TWIST_SHARE * twist * np.cos(0.5 * twist)
        turned[:, 1] = rotvec_to_rotmat(share[:, None] * fore) @ turned[:, 1]
        return turned

    def reaching(self, wrists: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the directions of upper arm and forearm, (N, 3) each, that have the wrist at `wrists` (N, 3)
        from the shoulder, or as near as it gets, with the elbow's axis as near `normals` (N, 3) as it
        gets."""
        first, second = self.lengths
        way = np.linalg.norm(wrists, axis=-1, keepdims=True)
        along = wrists / np.maximum(way, 1e-9)
        way = np.clip(way, abs(first - second) / _REACH, _REACH * (first + second))
        cosine = np.clip((first**2 + way**2 - second**2) / (2.0 * first * way), -1.0, 1.0)
        aside = units(np.cross(along, normals))
        upper = cosine * along + np.sqrt(1.0 - cosine**2) * aside
        return upper, units(way * along - first * upper)


def target_arm(
    bones: Bones, side: Side, hand: str, other: str | None, upright: np.ndarray
) -> TargetArm | None:
    """Find the arm on which the hand's bone of that side hangs; None where it hangs on none.

    `other` is the bone of the character's other hand, None where it has none; `upright` (3, 3) holds the
    world's axes in the armature's space, for characters with one arm.
    """
    second_hand = bones.index[other] if other else None
    own = _arm_above(bones, bones.index[hand], second_hand)
    if own is None:
        return None
    upper, fore = own
    shoulder = bones.heads[upper]
    body, chest = upright, int(bones.parents[upper])
    second = _arm_above(bones, second_hand, bones.index[hand]) if second_hand is not None else None
    common = bones.holding([upper, second[0]]) if second is not None else None
    if second is not None and second[0] != upper and common is not None:
        chest = common
        line = (shoulder - bones.heads[second[0]]) * (1.0 if side == "left" else -1.0)
        body = _body_axes(bones, chest, line, 0.5 * (shoulder + bones.heads[second[0]]), upright)
    joints = np.array([shoulder, bones.heads[fore], bones.heads[bones.index[hand]]])
    first, last = units(np.diff(joints, axis=0))
    across = np.cross(first, last)
    if np.linalg.norm(across) < _REST_BENT:
        across = np.cross(first, -body[:, 1])
        if np.linalg.norm(across) < _REST_BENT:  # an arm that is stretched out to the front
            across = np.cross(first, body[:, 2])
    names = bones.names
    return TargetArm(
        (names[upper], names[fore]),
        names[chest] if chest >= 0 else "",
        joints,
        units(perpendicular(across, first)),
        body,
    )


def _arm_above(bones: Bones, hand: int, other: int | None) -> tuple[int, int] | None:
    """Find upper arm and forearm among the bones above a hand, and not above the other one; None where there
    are none. By their names, else the two that make the longest parts of about the same length that are not
    bent by much, so that clavicles and a spine are passed over."""
    both = {*bones.ancestors(other)} if other is not None else set()
    chain = [bone for bone in bones.ancestors(hand) if bone not in both]
    named = named_arm([bones.names[bone] for bone in chain])
    if named is not None:
        return chain[named[0]], chain[named[1]]
    wrist, best, found = bones.heads[hand], 0.0, None
    for i, fore in enumerate(chain):
        for upper in chain[i + 1 :]:
            ends = [bones.heads[upper], bones.heads[fore], wrist]
            short, long = sorted(np.linalg.norm(np.diff(ends, axis=0), axis=-1))
            if short <= 0.5 * long or np.linalg.norm(ends[2] - ends[0]) < _REST_STRAIGHT * (short + long):
                continue
            # The shorter part, times the square of their ratio.
            if short**3 / long**2 > best:
                best, found = short**3 / long**2, (upper, fore)
    return found


def _body_axes(
    bones: Bones, chest: int, line: np.ndarray, middle: np.ndarray, upright: np.ndarray
) -> np.ndarray:
    """Return left, back and up of a body at rest, in columns (3, 3): across its shoulders' `line`, and up
    from the bone on which all others hang; an axis of the armature's space where one is near."""
    base = bones.heads[[chest, *bones.ancestors(chest)][-1]]
    up = middle - base
    if np.linalg.norm(up) < 0.1 * np.linalg.norm(line):
        up = upright[:, 2]
    up = units(up)
    axis = np.eye(3)[np.argmax(np.abs(up))] * np.sign(up[np.argmax(np.abs(up))])
    if up @ axis > _UPRIGHT:
        up = axis
    left = units(perpendicular(line, up))
    return np.stack([left, np.cross(up, left), up], axis=-1)


def swivel_angles(
    start: np.ndarray, hinge: np.ndarray, wrist: np.ndarray, along: np.ndarray, normals: np.ndarray
) -> np.ndarray:
    """Return the radians (N,) by which the upper arm is to turn about its own Y, so that an elbow that IK
    bends has the axes `normals` (N, 3).

    `start` (N, 3, 3) are the upper arm's axes before it turns, `hinge` and `wrist` (3,) the elbow's axis and
    where the wrist lies at rest, told in these axes; `along` (N, 3) is where the wrist is to lie from the
    shoulder. IK then turns the arm by the smallest rotation that takes its wrist there.
    """
    angles, wrist = np.zeros(len(start)), units(wrist)
    for _ in range(40):
        turned = start @ rotvec_to_rotmat(angles[:, None] * [0.0, 1.0, 0.0])
        back = swings((turned @ wrist[:, None])[..., 0], along)
        now = (back @ turned @ hinge[:, None])[..., 0]
        sine = np.sum(np.cross(now, normals) * along, axis=-1)
        angles += np.arctan2(sine, np.sum(now * normals, axis=-1))
    return (angles + np.pi) % (2.0 * np.pi) - np.pi


@dataclass(frozen=True, eq=False)
class Capsules:
    """Capsules around C parts of a body at rest, in the armature's space and units."""

    bones: tuple[str, ...]
    """Names of the bones that carry the capsules"""
    ends: np.ndarray
    """(C, 2, 3) both ends of the capsules' axes"""
    radii: np.ndarray
    """(C,) the capsules' radii"""

    @classmethod
    def of(cls, bones: Bones, points: np.ndarray, owners: np.ndarray, arm: TargetArm) -> Capsules:
        """Fit capsules of trunk and head to a mesh's vertices (V, 3) at rest, of which `owners` (V,) says the
        bone that moves each of them most, -1 for none.

        Each is as deep as its vertices are from front to back, and lies along the longer of their width and
        their height.
        """
        body = arm.body
        middle = bones.heads[bones.index[arm.chest]] @ body if arm.chest else np.zeros(3)
        width = 2.0 * abs(arm.joints[0] @ body - middle)[0]
        found: dict[str, tuple[np.ndarray, float]] = {}
        for owner in np.unique(owners[owners >= 0]).tolist():
            own = points[owners == owner] @ body
            aside = abs(bones.heads[owner] @ body - middle)[0]
            if len(own) < max(8, _FEW * len(points)) or aside > _MIDLINE * width:
                continue
            low, high = np.percentile(own, _TRUNK, axis=0)
            size, centre = high - low, 0.5 * (low + high)
            radius, axis = 0.5 * size[1], 0 if size[0] > size[2] else 2
            half = np.zeros(3)
            half[axis] = max(0.5 * size[axis] - radius, 0.0)
            found[bones.names[owner]] = np.stack([centre - half, centre + half]) @ body.T, radius
        ends = np.array([one for one, _ in found.values()]).reshape(-1, 2, 3)
        return cls(tuple(found), ends, np.array([radius for _, radius in found.values()]))


def kept_outside(
    points: np.ndarray, ends: np.ndarray, radii: np.ndarray, seconds: np.ndarray, camera: np.ndarray
) -> np.ndarray:
    """Return by how much K points (N, K, 3) of a hand are to be moved together on N frames, (N, 3), to lie
    outside of C capsules with `ends` (N, C, 2, 3) and `radii` (C,), and not behind them.

    A hand that a camera in the direction `camera` (3,) has seen lies before what is in line with it; how far
    away it is is what pictures tell worst. So it is moved towards the camera, or aside at a capsule's edge.
    `seconds` (N,) are the frames' times, increasing: a hand is moved away and comes back smoothly, and is
    never less far outside for that.
    """
    moved = _outwards(points, ends, radii, camera)
    far = np.linalg.norm(moved, axis=-1)
    if not far.any():
        return moved
    windows = [
        slice(*np.searchsorted(seconds, [at - 0.5 * _SMOOTH_SECONDS, at + 0.5 * _SMOOTH_SECONDS + 1e-9]))
        for at in seconds
    ]
    farthest = np.array([far[some].max() for some in windows])
    wide = np.array([moved[some].mean(axis=0) for some in windows])
    # Frames beside those in which the hand is moved go the same way as these.
    aims = units(np.array([wide[some].mean(axis=0) for some in windows]))
    smooth = np.array([farthest[some].mean() for some in windows])[:, None] * aims
    return smooth + _outwards(points + smooth[:, None], ends, radii, camera)


def _outwards(points: np.ndarray, ends: np.ndarray, radii: np.ndarray, camera: np.ndarray) -> np.ndarray:
    """Return the moves (N, 3) that take the points of a hand out of the capsules, each frame by itself."""
    moved, rows = np.zeros((len(points), 3)), np.arange(len(points))
    start, axis = ends[:, None, :, 0], (ends[:, :, 1] - ends[:, :, 0])[:, None]
    across = perpendicular(axis, camera)
    square = np.maximum(np.sum(across**2, axis=-1), 1e-12)
    for _ in range(20):
        away = (points + moved[:, None])[:, :, None] - start
        share = np.clip(np.sum(away * across, axis=-1) / square, 0.0, 1.0)
        away = away - share[..., None] * axis
        aside = perpendicular(away, camera)
        width = np.linalg.norm(aside, axis=-1)
        front = np.sqrt(np.maximum(radii**2 - width**2, 0.0)) - away @ camera
        part = smoothstep((width / radii - _EDGE) / (1.0 - _EDGE))[..., None]
        out = (1.0 - part) * front[..., None] * camera + part * (radii - width)[..., None] * units(aside)
        out = np.where(((width < radii) & (front > 0.0))[..., None], out, 0.0).reshape(len(points), -1, 3)
        largest = np.linalg.norm(out, axis=-1).argmax(axis=1)
        moved += out[rows, largest]
        if not out[rows, largest].any():
            break
    return moved


def _frames(along: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return axes as columns (..., 3, 3): the direction `along`, the axis perpendicular to it that is nearest
    to `normal`, and the one across both."""
    normal = units(perpendicular(np.broadcast_to(normal, along.shape), along))
    return np.stack([along, normal, np.cross(along, normal)], axis=-1)
