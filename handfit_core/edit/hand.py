"""A captured hand with the artist's corrections, and what re-fitting makes of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from handfit_core.arrays import LARGEST
from handfit_core.batch import spread
from handfit_core.detect.keypoints import HandDetection
from handfit_core.errors import OptionError
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model import OPEN_HAND
from handfit_core.options import OPTIONS, CaptureOptions
from handfit_core.skeleton import NUM_BETAS, NUM_JOINTS, NUM_KEYPOINTS, SIDES, Side, can_touch
from handfit_core.take import LARGEST_FPS, SMALLEST_FPS

START_ARRAYS: Final[dict[str, tuple[int, ...]]] = {"global_orient": (3,), "hand_pose": (45,), "transl": (3,)}
"""The pose to start from, and its shapes behind T"""


RESULT_SHAPES: Final[dict[str, tuple[int, ...]]] = {
    **START_ARRAYS,
    "joints_3d": (NUM_KEYPOINTS, 3),
    "projected": (NUM_KEYPOINTS, 2),
    "landmarks_2d": (NUM_KEYPOINTS, 2),
    "reprojection_error": (),
}
"""The arrays of a result, and their shapes behind T"""


@dataclass(frozen=True, eq=False)
class RefineHand:
    """T consecutive frames of one hand, and what the artist says about them.

    Pixels are of the upright picture; poses are MANO's (axis-angle in radians relative to the flat hand),
    camera frame, metres. Raises OptionError, naming the field, where something has the wrong shape or range.
    """

    side: Side
    betas: np.ndarray
    """(10,) the shape, which stays as it is"""
    intrinsics: Intrinsics
    detections: tuple[HandDetection | None, ...]
    """T of them; None where nothing was detected"""
    pins: np.ndarray
    """(T, 21, 2) pixels where the detector's keypoints truly are, as the artist says; NaN: not pinned"""
    global_orient: np.ndarray
    """(T, 3) the pose that is corrected, NaN in frames without one: what was captured, or what a drag started
    from. During a drag better that than the last answer: the result then depends on where the pins are,
    and not on the way there. A pose behind the camera counts as none"""
    hand_pose: np.ndarray
    """(T, 45)"""
    transl: np.ndarray
    """(T, 3)"""
    locked: np.ndarray
    """(16,) bool in MANO's order of joints: those rotations stay as they are; with the wrist (0) its place
    too. In frames without a pose nothing is locked"""
    model: str = OPEN_HAND
    """`open-hand`, or the path of the user's model file or folder"""
    fps: float = 25.0
    """Of these frames"""
    smoothing: float = CaptureOptions.smoothing
    """For re-fitting a range"""
    holes: tuple[int, ...] = ()
    """Rows after which the source lacks pictures: nothing is smoothed across"""
    added: bool = False
    """Whether a person laid it into the picture: its pose is a guess until pins say how it lies"""
    touches: np.ndarray | None = None
    """(T, 21) which other keypoint each one touches, skin to skin, the larger naming the smaller; 0 stands
    for the palm, wherever it is nearest. NaN: none; None: none does"""

    def __post_init__(self) -> None:
        if self.side not in SIDES:
            raise OptionError(f"side must be left or right, not {self.side!r}")
        if not self.detections:
            raise OptionError("detections must have an entry for each frame, and at least one")
        count = len(self.detections)
        expected = {
            "betas": (NUM_BETAS,),
            "pins": (count, NUM_KEYPOINTS, 2),
            "locked": (NUM_JOINTS,),
            **{name: (count, *shape) for name, shape in START_ARRAYS.items()},
        }
        for name, shape in expected.items():
            array = np.asarray(getattr(self, name))
            if array.shape != shape:
                raise OptionError(f"{name} must have the shape {shape}, not {array.shape}")
            if array.dtype.kind not in "fbiu":
                raise OptionError(f"{name} must hold numbers, not {array.dtype}")
        if not np.isfinite(self.betas).all():
            raise OptionError("betas must be finite")
        if np.any(np.abs(self.pins) > LARGEST) or (np.isnan(self.pins).sum(axis=-1) == 1).any():
            raise OptionError(
                f"pins must have x and y in pixels, up to {LARGEST:g}, or NaN for both where a point is not "
                "pinned"
            )
        if not SMALLEST_FPS <= self.fps <= LARGEST_FPS:
            raise OptionError(f"fps must lie between {SMALLEST_FPS:g} and {LARGEST_FPS:g}, not {self.fps}")
        OPTIONS["smoothing"].read(self.smoothing)
        if self.touches is not None:
            touches = np.asarray(self.touches)
            if touches.shape != (count, NUM_KEYPOINTS) or touches.dtype.kind not in "fiu":
                raise OptionError(f"touches must be numbers of the shape {(count, NUM_KEYPOINTS)}")
            for row, point in np.argwhere(~np.isnan(touches)).tolist():
                other = touches[row, point]
                if not (float(other).is_integer() and can_touch(point, int(other))):
                    raise OptionError(
                        f"touches: keypoint {point} must name a smaller one of another finger, 0 for the "
                        f"palm, or NaN; not {other:g}"
                    )
        for row, detection in enumerate(self.detections):
            if detection is None:
                continue
            for name in ("keypoints", "world"):
                array = np.asarray(getattr(detection, name))
                if array.shape != (NUM_KEYPOINTS, 3) or not np.isfinite(array).all():
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
        seen = spread(points, self.detected, len(self))
        return np.where(self.pinned[..., None], self.pins, seen)


@dataclass(frozen=True, eq=False)
class RefineResult:
    """T re-fitted frames; NaN rows where there is nothing to fit to. Camera frame, metres, pixels."""

    global_orient: np.ndarray
    """(T, 3) radians"""
    hand_pose: np.ndarray
    """(T, 45) radians"""
    transl: np.ndarray
    """(T, 3)"""
    joints_3d: np.ndarray
    """(T, 21, 3) the model's keypoints, as a take has them"""
    projected: np.ndarray
    """(T, 21, 2) their projection"""
    landmarks_2d: np.ndarray
    """(T, 21, 2) projection of the points that pins pull at (see `handles.landmark_points`), where
    handles belong: at a pin that the hand can reach this is the pin"""
    reprojection_error: np.ndarray
    """(T,) as in a take: mean distance from `projected` to the detected keypoints, with pins in their place;
    NaN without either"""

    @property
    def present(self) -> np.ndarray:
        """(T,) bool: frames with a hand."""
        return np.asarray(np.isfinite(self.transl).all(axis=1))
