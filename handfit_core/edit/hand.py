"""A captured hand with the artist's corrections, and what re-fitting makes of it."""

from __future__ import annotations

from typing import Final

import numpy as np

from handfit_core.arrays import array, array_dataclass, check_arrays
from handfit_core.batch import scatter
from handfit_core.detect.keypoints import HandDetection
from handfit_core.errors import OptionError
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model import OPEN_HAND
from handfit_core.options import OPTIONS, CaptureOptions
from handfit_core.skeleton import NUM_BETAS, NUM_JOINTS, NUM_KEYPOINTS, SIDES, Side, can_touch
from handfit_core.take import TAKE_LIMITS

START_ARRAYS: Final = ("global_orient", "hand_pose", "transl")
"""The pose to start from"""


@array_dataclass
class RefineHand:
    """T consecutive frames of one hand with the artist's pins, touches and locks.

    Pixels are of the upright picture; poses are MANO's (axis-angle in radians relative to the flat hand),
    camera frame, metres. Raises OptionError, naming the field, where something has the wrong shape or range.
    """

    side: Side
    betas: np.ndarray = array(NUM_BETAS, finite="all", most=np.inf)
    """The shape, which stays as it is"""
    intrinsics: Intrinsics
    detections: tuple[HandDetection | None, ...]
    """T of them; None where nothing was detected"""
    pins: np.ndarray = array("T", NUM_KEYPOINTS, 2)
    """pixels where the detector's keypoints truly are, as the artist says; NaN: not pinned"""
    global_orient: np.ndarray = array("T", 3, most=np.inf)
    """The pose that is corrected, NaN in frames without one: what was captured, or what a drag started from.
    During a drag better that than the last answer: the result then depends on where the pins are, and not on
    the way there. A pose behind the camera counts as none"""
    hand_pose: np.ndarray = array("T", 45, most=np.inf)
    transl: np.ndarray = array("T", 3, most=np.inf)
    locked: np.ndarray = array(NUM_JOINTS, kind="b")
    """In MANO's order of joints: those rotations stay as they are; with the wrist (0) its place
    too. In frames without a pose nothing is locked"""
    model: str = OPEN_HAND
    """`open-hand`, or the path of the user's model file or folder"""
    fps: float = 25.0
    """Frames per second"""
    smoothing: float = CaptureOptions.smoothing
    """For re-fitting a range"""
    holes: tuple[int, ...] = ()
    """Rows after which the source lacks pictures: nothing is smoothed across"""
    added: bool = False
    """Whether a person laid it into the picture: its pose is a guess until pins say how it lies"""
    touches: np.ndarray | None = array("T", NUM_KEYPOINTS, most=np.inf, default=None)
    """Which other keypoint each one touches, skin to skin, the larger naming the smaller; 0 stands
    for the palm, wherever it is nearest. NaN: none; None: none does"""

    def __post_init__(self) -> None:
        if self.side not in SIDES:
            raise OptionError(f"side must be left or right, not {self.side!r}")
        if not self.detections:
            raise OptionError("detections must have an entry for each frame, and at least one")
        check_arrays(self, OptionError, T=len(self.detections))
        if (np.isnan(self.pins).sum(axis=-1) == 1).any():
            raise OptionError("pins must have x and y in pixels, or NaN for both where a point is not pinned")
        if not TAKE_LIMITS.min_fps <= self.fps <= TAKE_LIMITS.max_fps:
            raise OptionError(
                f"fps must lie between {TAKE_LIMITS.min_fps:g} and {TAKE_LIMITS.max_fps:g}, not {self.fps}"
            )
        OPTIONS["smoothing"].read(self.smoothing)
        if self.touches is not None:
            for row, point in np.argwhere(~np.isnan(self.touches)).tolist():
                other = self.touches[row, point]
                if not (float(other).is_integer() and can_touch(point, int(other))):
                    raise OptionError(
                        f"touches: keypoint {point} must name a smaller one of another finger, 0 for the "
                        f"palm, or NaN; not {other:g}"
                    )
        for row, detection in enumerate(self.detections):
            if detection is None:
                continue
            for name in ("keypoints", "world"):
                points = np.asarray(getattr(detection, name))
                if points.shape != (NUM_KEYPOINTS, 3) or not np.isfinite(points).all():
                    raise OptionError(
                        f"detections: {name} of row {row} must be {NUM_KEYPOINTS} finite points; give None "
                        "where there is no detection"
                    )

    def __len__(self) -> int:
        return len(self.detections)

    @property
    def detected(self) -> np.ndarray:
        """(T,) bool."""
        return np.array([d is not None for d in self.detections])

    @property
    def posed(self) -> np.ndarray:
        """(T,) bool: frames with a pose to start from."""
        return np.logical_and.reduce([np.isfinite(getattr(self, n)).all(axis=1) for n in START_ARRAYS])

    @property
    def pinned(self) -> np.ndarray:
        """(T, 21) bool."""
        return np.asarray(np.isfinite(self.pins).all(axis=-1))

    @property
    def touching(self) -> np.ndarray:
        """(T,) bool: frames in which points touch."""
        if self.touches is None:
            return np.zeros(len(self), dtype=bool)
        return np.asarray(np.isfinite(self.touches).any(axis=1))

    @property
    def keypoints_2d(self) -> np.ndarray:
        """(T, 21, 2) what was detected, with the pins in their place; NaN where there is neither."""
        points = np.reshape(
            [d.keypoints_2d for d in self.detections if d is not None], (-1, NUM_KEYPOINTS, 2)
        )
        seen = scatter(points, self.detected, len(self))
        return np.where(self.pinned[..., None], self.pins, seen)


@array_dataclass
class RefineResult:
    """T re-fitted frames; NaN rows where there is nothing to fit to. Camera frame, metres, pixels."""

    global_orient: np.ndarray = array("T", 3, sent=np.float32)
    """radians"""
    hand_pose: np.ndarray = array("T", 45, sent=np.float32)
    """radians"""
    transl: np.ndarray = array("T", 3, sent=np.float32)
    joints_3d: np.ndarray = array("T", NUM_KEYPOINTS, 3, sent=np.float32)
    """The model's keypoints, as a take has them"""
    projected: np.ndarray = array("T", NUM_KEYPOINTS, 2, sent=np.float32)
    """Their projection"""
    landmarks_2d: np.ndarray = array("T", NUM_KEYPOINTS, 2, sent=np.float32)
    """Projection of the points that pins pull at (see `handles.landmark_points`), where handles belong: at a
    pin that the hand can reach this is the pin"""
    reprojection_error: np.ndarray = array("T", sent=np.float32)
    """Pixels, the mean distance from `projected` to the detected keypoints, with pins in their place; NaN
    without either"""

    @property
    def present(self) -> np.ndarray:
        """(T,) bool: frames with a hand."""
        return np.asarray(np.isfinite(self.transl).all(axis=1))
