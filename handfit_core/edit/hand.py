"""A captured hand with the artist's corrections, as re-fitting takes it, and the prop that it may hold."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from handfit_core.common.arrays import array, array_dataclass, check_arrays, value
from handfit_core.common.batch import scatter
from handfit_core.common.errors import OptionError
from handfit_core.common.skeleton import NUM_JOINTS, NUM_KEYPOINTS, can_touch
from handfit_core.common.values import Unfit, flag, listed, number, path, shortly, whole
from handfit_core.detect.keypoints import Detections
from handfit_core.edit.settings import EDITS
from handfit_core.fit.solvers import MOST_SMOOTHING, USUAL_SMOOTHING
from handfit_core.geometry.camera import Intrinsics, PlacedCamera
from handfit_core.hand_model.files import OPEN_HAND
from handfit_core.hand_model.motion import HandMotion
from handfit_core.take import TAKE_LIMITS, HandTrack, Take


def _camera(name: str, given: Any) -> Intrinsics:
    """Check a camera, which may come as the list of its four numbers."""
    if isinstance(given, Intrinsics):
        return given
    if not isinstance(given, list) or len(given) != 4:
        raise Unfit(f"{name} must be a list of 4 numbers, not {shortly(given)}")
    return Intrinsics(*listed(name, given, number))


def _model(name: str, given: Any) -> str:
    return OPEN_HAND if given in (None, "") else path(name, given)


def _row(name: str, given: Any) -> int:
    """Check a frame's row, a whole number, which JSON may have as 5.0."""
    row = number(name, given)
    return whole(name, int(row) if row.is_integer() else row)


@array_dataclass
class SecondSight:
    """The detections of a hand by a take's second camera, around the T frames that are re-fitted."""

    intrinsics: Intrinsics = value(_camera)
    rotation: np.ndarray = array(3, 3, finite="all")
    translation: np.ndarray = array(3, finite="all")
    """(3,) metres: the translation from the first camera's frame to the second one's, x_2 = rotation x +
    translation"""
    moments: np.ndarray = array("T", finite="all")
    """(T,) seconds: when the hand's frames were taken"""
    times: np.ndarray = array("S", finite="all")
    """(S,) seconds, increasing: when the second camera's detections were made"""
    detections: Detections
    """The S detections in the second view, in order of time"""
    fps: float = value(number, default=25.0, least=TAKE_LIMITS.min_fps, most=TAKE_LIMITS.max_fps)
    """Frames per second of the second camera"""

    def __post_init__(self) -> None:
        check_arrays(self, OptionError, "second: ")
        if len(self.detections) != len(self.times) or np.any(np.diff(self.times) <= 0):
            raise OptionError("second: each detection needs a time, and these must increase")

    @property
    def camera(self) -> PlacedCamera:
        """The second camera, with its lens and its place."""
        return PlacedCamera(self.intrinsics, self.rotation, self.translation)


def second_sight(take: Take, hand: HandTrack, rows: np.ndarray) -> SecondSight | None:
    """Collect the second camera's detections of a hand around the frames `rows` (T,) of a take; None where
    the take has one view. A few more at both ends are taken along, so that pixels between the second view's
    frames are as in the whole take."""
    if take.cameras is None:
        return None
    view, numbers = take.cameras.views[0], np.asarray(take.frame_numbers)
    moments, times = (numbers[rows] - numbers[0]) / take.fps, take.cameras.seconds(1)
    seen, found = hand.seen_by[0] if hand.seen_by else None, np.zeros(0, dtype=int)
    if seen is not None:
        around = EDITS.frames_around / view.fps
        near = (times >= moments.min() - around) & (times <= moments.max() + around)
        found = np.flatnonzero(near & seen.detected & seen.used)
    camera = take.cameras.camera(1)
    return SecondSight(
        camera.intrinsics,
        camera.rotation,
        camera.translation,
        moments=moments,
        times=times[found],
        detections=(hand if seen is None else seen).detections.at_frames(found),
        fps=view.fps,
    )


@array_dataclass
class RefineHand(HandMotion):
    """T consecutive frames of one hand with the artist's pins, touches and locks.

    Its pose is the one that is corrected, NaN in frames without one: what was captured, or what a drag
    started from. During a drag better that than the last answer: the result then depends on where the pins
    are, and not on the way there. A pose behind the camera counts as none. The shape stays as it is.

    Pixels are of the upright picture. Raises OptionError, naming the field, where something has the wrong
    shape or range.
    """

    intrinsics: Intrinsics = value(_camera)
    detections: Detections
    """The hand's detections, at most one in each of the T frames, in their order"""
    pins: np.ndarray = array("T", NUM_KEYPOINTS, 2)
    """(T, 21, 2) pixels where the detector's keypoints truly are, as the artist says; NaN where a point is
    not pinned"""
    locked: np.ndarray = array(NUM_JOINTS, kind="b")
    """(16,) bool in MANO's order of joints: true for joints whose rotations stay as they are; with the wrist
    (0) its place stays, too. In frames without a pose nothing is locked"""
    model: str = value(_model, default=OPEN_HAND)
    """`open-hand`, or the path of the user's model file or folder"""
    fps: float = value(number, default=25.0, least=TAKE_LIMITS.min_fps, most=TAKE_LIMITS.max_fps)
    """Frames per second of the source"""
    smoothing: float = value(number, default=USUAL_SMOOTHING, least=0.0, most=MOST_SMOOTHING)
    """Strength with which motion is smoothed when a range is re-fitted; 0: each frame by itself"""
    holes: tuple[int, ...] = value(partial(listed, kind=_row), default=())
    """Rows after which pictures of the source are missing, so that nothing is smoothed across"""
    added: bool = value(flag, default=False)
    """True if a person laid the hand into the picture, so that its pose is a guess until pins say how it
    lies"""
    touches: np.ndarray | None = array("T", NUM_KEYPOINTS, most=np.inf, default=None)
    """(T, 21) which other keypoint each keypoint touches, skin to skin, the larger number naming the smaller
    one; 0 stands for the palm, wherever it is nearest. A negative number: the bones that end at both
    keypoints touch, wherever they are nearest. NaN: it touches none; None: no keypoint does"""
    second: SecondSight | None = None
    """The hand's detections by a second camera, for re-fitting a range; None where there is no second view"""

    def __post_init__(self) -> None:
        check_arrays(self, OptionError)
        check_arrays(self.detections, OptionError, "detections: ")
        frame = self.detections.frame
        if not len(self) or np.any(np.diff(frame) <= 0) or np.any((frame < 0) | (frame >= len(self))):
            raise OptionError(
                f"detections: at most one can be in each of the {len(self)} frames, of which "
                "there must be some, in their order"
            )
        if (np.isnan(self.pins).sum(axis=-1) == 1).any():
            raise OptionError("pins must have x and y in pixels, or NaN for both where a point is not pinned")
        if self.second is not None:
            check_arrays(self.second, OptionError, "second: ", T=len(self))
        if self.touches is not None:
            for row, point in np.argwhere(~np.isnan(self.touches)).tolist():
                other = self.touches[row, point]
                if not (float(other).is_integer() and can_touch(point, int(other))):
                    raise OptionError(
                        f"touches: keypoint {point} must name a smaller one of another finger, 0 for the "
                        f"palm, a negative one for bones, or NaN; not {other:g}"
                    )

    def __len__(self) -> int:
        return len(self.pins)

    @property
    def detected(self) -> np.ndarray:
        """(T,) bool: true in frames with a detection."""
        return scatter(np.ones(len(self.detections), dtype=bool), self.detections.frame, len(self), False)

    @property
    def pinned(self) -> np.ndarray:
        """(T, 21) bool: true for points that are pinned."""
        return np.asarray(np.isfinite(self.pins).all(axis=-1))

    @property
    def touching(self) -> np.ndarray:
        """(T,) bool: true in frames in which points are to touch."""
        if self.touches is None:
            return np.zeros(len(self), dtype=bool)
        return np.asarray(np.isfinite(self.touches).any(axis=1))


@array_dataclass
class Prop:
    """An object that a hand holds in its T frames, as rigid triangles.

    Raises OptionError, naming the field, where something has the wrong shape or range.
    """

    vertices: np.ndarray = array("V", 3, finite="all", sent=np.float32)
    """(V, 3) metres: the triangles' vertices in the prop's own frame"""
    triangles: np.ndarray = array("F", 3, kind="i")
    placed: np.ndarray = array("T", 3, 4, finite="all")
    """(T, 3, 4) in metres, [turn | place] of each frame: x = turn p + place takes the prop into the camera
    frame"""
    fingers: np.ndarray = array(5, kind="b", default=True)
    """(5,) bool: true for fingers that may be laid on the prop, thumb first"""

    def __post_init__(self) -> None:
        check_arrays(self, OptionError, "prop: ")
        if len(self.triangles) and not 0 <= self.triangles.min() <= self.triangles.max() < len(self.vertices):
            raise OptionError("prop: triangles must name its vertices")
        turn = self.placed[:, :, :3]
        if (
            not np.allclose(turn @ turn.swapaxes(1, 2), np.eye(3), atol=1e-4)
            or (np.linalg.det(turn) < 0).any()
        ):
            raise OptionError("prop: placed must turn it without scaling or mirroring it")
