"""The paper's method: recover what a forward pass made, fall in cost, place what it fitted."""

from typing import Any

import numpy as np
import pytest

from handfit_core.common.skeleton import PALM_KEYPOINTS, SIDES, Side
from handfit_core.detect.keypoints import Detections
from handfit_core.fit.solvers import get_solver
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model import HandModel, load_model
from handfit_core.paper import EXPERIMENTS
from handfit_core.paper.fitter import PaperFitter, normalise
from tests.core.fit.detections import track_of

RNG = np.random.default_rng(11)
ZERO = np.zeros(3)


def every_day_one(first: str, *others: str) -> list[Any]:
    """Values to try, of which all but the first are slow."""
    return [first, *(pytest.param(other, marks=pytest.mark.slow) for other in others)]


def seen(model: HandModel, *, seed: int, noise: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """(21, 3) keypoints in pixels with depth, as an orthographic detector would see a random pose, and
    the pose (45,)."""
    rng = np.random.default_rng(seed)
    pose = 0.7 * model.hands_mean + rng.normal(scale=0.06, size=45)
    points = model.keypoints(rng.normal(size=10), rng.normal(size=3), pose, ZERO)
    pixels = 2000.0 * (points - points[0]) + [320.0, 240.0, 0.0]
    return pixels + rng.normal(scale=noise, size=(21, 3)), pose


def test_normalisation_is_the_papers() -> None:
    """Scale from keypoints 0 and 5, then the palm rigidly; as a 4x4 matrix."""
    model = load_model(None, "right")
    rest = model.keypoints(None, ZERO, np.zeros(45), ZERO)
    turn = rotvec_to_rotmat(np.array([0.4, 2.0, -1.0]))
    moved = 1500.0 * rest @ turn.T + [300.0, 200.0, 10.0]
    found = normalise(moved, rest)
    assert found.scale == pytest.approx(1 / 1500.0)
    homogeneous = np.column_stack([moved, np.ones(21)]) @ found.matrix.T
    np.testing.assert_allclose(homogeneous[:, :3], rest, atol=1e-12)
    np.testing.assert_allclose(found.rotation, turn.T, atol=1e-9)
    # The fingers have no say.
    bent = moved.copy()
    outside = [k for k in range(21) if k not in PALM_KEYPOINTS]
    bent[outside] += RNG.normal(scale=50.0, size=(len(outside), 3))
    np.testing.assert_allclose(normalise(bent, rest).matrix, found.matrix)


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("name", every_day_one("paper-a", "paper-c", "paper-g"))
def test_recovers_what_a_forward_pass_made(name: str, side: Side) -> None:
    model = load_model(None, side)
    keypoints, _ = seen(model, seed=4)
    fit = PaperFitter(model, EXPERIMENTS[name]).fit(keypoints)
    fitted = fit.in_picture(model.keypoints(fit.betas, fit.global_orient, fit.hand_pose, ZERO))
    assert np.linalg.norm(fitted - keypoints, axis=-1).max() < 4.0  # px of 2000 px/m: 2 mm
    # The same from the root rotation alone, without the aligned frame.
    direct = model.keypoints(fit.betas, fit.root_rotation, fit.hand_pose, ZERO) / fit.to_model.scale
    np.testing.assert_allclose(direct - direct[0], fitted - fitted[0], atol=1e-6)


@pytest.mark.parametrize("name", every_day_one(*EXPERIMENTS))
def test_every_solver_beats_its_start(name: str) -> None:
    model = load_model(None, "right")
    keypoints, _ = seen(model, seed=2, noise=4.0)
    fitter = PaperFitter(model, EXPERIMENTS[name])
    fit = fitter.fit(keypoints)
    fitted = fit.in_picture(model.keypoints(fit.betas, fit.global_orient, fit.hand_pose, ZERO))
    start = fit.in_picture(model.keypoints(None, ZERO, np.zeros(45), ZERO))
    axes = slice(0, 2) if EXPERIMENTS[name].anatomical_stage else slice(0, 3)

    def error(points: np.ndarray) -> float:
        return float(np.linalg.norm((points - keypoints)[:, axes], axis=-1).mean())

    assert error(fitted) < 0.5 * error(start)
    fixed = fitter.fit(keypoints, betas=np.zeros(10))
    np.testing.assert_array_equal(fixed.betas, np.zeros(10))


@pytest.mark.slow
def test_prior_keeps_hinges_straight() -> None:
    """Noise must not come out as twisted finger joints; that is what the default's prior is for."""
    from handfit_core.hand_model.anatomy import anatomical_angles, anatomical_axes

    model = load_model(None, "right")
    twists = {}
    for name in ("paper-a", "paper-a-plus"):
        angles = []
        for seed in range(3):
            keypoints, _ = seen(model, seed=seed, noise=8.0)
            fit = PaperFitter(model, EXPERIMENTS[name]).fit(keypoints)
            rotmats = rotvec_to_rotmat(fit.hand_pose.reshape(15, 3))
            angles.append(anatomical_angles(rotmats, anatomical_axes(model))[:, 0])
        twists[name] = np.abs(angles).mean()
    assert twists["paper-a-plus"] < 0.5 * twists["paper-a"]


@pytest.mark.parametrize("side", every_day_one(*SIDES))
def test_track_is_placed_before_the_camera(side: Side) -> None:
    """Keypoints made by a perspective camera off its axis: the fitted track lies over them."""
    model = load_model(None, side)
    # A long lens: the method takes the hand's own perspective for none.
    camera = Intrinsics(2000.0, 2000.0, 320.0, 240.0)
    betas = 0.5 * RNG.normal(size=10)
    detections: list[Detections | None] = []
    truth = []
    for t in range(4):
        orient = np.array([0.2 * t, 1.2, -0.3])
        transl = np.array([0.1 - 0.05 * t, 0.05, 1.5])
        points = model.keypoints(betas, orient, (0.3 + 0.2 * t) * model.hands_mean, transl)
        truth.append(points)
        pixels = camera.project(points)
        depth = (points[:, 2] - points[0, 2]) * camera.fx / points[:, 2].mean()
        detections.append(
            Detections.hand(side, 0.9, np.column_stack([pixels, depth]), points - points.mean(axis=0))
        )
    detections.insert(2, None)
    track = track_of(side, detections)
    ticks: list[int] = []
    fit = get_solver("paper-a-plus")(model, track, camera, lambda: ticks.append(1))
    assert len(ticks) == 4
    for array in (fit.global_orient, fit.hand_pose, fit.transl):
        assert np.isnan(array[2]).all()
        assert np.isfinite(array[[0, 1, 3, 4]]).all()
    points = model.keypoints(fit.betas, fit.global_orient, fit.hand_pose, fit.transl)[[0, 1, 3, 4]]
    errors = np.linalg.norm(camera.project(points) - camera.project(np.array(truth)), axis=-1)
    size = np.ptp(camera.project(truth[0]), axis=0).max()
    assert errors.mean() < 0.03 * size
    # The size of a hand is not seen in one view, its pose is: compare about the wrist, scale removed.
    for found, expected in zip(points, truth, strict=True):
        found, expected = found - found[0], expected - expected[0]
        found = found * np.linalg.norm(expected) / np.linalg.norm(found)
        assert np.linalg.norm(found - expected, axis=-1).mean() < 0.008
