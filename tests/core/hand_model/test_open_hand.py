"""The bundled open hand: that it is the same, what it does when it is posed, and that the script makes it."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import zipfile
from dataclasses import replace
from hashlib import sha256

import numpy as np
import pytest

from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, SIDES, Side
from handfit_core.hand_model.anatomy import anatomical_axes
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.files import load_model
from handfit_core.hand_model.forearm import with_wrist
from handfit_core.hand_model.nails import nail_polygons
from handfit_core.hand_model.poses import ready_poses
from scripts.benchmark.meshes import face_normals
from tests.conftest import ROOT
from tests.imitation_mano import imitation_model

DATA = ROOT / "handfit_core" / "hand_model" / "data"

DIGESTS = {
    "left": ("87d6428882f73a97", "a7ac88c198b3d250"),
    "right": ("09cd5eaf37f55ae6", "3873654b5bbc55a0"),
}
"""Of the arrays that takes name, and of the whole file, whose anatomy and mesh were looked at"""


@pytest.fixture(params=SIDES)
def side(request) -> Side:
    return request.param


@pytest.fixture
def model(side: Side) -> HandModel:
    return load_model(None, side)


def test_sides_are_mirror_images():
    right, left = load_model(None, "right"), load_model(None, "left")
    flip = np.array([-1.0, 1.0, 1.0])
    rng = np.random.default_rng(0)
    betas, turn = rng.normal(size=10), np.array([1.0, -1.0, -1.0])
    orient, pose, transl = rng.normal(size=3), 0.3 * rng.normal(size=45), rng.normal(size=3)
    one = right.posed(betas, orient, pose, transl)
    other = left.posed(betas, orient * turn, pose * np.tile(turn, 15), transl * flip)
    np.testing.assert_allclose(other.vertices, one.vertices * flip, atol=1e-12)
    np.testing.assert_allclose(left.hands_mean, right.hands_mean * np.tile(turn, 15), atol=0)
    np.testing.assert_allclose(left.hands_components, right.hands_components * np.tile(turn, 15), atol=0)


def fist_over_flat(model: HandModel) -> float:
    """The fist's volume over the flat hand's, both with a closed wrist."""
    axes, pose = anatomical_axes(model), np.zeros((2, 15, 3))
    for finger, chain in FINGER_JOINTS.items():
        bends = np.radians((20, 30, 40) if finger == "thumb" else (85, 95, 60))
        rows = np.array(chain) - 1
        pose[0, rows] = bends[:, None] * axes[rows, :, 2]
    closed = with_wrist(model, "cap")
    zero = np.zeros((2, 3))
    corners = closed.posed(None, zero, pose.reshape(2, 45), zero).vertices[:, closed.faces]
    fist, flat = (corners[:, :, 0] * np.cross(corners[:, :, 1], corners[:, :, 2])).sum(axis=(1, 2))
    return float(fist / flat)


def test_a_fist_keeps_its_flesh(model):
    """Skinning alone does not."""
    assert 0.975 < fist_over_flat(model) < 1.0
    assert fist_over_flat(replace(model, posedirs=np.zeros_like(model.posedirs))) < 0.93


def folds(model: HandModel) -> float:
    """Root mean square in degrees of how much more than at rest the skin is folded along the edges of quads
    where the thumb's weights meet the palm's and the index finger's, over ready poses of closed hands."""
    rest, thumb = model.v_template, model.weights[:, list(FINGER_JOINTS["thumb"])].sum(axis=1)
    sides: dict[tuple[int, int], list[int]] = {}
    for number, quad in enumerate(model.polygons.tolist()):
        for pair in zip(quad, quad[1:] + quad[:1], strict=True):
            sides.setdefault((min(pair), max(pair)), []).append(number)
    meets = (thumb > 0.05) & (thumb < 0.95)
    faces = np.array([two for (a, b), two in sides.items() if len(two) == 2 and meets[a] and meets[b]])

    def angles(vertices: np.ndarray) -> np.ndarray:
        normals = face_normals(vertices, model.polygons)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        one, other = normals[faces.T]
        return np.degrees(np.arccos(np.clip(np.sum(one * other, axis=1), -1.0, 1.0)))

    zero = np.zeros(3)
    poses = (ready_poses()[name].pose.on(model.side) for name in ("Fist", "Letter S", "Letter E", "Letter N"))
    more = [angles(model.posed(None, zero, pose, zero).vertices) - angles(rest) for pose in poses]
    return float(np.sqrt(np.mean(np.square(more))))


def test_the_thumbs_base_has_no_jagged_folds(model):
    """Flesh alone left 17 degrees."""
    assert folds(model) < 15.5


def test_nails(model, side):
    """One plate a finger, on its back, at its end; other models have skin alone."""
    nails = np.flatnonzero(nail_polygons(model))
    corners = model.v_template[model.polygons[nails]]
    normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    axes, shaped = anatomical_axes(model), model.shaped()
    counted = 0
    for finger, tip in zip(FINGERS, shaped.tips, strict=True):
        joint = FINGER_JOINTS[finger][2]
        own = model.weights[model.polygons[nails]][..., joint].min(axis=1) > 0.9
        counted += int(own.sum())
        along = (corners[own].mean(axis=1) - shaped.joints[joint]) @ -axes[joint - 1][:, 0]
        length = np.linalg.norm(tip - shaped.joints[joint])
        assert 0.4 < along.min() / length < along.max() / length < 1.0, finger
        assert (normals[own] @ axes[joint - 1][:, 1]).min() > 0.6, finger
    assert counted == len(nails) > 0
    assert not nail_polygons(imitation_model(side)).any()


def test_files_are_the_ones_that_takes_were_made_with(model, side):
    """No pickles, and no time of day."""
    path = DATA / f"open_hand_{side}.npz"
    assert (model.digest, sha256(path.read_bytes()).hexdigest()[:16]) == DIGESTS[side]
    assert path.stat().st_size < 1_000_000
    with np.load(path, allow_pickle=False) as archive:
        assert all(archive[name].dtype != object for name in archive.files)
        assert "CC0" in str(archive["header"])
    with zipfile.ZipFile(path) as archive:
        assert {info.date_time for info in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}


def test_script_builds_files():
    """About a minute; needs anny, here or in the interpreter that HANDFIT_ANNY_PYTHON names."""
    python = os.environ.get("HANDFIT_ANNY_PYTHON", "")
    if not python and importlib.util.find_spec("anny") is not None:
        python = sys.executable
    if not python:
        pytest.skip("anny is not installed and HANDFIT_ANNY_PYTHON names no interpreter that has it")
    script = ROOT / "scripts" / "build_open_hand.py"
    done = subprocess.run([python, str(script), "--check"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
