from __future__ import annotations

import numpy as np
import pytest

from handfit_core.errors import DatasetError
from handfit_core.evaluate.labels import HandLabel, MeshLabel, Problem, units_of
from handfit_core.evaluate.methods import TrackResult
from handfit_core.evaluate.rows import Rows, rows_of
from handfit_core.evaluate.scores import Scores
from handfit_core.evaluate.scoring import collapsed_to_centroid, mean_pose_at_truth, results_of_rows, score
from handfit_core.geometry.similarity import align
from handfit_core.hand_model import HandModel, load_model
from handfit_core.skeleton import SIDES, Side
from tests.core.evaluate.factory import make_hands
from tests.core.evaluate.hands import entry, found, joints, label, seen

RIGHT, LEFT = load_model(None, "right"), load_model(None, "left")
DIGESTS = frozenset({RIGHT.digest, LEFT.digest})
RNG = np.random.default_rng(5)
AT = np.array([0.0, 0.0, 0.5])


def surface(model: HandModel = RIGHT, pose: np.ndarray | None = None):
    return model.posed(None, np.zeros(3), model.hands_mean if pose is None else pose, AT)


def rows(mesh: MeshLabel | None, side: Side = "right") -> Rows:
    hand = label(surface().keypoints)
    hand = HandLabel(hand.side, hand.joints_3d, hand.keypoints_2d, mesh)
    seen_as = seen(surface().keypoints, side)
    return rows_of(
        units_of([entry("a", hand)]), lambda _: found((seen_as,)), protocol="strict", camera="assumed"
    )


def scored(
    mesh: MeshLabel | None,
    model: HandModel = RIGHT,
    pose: np.ndarray | None = None,
    problems: dict[Problem, None] | None = None,
) -> Scores:
    points = surface(model, pose).keypoints[None]
    parameters = np.concatenate([np.zeros(13), model.hands_mean if pose is None else pose, AT])[None]
    one = np.ones(1)
    result = TrackResult(points, np.zeros((1, 21, 3)), one, parameters, 0.005 * one)
    made = rows(mesh, model.side)
    return score("m", "m", result, made, "strict", {model.side: model}, problems)


def test_a_perfect_surface_has_no_error() -> None:
    hand = scored(MeshLabel(lambda: surface().vertices + 0.1, DIGESTS)).hands.loc[0]
    assert hand["pa_mpvpe"] == pytest.approx(0.0, abs=1e-6)
    assert hand["f5"] == hand["f15"] == 1.0
    assert (hand["fit_ms"], hand["expected_error"]) == (1.0, 5.0)


def test_a_hand_of_the_wrong_side_stays_in_the_mean_with_its_error() -> None:
    hand = scored(MeshLabel(lambda: surface().vertices, DIGESTS), LEFT).hands.loc[0]
    assert hand["pa_mpvpe"] > 3.0
    assert hand["f5"] < 0.95


def test_surfaces_of_another_model_have_f_scores_only() -> None:
    other = scored(MeshLabel(lambda: surface().vertices[::2], frozenset({"another"}))).hands.loc[0]
    assert np.isnan(other["pa_mpvpe"])
    # Vertices of the fuller mesh lie between those of the other.
    assert 0.9 < other["f5"] <= 1.0
    same_count = MeshLabel(lambda: surface().vertices, frozenset({"another"}))
    assert np.isnan(scored(same_count).hands["pa_mpvpe"][0])


def test_a_mesh_that_cannot_be_read_is_named_once_and_the_joints_are_scored() -> None:
    def damaged() -> np.ndarray:
        raise DatasetError("evaluation_verts.json: entry 7 is null")

    problems: dict[Problem, None] = {}
    for _ in range(2):  # two methods
        made = scored(MeshLabel(damaged), problems=problems)
    assert np.isnan(made.hands["f5"][0])
    assert made.pa_error[0].max() < 1e-6
    assert [(p.kind, p.where) for p in problems] == [
        ("mesh cannot be read", "a: evaluation_verts.json: entry 7 is null")
    ]


def test_how_deep_a_fitted_hand_stands_in_itself() -> None:
    crossed = np.zeros((15, 3))
    crossed[0, 1], crossed[3, 1] = np.radians([-25.0, 25.0])  # the index finger into the middle finger
    depths = [scored(None, pose=p).hands["penetration"][0] for p in (np.zeros(45), crossed.ravel())]
    assert depths[0] == 0.0
    assert 4.0 < depths[1] < 20.0


def test_rows_take_their_tracks_frames_and_misses_are_nan() -> None:
    truth = joints()
    frames = [entry(f"{i}", label(truth), clip="a", time=i / 25) for i in range(3)]
    made = rows_of(
        units_of(frames),
        lambda _: found((seen(truth),), (), (seen(truth),)),
        protocol="strict",
        camera="assumed",
    )
    points = np.arange(3.0)[:, None, None] * np.ones((3, 21, 3))
    result = results_of_rows(made, [TrackResult.of_points(points, points, np.arange(3.0))])
    np.testing.assert_array_equal(result.milliseconds, [0.0, np.nan, 2.0])
    assert np.isnan(results_of_rows(made, [result]).points_3d[1]).all()


# Baselines


def test_all_points_at_the_centroid_of_the_labelled_ones() -> None:
    labels = make_hands(1)[0]
    labels[[0, 5, 13]] = np.nan
    rows = [i for i in range(21) if i not in (0, 5, 13)]
    np.testing.assert_allclose(
        collapsed_to_centroid(labels), np.tile(sum(labels[i] for i in rows) / 18, (21, 1))
    )
    assert np.isnan(collapsed_to_centroid(np.full((21, 3), np.nan))).all()


@pytest.mark.parametrize("side", SIDES)
def test_a_relaxed_hand_is_found_again(side: Side) -> None:
    model = load_model("open-hand", side)
    truth = model.keypoints(None, RNG.normal(size=3), model.hands_mean, np.array([0.1, 0.0, 0.6]))
    labels = truth.copy()
    labels[[1, 2, 3, 15]] = np.nan
    # Also where there was no label
    np.testing.assert_allclose(mean_pose_at_truth(model, labels), truth, atol=1e-12)


def test_size_and_pose_stay_those_of_the_model() -> None:
    relaxed = RIGHT.keypoints(None, np.zeros(3), RIGHT.hands_mean, np.zeros(3))
    fist = RIGHT.keypoints(None, RNG.normal(size=3), np.full(45, 0.4), np.array([0.0, 0.1, 0.5]))
    found = mean_pose_at_truth(RIGHT, 1.3 * fist)
    back = align(found, relaxed, with_scale=False)
    np.testing.assert_allclose(back.apply(found), relaxed, atol=1e-9)


def test_few_labelled_points() -> None:
    labels = np.full((21, 3), np.nan)
    labels[[4, 8]] = make_hands(1)[0, [4, 8]]
    posed = mean_pose_at_truth(RIGHT, labels)
    relaxed = RIGHT.keypoints(None, np.zeros(3), RIGHT.hands_mean, np.zeros(3))
    wanted, made = (np.linalg.norm(points[4] - points[8]) for points in (labels, relaxed))
    # Only the distance between the two can differ, half of it at either end.
    off = np.linalg.norm((posed - labels)[[4, 8]], axis=1)
    np.testing.assert_allclose(off, abs(wanted - made) / 2, atol=1e-9)
    labels[8] = np.nan
    np.testing.assert_allclose(mean_pose_at_truth(RIGHT, labels)[4], labels[4])
    assert np.isnan(mean_pose_at_truth(RIGHT, np.full((21, 3), np.nan))).all()
