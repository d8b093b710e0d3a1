"""Small `Scores` for tests: the bundled hand in front of a camera, and whatever the test plants in it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from handfit_core.evaluate import metrics
from handfit_core.evaluate.scores import Scores
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model import load_model

FOCAL = 600.0
CENTRE = (320.0, 240.0)


@cache
def _relaxed_hand() -> np.ndarray:
    model = load_model("open-hand", "right")
    hand = model.keypoints(None, np.zeros(3), model.hands_mean, np.zeros(3))
    return hand - hand.mean(axis=0)


def make_hands(n: int, seed: int = 0) -> np.ndarray:
    """(n, 21, 3) metres: a relaxed right hand turned at random, about half a metre before the camera."""
    rng = np.random.default_rng(seed)
    turns = rotvec_to_rotmat(rng.normal(size=(n, 3)))
    return np.einsum("pj,nij->npi", _relaxed_hand(), turns) + [0, 0, 0.5] + 0.05 * rng.normal(size=(n, 1, 3))


def project(points: np.ndarray) -> np.ndarray:
    """(..., 2) pixels of (..., 3) points."""
    return FOCAL * points[..., :2] / points[..., 2:] + CENTRE


def make_scores(
    n: int = 4, *, noise: float = 0.003, seed: int = 0, min_points: int = 2, **overrides: Any
) -> Scores:
    """N rows: every hand detected, predictions with `noise` metres per axis, no meshes, stills.

    overrides: any field of Scores or column of its `hands`. Where `detected` is False, predictions become
    NaN; errors follow from points and labels by `evaluate.metrics` unless they are overridden too.
    `min_points` is EPE's: the paper protocol has 1.
    """
    rng = np.random.default_rng(seed + 1)
    labels = np.asarray(overrides.pop("labels_3d", make_hands(n, seed)), dtype=np.float64)
    n = len(labels)
    points = overrides.pop("points_3d", None)
    if points is None:
        points = labels + noise * rng.normal(size=labels.shape)
    detected = np.asarray(overrides.pop("detected", np.ones(n, dtype=bool)))
    points = np.where(detected[:, None, None], points, np.nan)
    labels_2d = overrides.pop("labels_2d", project(labels))
    points_2d = np.where(detected[:, None, None], overrides.pop("points_2d", project(points)), np.nan)
    hands: dict[str, Any] = {
        "sample": [f"{i:05}" for i in range(n)],
        "hand": np.zeros(n, dtype=int),
        "clip": [None] * n,
        "time": np.zeros(n),
        "view": ["palm"] * n,
        "picture": [Path(f"{i:05}.png") for i in range(n)],
        "tags": [{}] * n,
        "detected": detected,
        "side_correct": np.where(detected, 1.0, np.nan),
        **dict.fromkeys(("pa_mpvpe", "f5", "f15", "penetration", "expected_error"), np.full(n, np.nan)),
        "detect_ms": np.full(n, 20.0),
        "fit_ms": np.where(detected, 5.0, np.nan),
    }
    columns = {name: list(overrides.pop(name)) for name in hands if name in overrides}
    fields: dict[str, Any] = {
        "method": "made",
        "title": "Made by a test",
        "is_baseline": False,
        "hands": pd.DataFrame(hands | columns),
        "labels_3d": labels,
        "labels_2d": labels_2d,
        "points_3d": points,
        "points_2d": points_2d,
        "camera_error": 1000.0 * metrics.camera_distances(points, labels),
        "epe": 1000.0 * metrics.centroid_aligned_distances(points, labels, min_points=min_points),
        "root_error": 1000.0 * metrics.root_aligned_distances(points, labels),
        "pa_error": 1000.0 * metrics.similarity_aligned_distances(points, labels),
        "error_2d": metrics.distances_2d(points_2d, labels_2d),
    }
    return Scores(**{**fields, **overrides})


def with_hands(scores: Scores, **columns: Any) -> Scores:
    """Scores whose table `hands` has other columns."""
    return replace(scores, hands=scores.hands.assign(**columns))
