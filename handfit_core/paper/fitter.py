"""The paper's method: "Monocular 3D Hand Pose Estimation with Implicit Camera Alignment"
(arXiv 2506.11133), its experiments A to H, and our default made of A.

For one hand in one picture: the detected keypoints (x, y, z in pixels) are scaled so that wrist to
index knuckle has the model's length, and moved rigidly so that six palm points lie on the model's.
Then shape, root rotation and pose are optimised until the model's 21 keypoints meet them, and the
alignment is inverted, which yields the hand in the picture without any camera.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from handfit_core.common.batch import scatter
from handfit_core.common.skeleton import INDEX_KNUCKLE_KEYPOINT, NUM_BETAS, PALM_KEYPOINTS, WRIST_KEYPOINT
from handfit_core.detect.keypoints import Track
from handfit_core.fit.solvers import OnFrame, ShouldStop, never
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.geometry.similarity import Similarity, align
from handfit_core.hand_model.anatomy import anatomical_axes, joint_limits
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.motion import POSE_ARRAYS, HandMotion
from handfit_core.paper.placement import place, turn_to_ray
from handfit_core.paper.settings import PAPER


@dataclass(frozen=True)
class PaperOptions:
    """The options of one experiment of the paper's table, or of a variation of one."""

    title: str
    """The experiment's name as lists show it, in title case"""
    description: str
    """One line about the experiment, for those who choose among several"""
    method: str
    """The name of scipy's minimiser: L-BFGS-B or BFGS"""
    loss: str
    """The name of the loss in `terms`: mse, geman_mcclure or huber"""
    tips: bool
    """True if the fingertips count again, with `tip_weight`"""
    anatomical_stage: bool = False
    """True if a second stage follows, with joint limits and the 2D error only"""
    pose_prior: bool = False
    """True if a pull towards a relaxed hand acts where the keypoints do not say; not in the paper"""
    warm_start: bool = False
    """True if each frame starts from the frame before, not from the flat hand; not in the paper"""
    camera_stage: bool = False
    """True if a last stage through the camera (`terms.refine`) follows; needs the prior; not in the paper"""


@dataclass(frozen=True, eq=False)
class FrameFit:
    """The fit of one hand in one picture, still without a camera."""

    betas: np.ndarray
    """(10,) shape coefficients of the hand model"""
    global_orient: np.ndarray
    """(3,) radians, axis-angle: the root rotation in the aligned frame (near the model's own)"""
    hand_pose: np.ndarray
    """(45,) radians, axis-angle: the fingers' pose relative to the flat hand"""
    to_model: Similarity
    """The alignment, from pixels (x right, y down, z away) to metres in the aligned frame"""

    @property
    def root_rotation(self) -> np.ndarray:
        """(3,) radians, axis-angle: the root rotation towards the picture's axes, alignment inverted, then
        global_orient."""
        back = self.to_model.inverse().rotation
        return rotmat_to_rotvec(back @ rotvec_to_rotmat(self.global_orient))

    def in_picture(self, points: np.ndarray) -> np.ndarray:
        """Take points (..., 3) of the fitted model, metres in the aligned frame, to pixels with depth."""
        return self.to_model.inverse().apply(points)


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Have torch use one thread: its arrays are tiny here, so that threads would only wait for each other,
    many times slower on a busy machine."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def normalise(keypoints: np.ndarray, rest_keypoints: np.ndarray) -> Similarity:
    """Align detected keypoints (21, 3), in pixels, with the model's (21, 3) in metres, as steps 1 and 2 of
    the paper do.

    The scale is |wrist - index knuckle| of the model over the target's; rotation and translation are the
    rigid least-squares fit of the six palm points.
    """
    scale = _wrist_to_index(rest_keypoints) / max(_wrist_to_index(keypoints), 1e-9)
    palm = list(PALM_KEYPOINTS)
    rigid = align(scale * keypoints[palm], rest_keypoints[palm], with_scale=False)
    return Similarity(scale, rigid.rotation, rigid.translation)


def _wrist_to_index(keypoints: np.ndarray) -> float:
    return float(np.linalg.norm(keypoints[INDEX_KNUCKLE_KEYPOINT] - keypoints[WRIST_KEYPOINT]))


class PaperFitter:
    """The fitter of one hand model to single frames; it keeps the torch layer between frames."""

    def __init__(self, model: HandModel, options: PaperOptions) -> None:
        # These need torch, without which the experiments still have names and titles.
        import torch

        from handfit_core.paper import terms
        from handfit_core.paper.layer import HandLayer

        self._torch = torch
        self._options = options
        self._layer = HandLayer(model)
        self._rest_keypoints = model.posed(None, np.zeros(3), np.zeros(45), np.zeros(3)).keypoints
        loss = getattr(terms, options.loss)
        self._loss = terms.with_tips(loss) if options.tips else loss
        self._plain_mse = terms.mse
        if options.anatomical_stage:
            self._penalty = terms.AnatomicalPenalty(
                anatomical_axes(model), joint_limits(model.side, model.name)
            )
        self._prior = terms.RelaxedPrior(model) if options.pose_prior else None

    def fit(
        self, keypoints: np.ndarray, *, betas: np.ndarray | None = None, start: FrameFit | None = None
    ) -> FrameFit:
        """Fit (21, 3) keypoints in pixels with depth. `betas` (10,) fixes the shape; `start` is a fit to
        start from instead of the flat hand of mean shape."""
        torch = self._torch
        to_model = normalise(keypoints, self._rest_keypoints)
        target = torch.tensor(to_model.apply(keypoints))[None]
        fixed = None if betas is None else torch.tensor(betas, dtype=torch.float64)[None]

        def stage(cost_of: Callable) -> Callable[[np.ndarray], tuple[float, np.ndarray]]:
            """Return the cost of variables with its gradient; `cost_of` gets the variables, the keypoints'
            residuals in mm, and the pose."""

            def cost(x: np.ndarray) -> tuple[float, np.ndarray]:
                variables = torch.tensor(x, requires_grad=True)
                if self._prior is None:
                    orient, pose = variables[None, :3], variables[None, 3:48]
                else:
                    orient, pose = self._prior.unwhiten(variables)
                shape = variables[None, 48:] if fixed is None else fixed
                residual = (self._layer.keypoints(shape, orient, pose) - target) * 1000.0
                total = cost_of(variables, residual, pose)
                total.backward()
                assert variables.grad is not None
                return total.item(), variables.grad.numpy()

            return cost

        prior, first = self._prior, self._first_variables(start, with_shape=betas is None)
        if prior is None:
            result = self._minimise(stage(lambda _, residual, __: self._loss(residual)), first)
        else:
            result = self._minimise(stage(lambda x, residual, _: self._loss(residual) + prior(x)), first)
        if self._options.anatomical_stage:
            # The picture plane of the aligned frame: residuals seen along the picture's own z.
            plane = torch.tensor(to_model.rotation[:, :2].copy())
            limited = stage(lambda _, residual, pose: self._plain_mse(residual @ plane) + self._penalty(pose))
            result = self._minimise(limited, result.x)
        orient, pose = result.x[:3], result.x[3:48]
        if self._prior is not None:
            orient, pose = (part[0].numpy() for part in self._prior.unwhiten(torch.tensor(result.x)))
        return FrameFit(
            betas=result.x[48:] if betas is None else np.asarray(betas),
            global_orient=orient,
            hand_pose=pose,
            to_model=to_model,
        )

    def place(
        self, fit: FrameFit, keypoints: np.ndarray, intrinsics: Intrinsics, *, fit_shape: bool
    ) -> HandMotion:
        """Place a fitted hand (T = 1) before a camera, where it meets (21, 3) keypoints in pixels best.

        With `camera_stage`, pose (and shape, if `fit_shape`) are refined there.
        """
        pixels = keypoints[:, :2]
        towards = turn_to_ray(intrinsics, pixels.mean(axis=0))
        orient = rotmat_to_rotvec(towards @ rotvec_to_rotmat(fit.root_rotation))
        points = self._layer.model.keypoints(fit.betas, orient, fit.hand_pose, np.zeros(3))
        transl = place(points, pixels, intrinsics)
        side = self._layer.model.side
        placed = HandMotion(side, fit.betas, orient[None], fit.hand_pose[None], transl[None])
        if not self._options.camera_stage:
            return placed
        from handfit_core.paper.terms import refine  # needs torch

        assert self._prior is not None, "the camera stage works on the prior's variables"
        with one_thread():
            return refine(
                self._layer, self._prior, self._loss, keypoints, intrinsics, placed, fit_shape=fit_shape
            )

    def _first_variables(self, start: FrameFit | None, *, with_shape: bool) -> np.ndarray:
        orient, pose, betas = np.zeros(3), np.zeros(45), np.zeros(NUM_BETAS)
        if start is not None:
            orient, pose, betas = start.global_orient, start.hand_pose, start.betas
        first = np.concatenate([orient, pose])
        if self._prior is not None:
            first = self._prior.whiten(orient, pose)
        return np.concatenate([first, betas]) if with_shape else first

    def _minimise(self, cost: Callable[[np.ndarray], tuple[float, np.ndarray]], first: np.ndarray):
        from scipy.optimize import minimize

        options: dict[str, float] = {"maxiter": PAPER.max_iterations}
        if self._prior is not None:
            options["ftol"] = PAPER.prior_tolerance
        with one_thread():
            return minimize(cost, first, jac=True, method=self._options.method, options=options)


def _shape_of_clip(fitter: PaperFitter, keypoints: np.ndarray, should_stop: ShouldStop) -> np.ndarray:
    """Return the median shape (10,) of the shapes that a few evenly spread ones of (N, 21, 3) keypoints ask
    for; when stopped, of those that were fitted."""
    chosen = np.linspace(0, len(keypoints) - 1, min(PAPER.shape_frames, len(keypoints))).round().astype(int)
    shapes: list[np.ndarray] = []
    for i in chosen:
        shapes.append(fitter.fit(keypoints[i]).betas)
        if should_stop():
            break
    return np.median(shapes, axis=0)


def fit_track(
    options: PaperOptions,
    model: HandModel,
    track: Track,
    intrinsics: Intrinsics,
    on_frame: OnFrame,
    should_stop: ShouldStop = never,
) -> HandMotion:
    """Fit every detected frame with one shape and place the hand before the camera.

    The paper fits single pictures. A clip's hand has one shape: the median of the shapes that a few
    evenly spread frames ask for; all frames are then fitted with that. When stopped, the frames that were not
    reached are NaN.
    """
    fitter = PaperFitter(model, options)
    found = track.detections.keypoints
    shape = _shape_of_clip(fitter, found, should_stop) if len(found) > 1 else None
    fit_shape = shape is None
    placed: list[HandMotion] = []
    previous: FrameFit | None = None
    for keypoints in found:
        start = previous if options.warm_start else None
        fit = previous = fitter.fit(keypoints, betas=shape, start=start)
        placed.append(fitter.place(fit, keypoints, intrinsics, fit_shape=fit_shape))
        if fit_shape:
            shape = placed[-1].betas
        on_frame()
        if should_stop():
            break
    assert shape is not None, "a track has at least one detection"
    frames, count = track.detections.frame[: len(placed)], track.frame_count
    poses = (np.concatenate([hand.pose[i] for hand in placed]) for i in range(len(POSE_ARRAYS)))
    return HandMotion(model.side, shape, *(scatter(rows, frames, count) for rows in poses))
