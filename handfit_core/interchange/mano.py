"""MANO's parameters of other programs, brought to ours: relative to the flat hand, in the camera frame.

What differs between programs: matrices or axis-angle, the mean pose added or not, coefficients of MANO's
principal directions, left hands as right ones in a mirror, worlds that are y-up or z-up, and bodies whose
wrists are given by the joints before them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal

import numpy as np

from handfit_core.arrays import LARGEST, array_dataclass
from handfit_core.batch import scatter
from handfit_core.detect.keypoints import check_crowd
from handfit_core.doors.values import Unfit
from handfit_core.errors import OptionError
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model.anatomy import anatomical_angles, anatomical_axes, joint_limits
from handfit_core.hand_model.axes import mirrored_pose
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.files import OPEN_HAND, load_model
from handfit_core.hand_model.motion import POSE_ARRAYS, HandMotion
from handfit_core.interchange.document import Document
from handfit_core.interchange.recording import Asked, Recording, known, usual_place
from handfit_core.interchange.skeletons import UP_AXES
from handfit_core.skeleton import FINGER_JOINTS, NUM_BETAS, SIDES, Side
from handfit_core.take import TAKE_LIMITS

POSE: Final = 45
"""Numbers of a hand's pose, axis-angle"""


Counted = Literal["flat", "mean"]
"""What poses count from: the flat hand, or the mean pose of MANO"""


def numbers(name: str, value: Any, *shape: int) -> np.ndarray:
    """(N, *shape) floats of an array or of nested lists, however its axes are split or joined: (1, T, 15, 3)
    is (T, 45), too. What is not finite is NaN. Raises Unfit."""
    wanted = "x".join(["N", *map(str, shape)])
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise Unfit(f"{name} must be numbers of the shape {wanted}") from None
    each = math.prod(shape)
    if each not in [math.prod(array.shape[start:]) for start in range(array.ndim + 1)]:
        raise Unfit(f"{name} must have the shape {wanted}, not {'x'.join(map(str, array.shape))}")
    array = array.reshape(-1, *shape)
    if np.any(np.abs(array[np.isfinite(array)]) > LARGEST):
        raise Unfit(f"{name} holds numbers beyond {LARGEST:g}")
    return np.where(np.isfinite(array), array, np.nan)


def rotations(name: str, value: Any, joints: int, count: int | None = None) -> np.ndarray:
    """(N, 3 * joints) axis-angle in radians of a program's rotations: matrices (N, joints, 3, 3) or
    axis-angle (N, joints, 3) or (N, 3 * joints). `count`: the N that is expected. Raises Unfit, also for
    matrices that are no rotations and for angles in degrees."""
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise Unfit(f"{name} must be rotations, and is no array of numbers") from None
    three_vectors = joints == 1 and array.ndim == 2 and count == 3
    if array.shape[-2:] == (3, 3) and not three_vectors:
        rotvec = rotmat_to_rotvec(checked_matrices(name, numbers(name, array, joints, 3, 3))).reshape(
            -1, 3 * joints
        )
    else:
        rotvec = numbers(name, array, 3 * joints)
        angles = np.linalg.norm(rotvec.reshape(len(rotvec), joints, 3), axis=-1)
        if np.any(angles > 4.0 * np.pi):
            raise Unfit(
                f"{name} holds turns by {np.nanmax(angles):.0f} radians: these are degrees, or no axis-angle"
            )
    if count is not None and len(rotvec) != count:
        raise Unfit(f"{name} has {len(rotvec)} rows where {count} are expected")
    return rotvec


def is_matrices(value: Any) -> bool:
    """Whether rotations are given as matrices."""
    try:
        return np.shape(value)[-2:] == (3, 3) and np.size(value) % (9 * 15) == 0
    except ValueError:
        return False


def checked_matrices(name: str, matrices: np.ndarray) -> np.ndarray:
    """Matrices that are rotations but for their rounding. Raises Unfit."""
    there = np.isfinite(matrices).all(axis=(-1, -2))
    product = matrices @ np.swapaxes(matrices, -1, -2) - np.eye(3)
    # What the elements of R R^T may differ from those of I
    if np.any(np.abs(product[there]) > 0.05) or np.any(np.linalg.det(matrices[there]) < 0.0):
        raise Unfit(f"{name} holds matrices that are no rotations")
    return matrices


def left_of_right(global_orient: np.ndarray, hand_pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A left hand's parameters of those of the right hand that a mirror at x = 0 shows: (N, 3), (N, 45)."""
    return mirrored_pose(global_orient, hand_pose)


# The user's own MANO file


def own_model(asked: Asked, side: Side, needed: str) -> HandModel:
    """The user's MANO model. Raises OptionError, with what is `needed` of it, where there is none, and
    HandModelError."""
    if asked.model is None or asked.model == OPEN_HAND:
        raise OptionError(
            f"{needed}, which belongs to MANO's licensed files and is not part of this program: give your "
            "own MANO folder or file as the model (--model)"
        )
    return load_model(asked.model, side)


def from_flat(pose: np.ndarray, side: Side, asked: Asked, counted: Counted) -> np.ndarray:
    """Poses (N, 45), which count from the flat hand or from the mean as the format has it, or as the user
    says, relative to the flat hand. Raises OptionError where MANO's mean is needed and not there."""
    if (counted if asked.hand_mean == "auto" else asked.hand_mean) == "flat":
        return pose
    needed = "these hand poses count from MANO's mean pose"
    if asked.hand_mean == "auto":
        needed = "in this format hand poses count from MANO's mean pose (--hand-mean flat reads them without)"
    return pose + own_model(asked, side, needed).hands_mean


def from_directions(coefficients: np.ndarray, side: Side, asked: Asked) -> np.ndarray:
    """(N, 45) axis-angle of coefficients (N, C) of MANO's first C principal directions, without the mean.
    Raises OptionError where these are not there."""
    model = own_model(asked, side, "these hand poses are coefficients of MANO's principal directions")
    return coefficients @ model.hands_components[: coefficients.shape[1]]


def shape_of(betas: Any, asked: Asked, assumed: list[str]) -> np.ndarray:
    """(10,) coefficients of MANO's shape, the median of several rows; zeros, the mean shape, where none are
    known, and with the open hand, which has other shapes: `assumed` then says so. Raises Unfit."""
    mean_shape = np.zeros(NUM_BETAS)
    if betas is None or np.size(betas) == 0:
        return mean_shape
    row = np.asarray(betas, dtype=np.float64)
    if row.shape[-1] < NUM_BETAS:
        raise Unfit(f"betas must be {NUM_BETAS} numbers, not {row.shape[-1]}")
    rows = numbers("betas", row[..., :NUM_BETAS], NUM_BETAS)
    rows = rows[known(rows)]
    if not len(rows) or not np.any(rows):
        return mean_shape
    if asked.model is None or asked.model == OPEN_HAND:
        tell(assumed, "the shapes (betas) are MANO's and are left out, as the open hand has other ones")
        return mean_shape
    return np.asarray(np.median(rows, axis=0))


def tell(assumed: list[str], phrase: str) -> None:
    """Add a phrase that is not there yet."""
    if phrase not in assumed:
        assumed.append(phrase)


# Frames


def seen_from(
    hand: HandMotion, asked: Asked, rotation: np.ndarray, translation: np.ndarray | None = None
) -> HandMotion:
    """A hand of another frame in the camera's: x_camera = rotation x + translation. A place that is not
    told stays so.

    rotation: (3, 3) or (T, 3, 3); translation: (3,) or (T, 3) metres. MANO's root turns about the wrist,
    which does not lie at the origin of the model: with J the wrist of the model, the new transl is
    R (J + transl) + t - J.
    """
    turned = rotmat_to_rotvec(rotation @ rotvec_to_rotmat(hand.global_orient))
    if is_nowhere(hand):
        return replace(hand, global_orient=turned)
    wrist = load_model(asked.model, hand.side).shaped(hand.betas).joints[0]
    place = (rotation @ (hand.transl + wrist)[..., None])[..., 0] - wrist
    return replace(hand, global_orient=turned, transl=place if translation is None else place + translation)


UNTOLD_WORLD: Final = "its world was taken to be z-up, which it does not tell"

_UPS: Final = (
    ("y-up", 1, 1.0, UP_AXES["y"]),
    ("z-up", 2, 1.0, UP_AXES["z"]),
    ("the camera's, y-down", 1, -1.0, np.eye(3)),
)


def standing(pelvis: np.ndarray, assumed: list[str]) -> np.ndarray:
    """(3, 3) to the camera frame from the world of a body of SMPL's family, by how it stands.

    pelvis: (T, 3) axis-angle. In the rest pose such a body stands along +y.
    """
    along = rotvec_to_rotmat(pelvis[known(pelvis)])[:, :, 1]
    mean = along.mean(axis=0) if len(along) else np.array([0.0, 1.0, 0.0])
    name, _, _, turn = max(_UPS, key=lambda up: up[2] * mean[up[1]])
    tell(assumed, f"its world was taken to be {name}, as the body stands so")
    return turn


# Bodies of SMPL's family

_TO_WRIST: Final[dict[Side, tuple[int, ...]]] = {
    "left": (3, 6, 9, 13, 16, 18, 20),
    "right": (3, 6, 9, 14, 17, 19, 21),
}
"""The joints from the pelvis, which is 0, to a wrist, in the order of SMPL, SMPL+H and SMPL-X"""

BODY_JOINTS: Final = 21
"""of such a body's pose, without the pelvis and the hands"""


def wrist_of_body(pelvis: np.ndarray, body_pose: np.ndarray, side: Side) -> np.ndarray:
    """(T, 3) axis-angle: how a body's wrist is turned in the world, which is MANO's global_orient.

    pelvis (T, 3) and body_pose (T, 63) axis-angle. Rotations need no body model, only the chain; hands of
    SMPL+H and SMPL-X have MANO's rest axes.
    """
    turned = rotvec_to_rotmat(pelvis)
    joints = rotvec_to_rotmat(body_pose.reshape(-1, BODY_JOINTS, 3))
    for joint in _TO_WRIST[side]:
        turned = turned @ joints[:, joint - 1]
    return rotmat_to_rotvec(turned)


def of_body(side: Side, pelvis: np.ndarray, body_pose: np.ndarray, hand_pose: np.ndarray) -> HandMotion:
    """A hand of a body, turned as its wrist is; where that lies is not known without the body's model.

    pelvis (T, 3), body_pose (T, 63) and hand_pose (T, 45) axis-angle.
    """
    orient = wrist_of_body(pelvis, body_pose, side)
    return HandMotion(side, np.zeros(NUM_BETAS), orient, hand_pose, nowhere(len(orient)))


NO_PLACE: Final = (
    "where the wrists are is not known without the body's model: each hand stays in its place, and only turns"
)


# Hands frame by frame


NO_SHAPE: Final = np.full(NUM_BETAS, np.nan)
"""The betas of a `FoundHand` whose file does not tell them"""


def nowhere(count: int) -> np.ndarray:
    """(T, 3) the transl of hands whose place is not told: at infinity, until `recording_of` places them."""
    return np.full((count, 3), np.inf)


def is_nowhere(hand: HandMotion) -> bool:
    """Whether a hand's place is not told, in one of its frames at least."""
    return bool(np.isinf(hand.transl).any())


@array_dataclass
class FoundHand(HandMotion):
    """One hand in one frame (T = 1). Its betas are the file's."""

    frame: int
    person: int | None = None
    """Whose it is, where the file tells"""


@dataclass
class _Followed:
    side: Side
    person: int | None
    hands: dict[int, FoundHand] = field(default_factory=dict)
    place: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """(3,) where the hand of the last frame was seen"""

    def add(self, hand: FoundHand) -> None:
        """The hand of the next frame."""
        self.hands[hand.frame] = hand
        self.place = _seen_at(hand)


def _seen_at(hand: FoundHand) -> np.ndarray:
    """(3,) its direction, and the logarithm of its depth, which is known least; zeros if it is nowhere."""
    (place,) = hand.transl
    if is_nowhere(hand):
        return np.zeros(3)
    depth = max(abs(float(place[2])), 1e-6)
    return np.array([place[0] / depth, place[1] / depth, np.log(depth)])


def followed(
    found: Iterable[FoundHand], frames: np.ndarray, asked: Asked, assumed: list[str]
) -> tuple[HandMotion, ...]:
    """Hands of single frames as hands over all of them, those of one person, where one is asked for.

    A hand is the one that was closest to it last, among those of its side; there are as many of a side as
    were seen in one frame. Persons are counted as they appear. Raises Unfit for a person that there is not,
    and ValueError for more hands in a frame than are read, or more in all than a take holds.
    """
    found = list(found)
    check_crowd(np.array([hand.frame for hand in found], dtype=int))
    tracks: list[_Followed] = []
    by_frame: dict[int, list[FoundHand]] = {}
    for hand in found:
        by_frame.setdefault(hand.frame, []).append(hand)
    for frame in sorted(by_frame):
        for side in SIDES:
            hands = [hand for hand in by_frame[frame] if hand.side == side]
            _assign(hands, [track for track in tracks if track.side == side], tracks, side)
        if len(tracks) > TAKE_LIMITS.max_hands:
            raise Unfit(
                f"it has more than {TAKE_LIMITS.max_hands} hands, and at most so many are read; "
                "cut it into parts"
            )
    if asked.person is not None:
        of_side = {side: [track for track in tracks if track.side == side] for side in SIDES}
        persons = sorted({track.person for track in tracks if track.person is not None})
        if persons:
            chosen = persons[asked.person - 1 : asked.person]
            tracks = [track for track in tracks if track.person in chosen]
        else:
            tracks = [hand for side in SIDES for hand in of_side[side][asked.person - 1 : asked.person]]
        if not tracks:
            most = len(persons) or max(map(len, of_side.values()))
            raise Unfit(f"there is no person {asked.person}: it has {most}")
    return tuple(_posed(track, frames, asked, assumed) for track in tracks)


def _assign(hands: list[FoundHand], known_ones: list[_Followed], tracks: list[_Followed], side: Side) -> None:
    """Each of a frame's hands of one side to its track, or to a new one."""
    free = list(known_ones)
    for hand in list(hands):
        if hand.person is not None:
            same = next((track for track in free if track.person == hand.person), None)
            if same is None:
                tracks.append(same := _Followed(side, hand.person))
            else:
                free.remove(same)
            same.add(hand)
            hands.remove(hand)
    free = [track for track in free if track.person is None]
    seen = np.array([_seen_at(hand) for hand in hands]).reshape(-1, 1, 3)
    places = np.array([track.place for track in free]).reshape(1, -1, 3)
    away = np.linalg.norm(seen - places, axis=-1)
    taken: dict[int, _Followed] = {}
    left = set(range(len(free)))
    for nearest in np.argsort(away, axis=None, kind="stable").tolist():
        i, j = divmod(nearest, len(free))
        if i not in taken and j in left:
            taken[i] = free[j]
            left.remove(j)
    for i, hand in enumerate(hands):
        if i not in taken:
            tracks.append(taken.setdefault(i, _Followed(side, None)))
        taken[i].add(hand)


def _posed(track: _Followed, frames: np.ndarray, asked: Asked, assumed: list[str]) -> HandMotion:
    rows = np.searchsorted(frames, sorted(track.hands))
    hands = [track.hands[frame] for frame in sorted(track.hands)]
    poses = (np.concatenate([hand.pose[i] for hand in hands]) for i in range(len(POSE_ARRAYS)))
    shape = shape_of(np.array([hand.betas for hand in hands]), asked, assumed)
    return HandMotion(track.side, shape, *(scatter(each, rows, len(frames)) for each in poses))


# A wrong mean, or a mirror that is missing

_FINGERS: Final = np.array([j - 1 for f, joints in FINGER_JOINTS.items() if f != "thumb" for j in joints])


def beyond_range(hand: HandMotion) -> float:
    """Radians that the four fingers' bends lie beyond what joints can do: the median over the frames of the
    mean over 12 joints. 0 for a hand that is nowhere."""
    poses = hand.hand_pose[hand.present]
    if not len(poses):
        return 0.0
    poses = poses[:: max(len(poses) // 200, 1)]
    axes = anatomical_axes(load_model(None, hand.side))
    bends = anatomical_angles(rotvec_to_rotmat(poses.reshape(-1, 15, 3)), axes)[:, _FINGERS, 2]
    limits = joint_limits(hand.side)
    low, high = limits.lower[_FINGERS, 2], limits.upper[_FINGERS, 2]
    off = np.maximum(low - bends, 0.0) + np.maximum(bends - high, 0.0)
    return float(np.median(off.mean(axis=1)))


def doubts(hands: Sequence[HandMotion], asked: Asked, mirrored_by: str = "") -> list[str]:
    """Phrases for hands whose fingers bend as no finger can, and would not if they were read another way:
    with the mean pose, without it, or, where `mirrored_by` says what to do then, a left hand in a mirror."""
    phrases: list[str] = []
    for hand in hands:
        now = beyond_range(hand)
        # What the bends of the four fingers' joints are beyond their range, on average, in a wrong reading
        if now < np.radians(4.0):
            continue
        mean = load_model(asked.model, hand.side).hands_mean
        others: list[tuple[str, np.ndarray]] = [
            (
                "as if they counted from the mean pose: if they look so, read them with --hand-mean mean",
                hand.hand_pose + mean,
            ),
            (
                "as if the mean pose had been added twice: if they look so, read them with --hand-mean flat",
                hand.hand_pose - mean,
            ),
        ]
        if mirrored_by and hand.side == "left":
            others.append(
                (
                    f"as if a mirror were missing or were one too many: {mirrored_by}",
                    mirrored_pose(hand.global_orient, hand.hand_pose)[1],
                )
            )
        best, said = min((beyond_range(replace(hand, hand_pose=pose)), said) for said, pose in others)
        if best < 0.4 * now:
            tell(phrases, f"the {hand.side} hand's fingers bend {_how(hand)} than fingers can, {said}")
        else:
            tell(
                phrases,
                f"the {hand.side} hand's fingers bend {_how(hand)} than fingers can: the poses may be of "
                "another model, or their joints in another order",
            )
    return phrases


def _how(hand: HandMotion) -> str:
    axes = anatomical_axes(load_model(None, hand.side))
    poses = hand.hand_pose[hand.present].reshape(-1, 15, 3)
    bends = anatomical_angles(rotvec_to_rotmat(poses), axes)[:, _FINGERS, 2]
    return "further back" if np.median(bends) < 0.0 else "further"


# What surrounds them


def rate(told: Any, asked: Asked) -> float:
    """Frames per second of a file that tells them, or not (None). Raises Unfit."""
    return asked.rate if told is None else float(numbers("the frame rate", told, 1)[0, 0])


def only(hand: HandMotion, there: np.ndarray) -> HandMotion:
    """The hand in those of its frames (T,) bool. Raises Unfit for another number of them."""
    if len(there) != len(hand.hand_pose):
        raise Unfit(
            f"it tells for {len(there)} frames whether there is a hand, and has {len(hand.hand_pose)}"
        )
    return hand.posed_at(there)


def _placed(hand: HandMotion) -> HandMotion:
    """The hand at the usual place where its own is not told."""
    if not is_nowhere(hand):
        return hand
    return replace(hand, transl=np.tile(usual_place(hand.side), (len(hand.transl), 1)))


def recording_of(
    name: str,
    document: Document,
    fps: float,
    frames: np.ndarray,
    posed: Iterable[HandMotion],
    asked: Asked,
    assumed: Iterable[str],
    *,
    chosen: bool = False,
    mirrored_by: str = "",
    size: tuple[int, int] | None = None,
    intrinsics: Intrinsics | None = None,
) -> Recording:
    """The recording of hands that are there, with what is doubtful about them. `chosen`: whether the hands
    are already those of the person asked for; else there is one person. Raises Unfit."""
    if not chosen and asked.person not in (None, 1):
        raise Unfit(f"there is no person {asked.person}: it has 1")
    hands = tuple(hand for hand in map(_placed, posed) if hand.present.any())
    if not hands:
        raise Unfit("there is no hand in any of its frames")
    return Recording(
        name,
        (str(document.path.absolute()),),
        fps,
        frames,
        posed=hands,
        size=size,
        intrinsics=intrinsics,
        assumed=(*assumed, *doubts(hands, asked, mirrored_by)),
    )
