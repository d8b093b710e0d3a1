"""MANO's parameters of other programs, brought to ours: relative to the flat hand, in the camera frame.

What differs between programs: matrices or axis-angle, the mean pose added or not, coefficients of MANO's
principal directions, left hands as right ones in a mirror, worlds that are y-up or z-up, and bodies whose
wrists are given by the joints before them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final, Literal

import numpy as np

from handfit_core.common.arrays import LARGEST, array, array_dataclass
from handfit_core.common.batch import Batch, scatter, slices
from handfit_core.common.errors import OptionError
from handfit_core.common.skeleton import FINGER_JOINTS, NUM_BETAS, SIDES, Side
from handfit_core.common.values import Unfit
from handfit_core.detect.keypoints import check_crowd
from handfit_core.geometry.rotations import quat_to_rotvec, rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model.anatomy import anatomical_angles, anatomical_axes, joint_limits
from handfit_core.hand_model.axes import MIRROR_X, mirrored_pose
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.files import OPEN_HAND, load_model
from handfit_core.hand_model.motion import HandMotion
from handfit_core.interchange.recording import ReadOptions, known, usual_place
from handfit_core.interchange.skeletons import UP_AXES
from handfit_core.take import TAKE_LIMITS

POSE: Final = 45
"""Numbers of a hand's pose: three axis-angle numbers in radians for each of 15 joints"""

Counted = Literal["flat", "mean"]
"""The zero of poses: the flat hand, or the mean pose of MANO"""


def numbers(name: str, value: Any, *shape: int) -> np.ndarray:
    """Return (N, *shape) floats of an array or of nested lists, however its axes are split or joined: (1, T,
    15, 3) becomes (T, 45), too. Entries that are not finite become NaN. Raises Unfit."""
    wanted = "x".join(["N", *map(str, shape)])
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise Unfit(f"{name} must be numbers of the shape {wanted}") from None
    if math.prod(shape) not in [math.prod(array.shape[start:]) for start in range(array.ndim + 1)]:
        raise Unfit(f"{name} must have the shape {wanted}, not {'x'.join(map(str, array.shape))}")
    array = array.reshape(-1, *shape)
    if np.any(np.abs(array[np.isfinite(array)]) > LARGEST):
        raise Unfit(f"{name} holds numbers beyond {LARGEST:g}")
    return np.where(np.isfinite(array), array, np.nan)


def rotations(name: str, value: Any, joints: int, count: int | None = None) -> np.ndarray:
    """(N, 3 * joints) axis-angle in radians of a program's rotations: matrices (N, joints, 3, 3), axis-angle
    (N, joints, 3) or (N, 3 * joints), or a quaternion (N, 4), w first. `count`: the N that is expected.
    Raises Unfit, also for matrices that are no rotations and for angles in degrees."""
    try:
        shape = np.shape(value)
    except ValueError:
        shape = ()
    if joints == 1 and shape[-1:] == (4,):
        rotvec = quat_to_rotvec(numbers(name, value, 4))
    elif shape[-2:] == (3, 3) and not (joints == 1 and len(shape) == 2 and count == 3):
        matrices = checked_matrices(name, numbers(name, value, joints, 3, 3))
        parts = [rotmat_to_rotvec(matrices[part]) for part in slices(len(matrices))]
        rotvec = np.concatenate(parts).reshape(-1, 3 * joints)
    else:
        rotvec = numbers(name, value, 3 * joints)
    most = np.nanmax(np.linalg.norm(rotvec.reshape(-1, 3), axis=-1), initial=0.0)
    if most > 4.0 * np.pi:
        raise Unfit(f"{name} holds turns by {most:.0f} radians: these are degrees, or no axis-angle")
    if count is not None and len(rotvec) != count:
        raise Unfit(f"{name} has {len(rotvec)} rows where {count} are expected")
    return rotvec


def checked_matrices(name: str, matrices: np.ndarray) -> np.ndarray:
    """Return matrices (..., 3, 3) as they are after checking that they are rotations but for their rounding.
    Raises Unfit."""
    for part in slices(len(matrices)):
        told = matrices[part][np.isfinite(matrices[part]).all(axis=(-1, -2))]
        # What the elements of R R^T may differ from those of I
        off = np.abs(told @ np.swapaxes(told, -1, -2) - np.eye(3)).max(initial=0.0)
        if off > 0.05 or np.any(np.linalg.det(told) < 0.0):
            raise Unfit(f"{name} holds matrices that are no rotations")
    return matrices


def own_model(asked: ReadOptions, side: Side, needed: str) -> HandModel:
    """Load the user's MANO model of a side. Raises OptionError, with what is `needed` of it, where there is
    none, and HandModelError."""
    if asked.model is None or asked.model == OPEN_HAND:
        raise OptionError(
            f"{needed}: give your own MANO folder or file as the model (--model), as MANO's license keeps "
            "both out of this program"
        )
    return load_model(asked.model, side)


def from_directions(coefficients: np.ndarray, side: np.ndarray, asked: ReadOptions) -> np.ndarray:
    """Return (N, 45) axis-angle in radians of coefficients (N, C) of MANO's first C principal directions,
    without the mean pose; `side` (N,) has each hand's index in SIDES. Raises OptionError where the directions
    are not there."""
    needed = "these hand poses are coefficients of MANO's principal directions"
    pose = np.empty((len(side), POSE))
    for index in set(side.tolist()):
        directions = own_model(asked, SIDES[index], needed).hands_components[: coefficients.shape[1]]
        pose[side == index] = coefficients[side == index] @ directions
    return pose


def tell(assumed: list[str], phrase: str) -> None:
    """Add a phrase to a list unless it is there already."""
    if phrase not in assumed:
        assumed.append(phrase)


def standing(pelvis: np.ndarray, assumed: list[str]) -> np.ndarray:
    """Return the rotation (3, 3) to the camera frame from the world of a body of SMPL's family, by how the
    body stands.

    pelvis: (T, 3) axis-angle. In the rest pose such a body stands along +y.
    """
    along = rotvec_to_rotmat(pelvis[known(pelvis)])[:, :, 1]
    mean = along.mean(axis=0) if len(along) else np.array([0.0, 1.0, 0.0])
    ups = [(mean[1], "y-up", UP_AXES["y"]), (mean[2], "z-up", UP_AXES["z"])]
    ups.append((-mean[1], "the camera's, y-down", np.eye(3)))
    _, name, turn = max(ups, key=lambda up: up[0])
    tell(assumed, f"its world was taken to be {name}, as the body stands so")
    return turn


_TO_WRIST: Final[dict[Side, tuple[int, ...]]] = {
    "left": (3, 6, 9, 13, 16, 18, 20),
    "right": (3, 6, 9, 14, 17, 19, 21),
}
"""For each side, the joints from the pelvis, which is 0, to the wrist, in the order of SMPL, SMPL+H and
SMPL-X"""

BODY_JOINTS: Final = 21
"""Joints in the pose of a body of SMPL's family, without the pelvis and the hands"""


def wrist_of_body(pelvis: np.ndarray, body_pose: np.ndarray, side: Side) -> np.ndarray:
    """Return (T, 3) axis-angle in radians: how a body's wrist is turned in the world, which is MANO's
    global_orient.

    pelvis (T, 3) and body_pose (T, 63) axis-angle. Rotations need no body model, only the chain; hands of
    SMPL+H and SMPL-X have MANO's rest axes.
    """
    turned = rotvec_to_rotmat(pelvis)
    for joint in _TO_WRIST[side]:
        turned = turned @ rotvec_to_rotmat(body_pose[:, 3 * joint - 3 : 3 * joint])
    return rotmat_to_rotvec(turned)


@array_dataclass
class FoundHands(Batch):
    """N hands as a file has them, each in one frame, in the camera frame."""

    frame: np.ndarray = array("N", kind="i")
    side: np.ndarray = array("N", kind="i")
    """(N,) the index in SIDES of each hand's side"""
    person: np.ndarray = array("N", kind="i")
    """(N,) the number of each hand's person, counted for each side; -1 where the file does not say"""
    betas: np.ndarray = array("N", NUM_BETAS)
    """(N, 10) MANO's shape coefficients; NaN where the file does not tell"""
    global_orient: np.ndarray = array("N", 3)
    """(N, 3) axis-angle, radians: how each hand is turned about its wrist"""
    hand_pose: np.ndarray = array("N", POSE)
    """(N, 45) axis-angle, radians: the turns of the 15 finger joints"""
    transl: np.ndarray = array("N", 3)
    """(N, 3) metres: the translation of MANO's model; infinite where the file does not tell it"""

    def mirrored(self, *, places: bool) -> FoundHands:
        """Return the hands with each left hand, stored as the right one of a mirror at x = 0, mirrored back;
        `places`: whether the mirror takes the places along."""
        left = (self.side == SIDES.index("left"))[:, None]
        orient, pose = mirrored_pose(self.global_orient, self.hand_pose)
        return replace(
            self,
            global_orient=np.where(left, orient, self.global_orient),
            hand_pose=np.where(left, pose, self.hand_pose),
            transl=np.where(left, self.transl @ MIRROR_X, self.transl) if places else self.transl,
        )

    def turned(self, rotation: np.ndarray) -> FoundHands:
        """Return the hands in another frame, x_other = rotation x, with rotation (3, 3) or (N, 3, 3); their
        places stay as they are."""
        orient = rotmat_to_rotvec(rotation @ rotvec_to_rotmat(self.global_orient))
        return replace(self, global_orient=orient)

    def seen_from(self, rotation: np.ndarray, shift: np.ndarray, asked: ReadOptions) -> FoundHands:
        """Return the hands in a camera's frame: x_camera = rotation x + shift, with rotation (3, 3) or (N, 3,
        3), and shift (3,) or (N, 3) in metres.

        MANO's root turns about the wrist, which does not lie at the origin of the model: with J the wrist of
        the model, the new transl is R (J + transl) + t - J.
        """
        wrists = np.zeros_like(self.transl)
        for key in np.unique(np.stack([self.side, self.person]), axis=1).T:
            mine = (self.side == key[0]) & (self.person == key[1])
            model = load_model(asked.model, SIDES[key[0]])
            wrists[mine] = model.shaped(shape_of(self.betas[mine], asked, [])).joints[0]
        place = (rotation @ (self.transl + wrists)[..., None])[..., 0] - wrists + shift
        return replace(self.turned(rotation), transl=np.where(np.isinf(self.transl), self.transl, place))

    def from_flat(self, asked: ReadOptions, counted: Counted) -> FoundHands:
        """Return the hands with poses that count from the flat hand; `counted` is what they count from by the
        file's format, unless the user says otherwise. Raises OptionError where MANO's mean pose is needed and
        not there."""
        if (counted if asked.hand_mean == "auto" else asked.hand_mean) == "flat":
            return self
        needed = "these hand poses count from MANO's mean pose"
        if asked.hand_mean == "auto":
            needed = f"in this format{needed[5:]} (--hand-mean flat reads them without)"
        pose = self.hand_pose.copy()
        for index in set(self.side.tolist()):
            pose[self.side == index] += own_model(asked, SIDES[index], needed).hands_mean
        return replace(self, hand_pose=pose)

    @property
    def nowhere(self) -> bool:
        """True if the place of some hand is not known."""
        return bool(np.isinf(self.transl).any())


def shape_of(betas: np.ndarray, asked: ReadOptions, assumed: list[str]) -> np.ndarray:
    """Return (10,) coefficients of MANO's shape, the median of (N, 10); zeros, the mean shape, where none are
    known, and with the open hand, which has other shapes: `assumed` then says so."""
    rows = betas[known(betas)]
    if not len(rows) or not np.any(rows):
        return np.zeros(NUM_BETAS)
    if asked.model is None or asked.model == OPEN_HAND:
        tell(assumed, "the shapes (betas) are MANO's and are left out, as the open hand has other ones")
        return np.zeros(NUM_BETAS)
    return np.asarray(np.median(rows, axis=0))


def followed(
    hands: FoundHands, frames: np.ndarray, asked: ReadOptions, assumed: list[str]
) -> tuple[HandMotion, ...]:
    """Follow hands of single frames over all frames, whose numbers (T,) increase; only those of one person,
    where one is asked for. Hands without a place get the usual one.

    A hand is the one that was closest to it last, among those of its side; there are as many of a side as
    were seen in one frame. Persons are counted as they appear. Raises Unfit for a person that there is not,
    and ValueError for more hands in a frame than are read, or more in all than a take holds.
    """
    check_crowd(hands.frame)
    track = _linked(hands)
    tracks = list(dict.fromkeys(track[np.lexsort((hands.side, hands.frame))].tolist()))
    if asked.person is not None:
        first = [int(np.flatnonzero(track == t)[0]) for t in tracks]
        whose, sides = hands.person[first].tolist(), hands.side[first].tolist()
        if min(whose) < 0:
            whose = [sides[:n].count(side) for n, side in enumerate(sides)]
        persons = sorted(set(whose))
        wanted = persons[asked.person - 1 : asked.person]
        tracks = [t for t, person in zip(tracks, whose, strict=True) if person in wanted]
        if not tracks:
            raise Unfit(f"there is no person {asked.person}: it has {len(persons)}")
    motions = []
    for t in tracks:
        mine = hands.select(np.flatnonzero(track == t))
        side, rows = SIDES[int(mine.side[0])], np.searchsorted(frames, mine.frame)
        transl = np.where(np.isinf(mine.transl), usual_place(side), mine.transl)
        pose = (scatter(each, rows, len(frames)) for each in (mine.global_orient, mine.hand_pose, transl))
        motions.append(HandMotion(side, shape_of(mine.betas, asked, assumed), *pose))
    return tuple(motions)


def _linked(hands: FoundHands) -> np.ndarray:
    """Return (N,) int: the number of the track that each hand belongs to. Raises Unfit."""
    order = np.lexsort((hands.side, hands.frame))
    keys = np.stack([hands.frame, hands.side])[:, order]
    together = np.split(order, np.flatnonzero(np.any(np.diff(keys) != 0, axis=0)) + 1)
    most = [
        max((len(rows) for rows in together if hands.side[rows[0]] == side), default=0) for side in (0, 1)
    ]
    track, by_person = np.full(len(hands), -1), bool(np.all(hands.person >= 0))
    if by_person:
        _, track = np.unique(np.stack([hands.person, hands.side]), axis=1, return_inverse=True)
        track = track.reshape(-1)
        if len(set(zip(track.tolist(), hands.frame.tolist(), strict=True))) != len(track):
            raise Unfit("a hand of one person is there twice in one frame")
    if max(sum(most), track.max(initial=-1) + 1) > TAKE_LIMITS.max_hands:
        raise Unfit(
            f"it has more than {TAKE_LIMITS.max_hands} hands, and at most so many are read; cut it into parts"
        )
    # Its direction, and the logarithm of its depth, which is known least
    places = np.zeros_like(hands.transl) if hands.nowhere else hands.transl
    depth = np.maximum(np.abs(places[:, 2:]), 1e-6)
    seen = np.concatenate([places[:, :2] / depth, np.log(depth)], axis=1)
    last = np.full((sum(most), 3), np.nan)
    for rows in () if by_person else together:
        side = int(hands.side[rows[0]])
        tracks = np.arange(most[side]) + most[0] * side
        # Rows beside tracks by their distance; those that have not begun, which are NaN, come last.
        away = np.linalg.norm(seen[rows][:, None] - last[tracks], axis=-1)
        for nearest in np.argsort(away, axis=None, kind="stable").tolist() if away.size > 1 else (0,):
            i, j = divmod(nearest, len(tracks))
            if track[rows[i]] < 0 and tracks[j] not in track[rows]:
                track[rows[i]] = tracks[j]
        last[track[rows]] = seen[rows]
    return track


_FINGERS: Final = np.array([j - 1 for f, joints in FINGER_JOINTS.items() if f != "thumb" for j in joints])


def _bends(poses: np.ndarray, side: Side) -> np.ndarray:
    """Return (N, 12) radians by which the joints of the four fingers bend, of up to 400 of the poses (T,
    45)."""
    poses = poses[:: max(len(poses) // 200, 1)]
    axes = anatomical_axes(load_model(None, side))
    return anatomical_angles(rotvec_to_rotmat(poses.reshape(-1, 15, 3)), axes)[:, _FINGERS, 2]


def beyond_range(poses: np.ndarray, side: Side) -> float:
    """Return by how many radians the four fingers' bends in poses (T, 45) lie beyond what joints can do: the
    median over the frames of the mean over 12 joints."""
    bends, limits = _bends(poses, side), joint_limits(side)
    low, high = limits.lower[_FINGERS, 2], limits.upper[_FINGERS, 2]
    off = np.maximum(low - bends, 0.0) + np.maximum(bends - high, 0.0)
    return float(np.median(off.mean(axis=1)))


def doubts(hands: Sequence[HandMotion], asked: ReadOptions, mirrored_by: str = "") -> list[str]:
    """Return phrases about hands whose fingers bend as no finger can, and would not if they were read another
    way: with the mean pose, without it, or, where `mirrored_by` says what to do then, a left hand in a
    mirror."""
    phrases: list[str] = []
    for hand in hands:
        poses = hand.hand_pose[hand.present]
        now = beyond_range(poses, hand.side)
        # What the bends of the four fingers' joints are beyond their range, on average, in a wrong reading
        if now < np.radians(4.0):
            continue
        mean = load_model(asked.model, hand.side).hands_mean
        read = "if they look so, read them with --hand-mean"
        others = [
            (f"as if they counted from the mean pose: {read} mean", poses + mean),
            (f"as if the mean pose had been added twice: {read} flat", poses - mean),
        ]
        if mirrored_by and hand.side == "left":
            said = f"as if a mirror were missing or were one too many: {mirrored_by}"
            others.append((said, mirrored_pose(poses[:, :3], poses)[1]))
        best, said = min((beyond_range(other, hand.side), f", {said}") for said, other in others)
        if best >= 0.4 * now:
            said = ": the poses may be of another model, or their joints in another order"
        how = "further back" if np.median(_bends(poses, hand.side)) < 0.0 else "further"
        tell(phrases, f"the {hand.side} hand's fingers bend {how} than fingers can{said}")
    return phrases
