"""The faults of the published evaluation: each is there under `paper`, and gone under `strict`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from handfit_core.evaluate import ProtocolName
from handfit_core.evaluate.detections import UnitDetections
from handfit_core.evaluate.labels import Entry, units_of
from handfit_core.evaluate.methods import TrackResult
from handfit_core.evaluate.rows import Rows, rows_of
from handfit_core.evaluate.scores import Scores
from handfit_core.evaluate.scoring import baselines, score
from handfit_core.evaluate.summary import summarise
from handfit_core.geometry.camera import Intrinsics
from handfit_core.skeleton import TIP_KEYPOINTS
from tests.core.evaluate.hands import CAMERA, entry, found, joints, label, seen

TIPS = list(TIP_KEYPOINTS)
PROTOCOLS: tuple[ProtocolName, ...] = ("paper", "strict")


def rows(entries: Sequence[Entry], detections: Sequence[UnitDetections], protocol: ProtocolName) -> Rows:
    made = iter(detections)
    return rows_of(units_of(entries), lambda _: next(made), protocol=protocol, camera="assumed")


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
        picture_points = seen(points, camera=camera).keypoints
    return of_all(rows(entries, detections, protocol), points, picture_points, protocol)


def of_all(made: Rows, points: np.ndarray, picture_points: np.ndarray, protocol: ProtocolName) -> Scores:
    """A method that says the same of every hand."""
    count = len(made.listed)
    said = TrackResult.of_points(np.tile(points, (count, 1, 1)), np.tile(picture_points, (count, 1, 1)))
    return score("made", "made", said, made, protocol)


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
        made = rows(entries, detections, protocol)
        scores = of_all(made, truth, seen(truth).keypoints, protocol)
        summaries[protocol] = summarise(scores, protocol)
        assert summaries[protocol]["detection_rate"] == 25.0
        dropped = [p.where for p in made.problems if p.kind == "no hand detected: dropped as in the paper"]
        assert dropped == (["1", "2", "3"] if protocol == "paper" else [])
    assert summaries["paper"]["auc"] == pytest.approx(1.0)
    assert summaries["strict"]["auc"] == pytest.approx(0.25)


def test_a_picture_without_a_labelled_tip_is_named_when_the_paper_drops_it() -> None:
    truth = only(joints(), [0, 5, 9])
    made = rows([entry("palm only", label(truth))], [found((seen(joints()),))], "paper")
    assert not made.listed
    assert [(p.kind, p.where) for p in made.problems] == [
        ("no labelled fingertip: dropped as in the paper", "palm only")
    ]
    assert len(rows([entry("palm only", label(truth))], [found((seen(joints()),))], "strict").listed) == 1


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
    picture = seen(truth).keypoints
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
        made = rows([entry("a", label(truth, "right"))], [found((seen(truth, "right"),))], protocol)
        assert [view.track.side for view in made.tracks] == [side]
        assert made.listed[0]["side_correct"] == (side == "right")


def test_joints_mix_in_the_paper_where_a_tip_has_no_label() -> None:
    truth = joints()
    moved = truth.copy()
    moved[TIPS[1]] += [0.03, 0.0, 0.0]
    without_thumb = only(truth, TIPS[1:])
    scores = scored([only(truth, TIPS), without_thumb], moved, "paper")
    errors = [row[~np.isnan(row)] for row in scores.epe]
    # The index finger's error is filed under the thumb wherever the thumb has no label.
    by_position = [*np.mean([errors[0][:4], errors[1]], axis=0), errors[0][4]]
    assert summarise(scores, "paper")["epe"] == pytest.approx(np.mean(by_position))
    strict = scored([only(truth, TIPS), without_thumb], moved, "strict")
    assert summarise(strict, "strict")["epe"] == pytest.approx(np.nanmean(strict.epe))


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_null_baselines_score_what_facts_say(protocol: ProtocolName) -> None:
    five, one = only(joints(), TIPS), only(joints(), TIPS[:1])
    summaries = []
    for truth in (five, one):
        made = rows([entry("a", label(truth))], [found((seen(joints()),))], protocol)
        scores = score(*baselines(made, protocol, None)[0], made, protocol, is_baseline=True)
        summaries.append(summarise(scores, protocol))
        if truth is five:
            spread = 1000 * np.linalg.norm(five[TIPS] - five[TIPS].mean(axis=0), axis=1)
            np.testing.assert_allclose(scores.epe[0, TIPS], spread, rtol=1e-6)
    assert 0.2 < summaries[0]["auc"] < 0.8
    assert summaries[1]["auc"] == pytest.approx(1.0) if protocol == "paper" else np.isnan(summaries[1]["auc"])


def test_the_paper_takes_the_first_hand_whose_tips_are_labelled() -> None:
    nothing, truth = label(np.full((21, 3), np.nan)), label(joints())
    made = rows([entry("second", nothing, truth)], [found((seen(joints()),))], "paper")
    assert [row["hand"] for row in made.listed] == [1]


def test_the_papers_protocol_needs_the_camera_and_says_whose_is_missing() -> None:
    truth = joints()
    made = rows([entry("dark", label(truth), camera=None)], [found((seen(truth),))], "paper")
    assert not made.listed
    assert [(p.kind, p.where) for p in made.problems] == [
        ("camera missing: the paper's protocol needs it", "dark")
    ]
