"""Models with a closed wrist: watertight, the model's own where it was, and shaped as the model is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from handfit_core.common.skeleton import SIDES
from handfit_core.hand_model import HandModel, load_model
from handfit_core.hand_model.forearm import with_wrist, wrist_ring


@pytest.fixture(params=["quads", "triangles"])
def model(request) -> HandModel:
    """The open hand; and as MANO's files are, of triangles without texture, with pose directions."""
    hand = load_model(None, "right")
    if request.param == "quads":
        return hand
    posedirs = np.random.default_rng(0).normal(scale=1e-3, size=hand.posedirs.shape)
    return replace(hand, quads=None, uv=None, uv_faces=None, posedirs=posedirs)


def walked_edges(polygons: np.ndarray) -> list[tuple[int, int]]:
    return list(zip(polygons.ravel().tolist(), np.roll(polygons, -1, axis=1).ravel().tolist(), strict=True))


@pytest.mark.parametrize("wrist", ["cap", "forearm"])
def test_mesh_is_closed(model, wrist):
    closed, ring = with_wrist(model, wrist), wrist_ring(model.polygons).tolist()
    open_edges = set(walked_edges(model.polygons))
    around = set(zip(ring, ring[1:] + ring[:1], strict=True))
    assert around == {(a, b) for a, b in open_edges if (b, a) not in open_edges}
    longer = np.ptp(closed.v_template[:, 0]) - np.ptp(model.v_template[:, 0])
    assert longer < 0.012 if wrist == "cap" else 0.05 < longer < 0.08
    np.testing.assert_array_equal(closed.weights[len(model.v_template) :, 0], 1.0)
    for polygons in (closed.polygons, closed.faces):
        edges = walked_edges(polygons)
        assert len(edges) == len(set(edges))
        assert {(b, a) for a, b in edges} == set(edges), "every edge is walked once in each direction"
    corners = closed.v_template[closed.faces]
    volume = np.sum(corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])) / 6.0
    assert 2e-4 < volume < 8e-4, "cubic metres of a hand, counted positive if faces look outward"
    assert wrist_ring(closed.polygons).size == 0
    assert with_wrist(closed, wrist) is closed, "there is nothing to close"


@pytest.mark.parametrize("side", SIDES)
def test_what_is_the_models_stays_as_it_is(side):
    own = load_model(None, side)
    count = len(own.v_template)
    rng = np.random.default_rng(1)
    pose = (rng.normal(size=10), rng.normal(size=3), rng.normal(scale=0.3, size=45), rng.normal(size=3))
    for closed in (with_wrist(own, "cap"), with_wrist(own, "forearm")):
        posed, expected = closed.posed(*pose), own.posed(*pose)
        np.testing.assert_allclose(posed.vertices[:count], expected.vertices, atol=1e-9)
        np.testing.assert_allclose(posed.keypoints, expected.keypoints, atol=1e-9)
        np.testing.assert_array_equal(closed.polygons[: len(own.polygons)], own.polygons)
        np.testing.assert_array_equal(closed.faces[: len(own.faces)], own.faces)
    assert with_wrist(own, "open") is own


@pytest.mark.parametrize("wrist", ["cap", "forearm"])
def test_directions_carry_over(model, wrist):
    """Closing a shaped hand and shaping a closed one are the same."""
    betas = np.array([1.5, -2.0, 1.0, 0.5, -1.0, 2.0, -0.5, 1.0, -1.5, 0.7])
    closed = with_wrist(model, wrist)
    for moved, expected in (
        (closed.shaped(betas).vertices, model.shaped(betas).vertices),
        (closed.v_template + closed.posedirs[..., 7], model.v_template + model.posedirs[..., 7]),
    ):
        first = with_wrist(replace(model, v_template=expected), wrist).v_template
        np.testing.assert_allclose(moved, first, atol=1e-12)


def test_the_texture_goes_on_from_the_edge():
    model = load_model(None, "right")
    closed = with_wrist(model, "forearm")
    assert closed.uv is not None and closed.uv_faces is not None and model.uv is not None  # noqa: PT018
    added = closed.uv[closed.uv_faces[len(model.polygons) :]]
    assert added.min() >= 0.0
    assert added.max() <= 1.0
    first = added[: len(wrist_ring(model.polygons)), :2]  # the side of each polygon that lies at the edge
    distance = np.linalg.norm(first[:, :, None] - model.uv[None, None], axis=-1).min(axis=-1)
    np.testing.assert_allclose(distance, 0.0, atol=1e-12)
