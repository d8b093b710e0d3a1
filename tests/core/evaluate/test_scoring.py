from __future__ import annotations

import numpy as np
import pytest

from handfit_core.errors import DatasetError
from handfit_core.evaluate.labels import HandLabel, MeshLabel, Problem, units_of
from handfit_core.evaluate.rows import Row, rows_of
from handfit_core.evaluate.scoring import RowResult, score
from handfit_core.hand_model import load_model
from tests.core.evaluate.hands import entry, found, joints, label, seen

RIGHT, LEFT = load_model(None, "right"), load_model(None, "left")
TRUTH = joints()
SURFACE = RIGHT.posed(None, np.zeros(3), RIGHT.hands_mean, np.array([0.0, 0.0, 0.5]))


def rows(mesh: MeshLabel | None) -> list[Row]:
    hand = label(SURFACE.keypoints)
    hand = HandLabel(hand.side, hand.joints_3d, hand.keypoints_2d, mesh)
    return rows_of(
        units_of([entry("a", hand)]),
        lambda _: found((seen(SURFACE.keypoints),)),
        protocol="strict",
        max_hands=2,
        camera="assumed",
    ).rows


def result(vertices: np.ndarray, model=RIGHT) -> RowResult:
    return RowResult(SURFACE.keypoints, seen(SURFACE.keypoints).keypoints, 1.0, model, vertices)


def scored(mesh: MeshLabel | None, fitted: RowResult, problems: dict[Problem, None] | None = None):
    return score("m", "m", lambda _: fitted, rows(mesh), "strict", problems)


def test_a_perfect_surface_has_no_error_wherever_it_stands() -> None:
    mesh = MeshLabel(lambda: SURFACE.vertices, frozenset({RIGHT.digest, LEFT.digest}))
    made = scored(mesh, result(1.3 * SURFACE.vertices + 0.1))
    assert made.pa_mpvpe[0] == pytest.approx(0.0, abs=1e-6)
    assert made.f5[0] == made.f15[0] == 1.0


def test_a_hand_of_the_wrong_side_stays_in_the_mean_with_its_error() -> None:
    mesh = MeshLabel(lambda: SURFACE.vertices, frozenset({RIGHT.digest, LEFT.digest}))
    mirrored = LEFT.posed(None, np.zeros(3), LEFT.hands_mean, np.array([0.0, 0.0, 0.5])).vertices
    made = scored(mesh, result(mirrored, LEFT))
    assert made.pa_mpvpe[0] > 3.0
    assert made.f5[0] < 0.95


def test_surfaces_of_another_model_have_f_scores_only() -> None:
    other = MeshLabel(lambda: SURFACE.vertices[::2], frozenset({"another"}))
    made = scored(other, result(SURFACE.vertices))
    assert np.isnan(made.pa_mpvpe[0])
    # Vertices of the fuller mesh lie between those of the other.
    assert 0.9 < made.f5[0] <= 1.0
    same_count = MeshLabel(lambda: SURFACE.vertices, frozenset({"another"}))
    assert np.isnan(scored(same_count, result(SURFACE.vertices)).pa_mpvpe[0])


def test_a_mesh_that_cannot_be_read_is_named_once_and_the_joints_are_scored() -> None:
    def damaged() -> np.ndarray:
        raise DatasetError("evaluation_verts.json: entry 7 is null")

    problems: dict[Problem, None] = {}
    for _ in range(2):  # two methods
        made = scored(MeshLabel(damaged), result(SURFACE.vertices), problems)
    assert np.isnan(made.f5[0])
    assert made.pa_error[0].max() < 1e-6
    assert [(p.kind, p.where) for p in problems] == [
        ("mesh cannot be read", "a: evaluation_verts.json: entry 7 is null")
    ]
