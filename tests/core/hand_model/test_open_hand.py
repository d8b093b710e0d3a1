"""The bundled open hand: anatomy, MANO's conventions, mesh quality, and that the script still makes it."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import zipfile
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from handfit_core.hand_model.anatomy import anatomical_axes
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.files import load_model
from handfit_core.hand_model.nails import nail_polygons
from handfit_core.skeleton import FINGER_JOINTS, FINGERS, MANO_TIP_VERTICES, SIDES, Side
from tests.conftest import ROOT
from tests.imitation_mano import imitation_model

DATA = ROOT / "handfit_core" / "hand_model" / "data"

DIGESTS = {"left": "d5277cb79ad187db", "right": "fe78432b240b7389"}


@pytest.fixture(params=SIDES)
def side(request) -> Side:
    return request.param


@pytest.fixture
def model(side: Side) -> HandModel:
    return load_model(None, side)


@pytest.fixture
def outwards(side: Side) -> float:
    """Sign of x towards the wrist."""
    return 1.0 if side == "right" else -1.0


def finger_points(model: HandModel, finger: str) -> np.ndarray:
    """(5, 3) wrist, the finger's three joints, its tip, in mm."""
    shaped = model.shaped()
    tip = shaped.tips[FINGERS.index(finger)]
    return 1000.0 * np.stack([shaped.joints[0], *shaped.joints[list(FINGER_JOINTS[finger])], tip])


def directed_edges(faces: np.ndarray) -> np.ndarray:
    return np.concatenate(
        [np.stack([faces[:, i], np.roll(faces, -1, 1)[:, i]], 1) for i in range(faces.shape[1])]
    )


def rim(model: HandModel) -> np.ndarray:
    """(E, 2) directed edges that close the wrist's opening."""
    edges = {tuple(edge) for edge in directed_edges(model.faces).tolist()}
    return np.array(sorted((b, a) for a, b in edges if (b, a) not in edges))


def closed_triangles(model: HandModel, vertices: np.ndarray) -> np.ndarray:
    """(F', 3, 3) corners of the mesh with the wrist's opening covered."""
    edges = vertices[rim(model)]
    centre = np.broadcast_to(edges.mean(axis=(0, 1)), (len(edges), 1, 3))
    return np.concatenate([vertices[model.faces], np.concatenate([edges, centre], axis=1)])


def volume(model: HandModel, vertices: np.ndarray) -> float:
    corners = closed_triangles(model, vertices)
    return float(np.sum(corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])) / 6.0)


def test_is_the_one_that_takes_were_made_with(model, side):
    assert model.digest == DIGESTS[side]


def test_sides_are_exact_mirror_images():
    right, left = load_model(None, "right"), load_model(None, "left")
    flip = np.array([-1.0, 1.0, 1.0])
    np.testing.assert_array_equal(left.v_template, right.v_template * flip)
    np.testing.assert_array_equal(left.shapedirs, right.shapedirs * flip[:, None])
    for name in ("joint_regressor", "weights", "tip_vertices", "uv"):
        np.testing.assert_array_equal(getattr(left, name), getattr(right, name))
    for name in ("faces", "quads", "uv_faces"):
        np.testing.assert_array_equal(getattr(left, name), getattr(right, name)[:, ::-1])
    rng = np.random.default_rng(0)
    betas, turn = rng.normal(size=10), np.array([1.0, -1.0, -1.0])
    orient, pose, transl = rng.normal(size=3), 0.3 * rng.normal(size=45), rng.normal(size=3)
    one = right.posed(betas, orient, pose, transl)
    other = left.posed(betas, orient * turn, pose * np.tile(turn, 15), transl * flip)
    np.testing.assert_allclose(other.vertices, one.vertices * flip, atol=1e-12)
    np.testing.assert_allclose(left.hands_mean, right.hands_mean * np.tile(turn, 15), atol=0)
    np.testing.assert_allclose(left.hands_components, right.hands_components * np.tile(turn, 15), atol=0)


def test_flat_hand_lies_as_manos(model, outwards):
    """The wrist at MANO's place with little of the arm; straight fingers that fan in the palm's plane."""
    shaped = model.shaped()
    np.testing.assert_allclose(shaped.joints[0], (0.096 * outwards, 0.006, 0.006), atol=1e-4)
    assert 0.005 < (model.v_template[:, 0] * outwards).max() - 0.096 < 0.030
    for finger in FINGERS:
        points = finger_points(model, finger) * (outwards, 1.0, 1.0)
        bones = np.diff(points[1:], axis=0)
        along, bent, straight = (bones / np.linalg.norm(bones, axis=1, keepdims=True))[::-1]
        off = np.degrees(np.arccos(np.clip([straight @ along, bent @ along], -1, 1)))
        assert np.all(off < ((12.0, 7.0) if finger == "thumb" else 1.0)), finger
        azimuth, elevation = np.degrees([np.arctan2(along[2], -along[0]), np.arcsin(along[1])])
        if finger == "thumb":
            assert 35 < azimuth < 55
            assert -15 < elevation < 3
        else:
            assert -20 < azimuth < 10, finger
            assert abs(elevation) < 2, finger
            assert abs(points[1, 1] - points[0, 1]) < 10.0, "knuckles lie in the palm, but for its arch"
    assert np.all(np.diff(shaped.tips[:, 2]) < 0)
    assert np.all(np.diff(shaped.joints[[FINGER_JOINTS[f][0] for f in FINGERS[1:]], 2]) < 0)


def test_skin_weights(model):
    assert model.weights.min() >= 0
    np.testing.assert_allclose(model.weights.sum(axis=1), 1.0, atol=1e-12)
    # Every joint moves some skin almost alone; the thumb's saddle joint shares its thick ball with the palm.
    assert np.all(np.delete(model.weights.max(axis=0), FINGER_JOINTS["thumb"][0]) > 0.95)
    assert model.weights[:, FINGER_JOINTS["thumb"][0]].max() > 0.7
    # No skin of one finger follows another one's end joints.
    for finger, chain in FINGER_JOINTS.items():
        mine = model.weights[:, chain[2]] > 0.5
        others = [j for f, c in FINGER_JOINTS.items() if f != finger for j in c]
        assert model.weights[mine][:, others].max() < 1e-3


def test_tip_vertices(model):
    """The farthest of each finger; those that other programs name are its neighbours."""
    assert tuple(model.tip_vertices) == MANO_TIP_VERTICES
    shaped = model.shaped()
    for finger, tip, near in zip(FINGERS, shaped.tips, ([744], [320], [445, 443], [554], [671]), strict=True):
        last = FINGER_JOINTS[finger][2]
        along = (tip - shaped.joints[last]) / np.linalg.norm(tip - shaped.joints[last])
        assert ((model.v_template[model.weights[:, last] > 0.5] - tip) @ along).max() < 5e-4
        assert np.linalg.norm(model.v_template[near] - tip, axis=1).max() < 0.005


def test_mesh_is_open_manifold(model):
    edges = directed_edges(model.faces)
    assert max(Counter(map(tuple, edges.tolist())).values()) == 1, "an edge is used twice the same way"
    assert max(Counter(map(tuple, np.sort(edges, axis=1).tolist())).values()) == 2
    opening = rim(model)
    assert len(opening) == 20
    assert sorted(opening[:, 0]) == sorted(opening[:, 1]), "one loop at the wrist"
    # Euler characteristic of a disc: one piece, one hole, no handle.
    assert len(model.v_template) - len(np.unique(np.sort(edges, axis=1), axis=0)) + len(model.faces) == 1
    assert 2.0e-4 < volume(model, model.v_template) < 5.0e-4  # a hand has about 0.35 l


def test_quads_and_texture_coordinates(model):
    assert model.quads is not None and model.uv is not None and model.uv_faces is not None  # noqa: PT018
    assert model.quads.shape == model.uv_faces.shape == (1598, 4)
    assert len(model.faces) == 2 * len(model.quads)
    assert [set(t.ravel().tolist()) for t in model.faces.reshape(-1, 2, 3)] == [
        set(q) for q in model.quads.tolist()
    ]
    assert set(model.quads.ravel()) == set(range(len(model.v_template)))
    assert model.uv.min() >= 0
    assert model.uv.max() <= 1
    assert set(model.uv_faces.ravel()) == set(range(len(model.uv)))
    # A vertex has one texture coordinate, or a few along a seam.
    pairs = np.unique(np.stack([model.quads.ravel(), model.uv_faces.ravel()], 1), axis=0)
    assert len(model.v_template) <= len(pairs) < 1.3 * len(model.v_template)


def fist_over_flat(model: HandModel) -> float:
    """The fist's volume over the flat hand's."""
    axes, pose = anatomical_axes(model), np.zeros((15, 3))
    for finger, chain in FINGER_JOINTS.items():
        bends = np.radians((20, 30, 40) if finger == "thumb" else (85, 95, 60))
        rows = np.array(chain) - 1
        pose[rows] = bends[:, None] * axes[rows, :, 2]
    fist, flat = (
        volume(model, model.posed(None, np.zeros(3), each.ravel(), np.zeros(3)).vertices)
        for each in (pose, np.zeros_like(pose))
    )
    return fist / flat


def test_a_fist_keeps_its_flesh(model):
    """Skinning alone does not."""
    assert 0.98 < fist_over_flat(model) < 1.0
    assert fist_over_flat(replace(model, posedirs=np.zeros_like(model.posedirs))) < 0.93


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


def test_files_have_no_pickles(side):
    path = DATA / f"open_hand_{side}.npz"
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


def test_the_script_says_how_to_get_anny(tmp_path):
    (tmp_path / "anny.py").write_text("raise ImportError('hidden')")  # also where it is installed
    script = ROOT / "scripts" / "build_open_hand.py"
    env = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=False, env=env)
    assert done.returncode == 2
    assert "pip install" in done.stdout.splitlines()[-1]
