"""Scores of surfaces, baselines, and the faults of the published evaluation: there under `paper` alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from handfit_core.common.errors import DatasetError
from handfit_core.common.skeleton import SIDES, TIP_KEYPOINTS, Side
from handfit_core.evaluate import ProtocolName
from handfit_core.evaluate.labels import HandLabel, MeshLabel, Problem
from handfit_core.evaluate.methods import TrackResult
from handfit_core.evaluate.rows import Rows
from handfit_core.evaluate.scores import Scores
from handfit_core.evaluate.scoring import (
    baselines,
    mean_pose_at_truth,
    results_of_rows,
    score,
)
from handfit_core.evaluate.summary import summarise
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model import HandModel, load_model
from tests.core.evaluate.hands import CAMERA, entry, found, joints, label, rows, seen

RIGHT, LEFT = load_model(None, "right"), load_model(None, "left")
DIGESTS = frozenset({RIGHT.digest, LEFT.digest})
RNG = np.random.default_rng(5)
AT = np.array([0.0, 0.0, 0.5])


def surface(model: HandModel = RIGHT, pose: np.ndarray | None = None):
    return model.posed(None, np.zeros(3), model.hands_mean if pose is None else pose, AT)


def rows_with(mesh: MeshLabel | None, side: Side = "right") -> Rows:
    hand = label(surface().keypoints)
    hand = HandLabel(hand.side, hand.joints_3d, hand.keypoints_2d, mesh)
    return rows([entry("a", hand)], found((seen(surface().keypoints, side),)))


def with_mesh(
    mesh: MeshLabel | None,
    model: HandModel = RIGHT,
    pose: np.ndarray | None = None,
    problems: dict[Problem, None] | None = None,
) -> Scores:
    points = surface(model, pose).keypoints[None]
    parameters = np.concatenate([np.zeros(13), model.hands_mean if pose is None else pose, AT])[None]
    one = np.ones(1)
    result = TrackResult(points, np.zeros((1, 21, 3)), one, parameters, 0.005 * one)
    made = rows_with(mesh, model.side)
    return score("m", result, made, "strict", {model.side: model}, problems)


def test_a_perfect_surface_has_no_error() -> None:
    hand = with_mesh(MeshLabel(lambda: surface().vertices + 0.1, DIGESTS)).hands.loc[0]
    assert hand["pa_mpvpe"] == pytest.approx(0.0, abs=1e-6)
    assert hand["f5"] == 1.0
    assert (hand["fit_ms"], hand["expected_error"]) == (1.0, 5.0)


def test_other_surfaces() -> None:
    wrong_side = with_mesh(MeshLabel(lambda: surface().vertices, DIGESTS), LEFT).hands.loc[0]
    assert wrong_side["pa_mpvpe"] > 3.0
    assert wrong_side["f5"] < 0.95
    # Of another model there are F-scores only, as vertices of the fuller mesh lie between those of the other.
    for vertices in (surface().vertices[::2], surface().vertices):
        other = with_mesh(MeshLabel(lambda found=vertices: found, frozenset({"another"}))).hands.loc[0]
        assert np.isnan(other["pa_mpvpe"])
        assert 0.9 < other["f5"] <= 1.0


def test_a_mesh_that_cannot_be_read_is_named_once_and_the_joints_are_scored() -> None:
    def damaged() -> np.ndarray:
        raise DatasetError("evaluation_verts.json: entry 7 is null")

    problems: dict[Problem, None] = {}
    for _ in range(2):  # two methods
        made = with_mesh(MeshLabel(damaged), problems=problems)
    assert np.isnan(made.hands["f5"][0])
    assert made.errors["pa_mpjpe"][0].max() < 1e-6
    assert [(p.kind, p.where) for p in problems] == [
        ("mesh cannot be read", "a: evaluation_verts.json: entry 7 is null")
    ]


def test_how_deep_a_fitted_hand_stands_in_itself() -> None:
    crossed = np.zeros((15, 3))
    crossed[0, 1], crossed[3, 1] = np.radians([-25.0, 25.0])  # the index finger into the middle finger
    depths = [with_mesh(None, pose=p).hands["penetration"][0] for p in (np.zeros(45), crossed.ravel())]
    assert depths[0] == 0.0
    assert 4.0 < depths[1] < 20.0


def test_rows_take_their_tracks_frames_and_misses_are_nan() -> None:
    truth = joints()
    frames = [entry(f"{i}", label(truth), clip="a", time=i / 25) for i in range(3)]
    made = rows(frames, found((seen(truth),), (), (seen(truth),)))
    points = np.arange(3.0)[:, None, None] * np.ones((3, 21, 3))
    result = results_of_rows(made, [TrackResult.of_points(points, points, np.arange(3.0))])
    np.testing.assert_array_equal(result.milliseconds, [0.0, np.nan, 2.0])
    assert np.isnan(results_of_rows(made, [result]).points_3d[1]).all()


# Baselines


@pytest.mark.parametrize("side", SIDES)
def test_a_relaxed_hand_is_found_again(side: Side) -> None:
    model = load_model("open-hand", side)
    truth = model.keypoints(None, RNG.normal(size=3), model.hands_mean, np.array([0.1, 0.0, 0.6]))
    labels = truth.copy()
    labels[[1, 2, 3, 15]] = np.nan
    # Also where there was no label
    np.testing.assert_allclose(mean_pose_at_truth(model, labels), truth, atol=1e-12)
    assert np.isnan(mean_pose_at_truth(model, np.full((21, 3), np.nan))).all()


# The faults of the published evaluation

TIPS = list(TIP_KEYPOINTS)
PROTOCOLS: tuple[ProtocolName, ...] = ("paper", "strict")


def scored(
    labels: np.ndarray | Sequence[np.ndarray],
    points: np.ndarray,
    protocol: ProtocolName,
    *,
    camera: Intrinsics = CAMERA,
    picture_points: np.ndarray | None = None,
) -> Scores:
    """Stills whose labels are `labels` and in all of which a method says `points`."""
    entries = [entry(f"{i}", label(one, camera=camera), camera=camera) for i, one in enumerate(labels)]
    detections = [found((seen(points, camera=camera),))] * len(entries)
    if picture_points is None:
        picture_points = seen(points, camera=camera).keypoints[0]
    return of_all(rows(entries, *detections, protocol=protocol), points, picture_points, protocol)


def of_all(made: Rows, points: np.ndarray, picture_points: np.ndarray, protocol: ProtocolName) -> Scores:
    """A method that says the same of every hand."""
    count = len(made.listed)
    said = TrackResult.of_points(np.tile(points, (count, 1, 1)), np.tile(picture_points, (count, 1, 1)))
    return score("made", said, made, protocol)


def only(points: np.ndarray, kept: Sequence[int]) -> np.ndarray:
    labelled = np.full_like(points, np.nan)
    labelled[list(kept)] = points[list(kept)]
    return labelled


def test_one_visible_tip_scores_zero_in_the_paper_and_is_no_score_in_strict() -> None:
    truth = joints()
    wrong = truth + np.random.default_rng(0).normal(scale=0.05, size=truth.shape)
    wrong[:, 2] = np.abs(wrong[:, 2])
    paper = summarise(scored([only(truth, [8])], wrong, "paper"), "paper")
    assert paper["epe"] == pytest.approx(0.0, abs=1e-9)
    assert paper["auc"] == pytest.approx(1.0)
    strict = summarise(scored([only(truth, [8])], wrong, "strict"), "strict")
    assert np.isnan(strict["epe"])
    assert np.isnan(strict["auc"])
    assert strict["detection_rate"] == 100.0


def test_misses_vanish_in_the_paper_and_are_wrong_in_strict() -> None:
    truth = joints()
    entries = [entry(f"{i}", label(truth)) for i in range(4)]
    detections = [found((seen(truth),)), found(()), found(()), found(())]
    summaries = {}
    for protocol in PROTOCOLS:
        made = rows(entries, *detections, protocol=protocol)
        scores = of_all(made, truth, seen(truth).keypoints[0], protocol)
        summaries[protocol] = summarise(scores, protocol)
        assert summaries[protocol]["detection_rate"] == 25.0
        dropped = [p.where for p in made.problems if p.kind == "no hand detected: dropped as in the paper"]
        assert dropped == (["1", "2", "3"] if protocol == "paper" else [])
    assert summaries["paper"]["auc"] == pytest.approx(1.0)
    assert summaries["strict"]["auc"] == pytest.approx(0.25)


def test_a_pixel_of_depth_is_a_millimetre_in_the_paper_and_what_it_is_in_strict() -> None:
    truth = joints()
    sharper = Intrinsics(2400.0, 2400.0, 1280.0, 960.0)  # the same picture with four times the pixels
    errors = {
        protocol: [
            summarise(scored([truth], truth, protocol, camera=camera), protocol)["epe"]
            for camera in (CAMERA, sharper)
        ]
        for protocol in PROTOCOLS
    }
    # At 0.5 m and 600 px of focal length a pixel is 0.83 mm, at 2400 px 0.21 mm.
    assert errors["paper"][1] > 10 * errors["paper"][0] > 0.1
    np.testing.assert_allclose(errors["strict"], 0.0, atol=1e-9)


def test_true_depth_and_camera_hide_a_wrong_size_in_the_paper_only() -> None:
    truth = joints()
    twice_as_far_and_large = 2.0 * truth
    picture = seen(truth).keypoints[0]
    np.testing.assert_allclose(CAMERA.project(twice_as_far_and_large), picture[:, :2])
    alike = [
        summarise(scored([truth], points, "paper", picture_points=picture), "paper")["epe"]
        for points in (truth, twice_as_far_and_large)
    ]
    assert alike[0] == pytest.approx(alike[1])
    strict = summarise(scored([truth], twice_as_far_and_large, "strict", picture_points=picture), "strict")
    from_centroid = np.linalg.norm(truth - truth.mean(axis=0), axis=1).mean() * 1000
    assert strict["epe"] == pytest.approx(from_centroid)


def test_every_hand_is_a_left_one_in_the_paper() -> None:
    truth = joints("right")
    for protocol, side in (("paper", "left"), ("strict", "right")):
        made = rows([entry("a", label(truth, "right"))], found((seen(truth, "right"),)), protocol=protocol)
        assert [view.track.side for view in made.tracks] == [side]
        assert made.listed[0]["side_correct"] == (side == "right")


def test_joints_mix_in_the_paper_where_a_tip_has_no_label() -> None:
    truth = joints()
    moved = truth.copy()
    moved[TIPS[1]] += [0.03, 0.0, 0.0]
    without_thumb = only(truth, TIPS[1:])
    scores = scored([only(truth, TIPS), without_thumb], moved, "paper")
    errors = [row[~np.isnan(row)] for row in scores.errors["epe"]]
    # The index finger's error is filed under the thumb wherever the thumb has no label.
    by_position = [*np.mean([errors[0][:4], errors[1]], axis=0), errors[0][4]]
    assert summarise(scores, "paper")["epe"] == pytest.approx(np.mean(by_position))
    strict = scored([only(truth, TIPS), without_thumb], moved, "strict")
    assert summarise(strict, "strict")["epe"] == pytest.approx(np.nanmean(strict.errors["epe"]))


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_null_baselines_score_what_facts_say(protocol: ProtocolName) -> None:
    five, one = only(joints(), TIPS), only(joints(), TIPS[:1])
    summaries = []
    for truth in (five, one):
        made = rows([entry("a", label(truth))], found((seen(joints()),)), protocol=protocol)
        null = baselines(made, protocol, None)["null-centroid"]
        scores = score("null-centroid", null, made, protocol, is_baseline=True)
        summaries.append(summarise(scores, protocol))
        if truth is five:
            spread = 1000 * np.linalg.norm(five[TIPS] - five[TIPS].mean(axis=0), axis=1)
            np.testing.assert_allclose(scores.errors["epe"][0, TIPS], spread, rtol=1e-6)
    assert 0.2 < summaries[0]["auc"] < 0.8
    assert summaries[1]["auc"] == pytest.approx(1.0) if protocol == "paper" else np.isnan(summaries[1]["auc"])


def test_what_the_paper_drops_is_named() -> None:
    truth, nothing = joints(), label(np.full((21, 3), np.nan))
    entries = [
        entry("palm only", label(only(truth, [0, 5, 9]))),
        entry("dark", label(truth), camera=None),
        entry("second", nothing, label(truth)),  # its first hand whose tips are labelled
    ]
    made = rows(entries, *[found((seen(truth),))] * 3, protocol="paper")
    assert [(row["sample"], row["hand"]) for row in made.listed] == [("second", 1)]
    assert [(p.kind, p.where) for p in made.problems] == [
        ("no labelled fingertip: dropped as in the paper", "palm only"),
        ("camera missing: the paper's protocol needs it", "dark"),
    ]
