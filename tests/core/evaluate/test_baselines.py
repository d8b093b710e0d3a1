import numpy as np
import pytest

from handfit_core.evaluate.scoring import collapsed_to_centroid, mean_pose_at_truth
from handfit_core.geometry.similarity import align
from handfit_core.hand_model import load_model
from handfit_core.skeleton import SIDES, Side
from tests.core.evaluate.factory import make_hands

RNG = np.random.default_rng(5)


def test_all_points_at_the_centroid_of_the_labelled_ones() -> None:
    labels = make_hands(1)[0]
    labels[[0, 5, 13]] = np.nan
    found = collapsed_to_centroid(labels)
    assert found.shape == (21, 3)
    rows = [i for i in range(21) if i not in (0, 5, 13)]
    np.testing.assert_allclose(found, np.tile(sum(labels[i] for i in rows) / 18, (21, 1)))
    assert np.isnan(collapsed_to_centroid(np.full((21, 3), np.nan))).all()


@pytest.mark.parametrize("side", SIDES)
def test_a_relaxed_hand_is_found_again(side: Side) -> None:
    model = load_model("open-hand", side)
    truth = model.keypoints(None, RNG.normal(size=3), model.hands_mean, np.array([0.1, 0.0, 0.6]))
    labels = truth.copy()
    labels[[1, 2, 3, 15]] = np.nan
    found = mean_pose_at_truth(model, labels)
    assert found is not None
    np.testing.assert_allclose(found, truth, atol=1e-12)  # also where there was no label


def test_size_and_pose_stay_those_of_the_model() -> None:
    model = load_model("open-hand", "right")
    relaxed = model.keypoints(None, np.zeros(3), model.hands_mean, np.zeros(3))
    fist = model.keypoints(None, RNG.normal(size=3), np.full(45, 0.4), np.array([0.0, 0.1, 0.5]))
    found = mean_pose_at_truth(model, 1.3 * fist)
    assert found is not None
    back = align(found, relaxed, with_scale=False)
    np.testing.assert_allclose(back.apply(found), relaxed, atol=1e-12)


def test_a_few_points_are_met_as_well_as_they_can_be() -> None:
    model = load_model("open-hand", "right")
    labels = np.full((21, 3), np.nan)
    labels[[4, 8]] = make_hands(1)[0, [4, 8]]
    posed = mean_pose_at_truth(model, labels)
    assert posed is not None
    relaxed = model.keypoints(None, np.zeros(3), model.hands_mean, np.zeros(3))
    wanted, made = (np.linalg.norm(points[4] - points[8]) for points in (labels, relaxed))
    # Only the distance between the two can differ, half of it at either end.
    np.testing.assert_allclose(
        np.linalg.norm((posed - labels)[[4, 8]], axis=1), abs(wanted - made) / 2, atol=1e-9
    )
    labels[8] = np.nan
    one = mean_pose_at_truth(model, labels)
    assert one is not None
    np.testing.assert_allclose(one[4], labels[4])
    assert mean_pose_at_truth(model, np.full((21, 3), np.nan)) is None
    labels[12] = make_hands(1)[0, 12]
    found = mean_pose_at_truth(model, labels)
    assert found is not None
    assert np.isfinite(found).all()
