"""Small `Scores` and an `Evaluation`: the bundled hand before a camera, and whatever a test plants."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from handfit_core.evaluate import ProtocolName, metrics
from handfit_core.evaluate.scores import Evaluation, Scores
from handfit_core.evaluate.summary import compare, summarise
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model import load_model

CAMERA = Intrinsics(600.0, 600.0, 320.0, 240.0)
COUNT = 6


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


def make_scores(
    n: int = 4, *, noise: float = 0.003, seed: int = 0, min_points: int = 2, **overrides: Any
) -> Scores:
    """N rows: every hand detected, predictions with `noise` metres per axis, no meshes, stills.

    overrides: any field of Scores, some of its `errors` or columns of its `hands`. Where `detected` is False,
    predictions become NaN; other errors follow from points and labels by `evaluate.metrics`.
    `min_points` is EPE's: the paper protocol has 1.
    """
    labels = np.asarray(overrides.pop("labels_3d", make_hands(n, seed)), dtype=np.float64)
    n = len(labels)
    noisy = labels + noise * np.random.default_rng(seed + 1).normal(size=labels.shape)
    points = overrides.pop("points_3d", noisy)
    detected = np.asarray(overrides.pop("detected", np.ones(n, dtype=bool)))
    points = np.where(detected[:, None, None], points, np.nan)
    pixels = np.where(detected[:, None, None], CAMERA.project(points), np.nan)
    hands: dict[str, Any] = {
        "sample": [f"{i:05}" for i in range(n)],
        "hand": np.zeros(n, dtype=int),
        "clip": [None] * n,
        "time": np.zeros(n),
        "tags": [{}] * n,
        "detected": detected,
        "side_correct": np.where(detected, 1.0, np.nan),
        **dict.fromkeys(("pa_mpvpe", "f5", "penetration", "expected_error"), np.full(n, np.nan)),
        "fit_ms": np.where(detected, 5.0, np.nan),
    }
    planted = overrides.pop("errors", {})
    columns = {name: list(overrides.pop(name)) for name in hands if name in overrides}
    fields: dict[str, Any] = {
        "method": "made",
        "is_baseline": False,
        "hands": pd.DataFrame(hands | columns),
        "labels_3d": labels,
        "points_3d": points,
    }
    errors = {
        "epe": 1000.0 * metrics.centroid_aligned_distances(points, labels, min_points=min_points),
        "mpjpe": 1000.0 * metrics.root_aligned_distances(points, labels),
        "pa_mpjpe": 1000.0 * metrics.similarity_aligned_distances(points, labels),
        "error_2d": metrics.distances_2d(pixels, CAMERA.project(labels)),
    }
    return Scores(**fields | overrides, errors=errors | planted)


def with_errors(per_hand: Sequence[float] | np.ndarray, **overrides: Any) -> Scores:
    """Scores whose PA error is (N,) mm on every point of hand n."""
    labels = np.repeat(make_hands(1), len(per_hand), axis=0)
    errors = {"pa_mpjpe": np.tile(np.array(per_hand)[:, None], 21)}
    return make_scores(errors=errors, **{"labels_3d": labels, **overrides})


def make_evaluation(*, protocol: ProtocolName = "strict", **fields: Any) -> Evaluation:
    """A baseline that is exactly right, `good` (1 mm of noise per axis), and `poor` (8 mm), on six stills, in
    one of which no hand was found. `fields` of the evaluation replace those made here."""
    detected = np.arange(COUNT) != 1
    shared = {
        "min_points": 1 if protocol == "paper" else 2,
        "sample": tuple(f"Desk/{i:05}" for i in range(COUNT)),
        "tags": tuple({"pose": "fist" if i % 2 else "open", "frame": str(i)} for i in range(COUNT)),
    }
    scores = (
        make_scores(COUNT, points_3d=make_hands(COUNT), method="null-truth", is_baseline=True, **shared),
        *(
            make_scores(COUNT, noise=noise, method=name, detected=detected, **shared)
            for name, noise in (("good", 0.001), ("poor", 0.008))
        ),
    )
    made: dict[str, Any] = {
        "dataset": "A set",
        "kind": "folder",
        "root": Path("set"),
        "protocol": protocol,
        "scores": scores,
        "summaries": pd.DataFrame({s.method: summarise(s, protocol) for s in scores}).T,
        "comparisons": (compare(scores[2], scores[1], "epe"),),
        "pictures": COUNT,
        "labelled_hands": COUNT,
        "extra_hands": 1,
        "problems": {"picture cannot be read": ("Desk/00007",)},
        "notes": ("A note.",),
        "setup": {"machine": "a test's"},
    }
    return Evaluation(**made | fields)
