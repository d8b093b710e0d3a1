"""A method's results against the labels, row by row."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from handfit_core.errors import DatasetError
from handfit_core.evaluate.labels import Problem
from handfit_core.evaluate.metrics import (
    aligned_vertices,
    camera_distances,
    centroid_aligned_distances,
    distances_2d,
    f_score,
    pa_mpvpe,
    root_aligned_distances,
    similarity_aligned_distances,
)
from handfit_core.evaluate.rows import PAPER_SIDE, Row
from handfit_core.evaluate.scores import ProtocolName, Scores
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.similarity import align
from handfit_core.hand_model import HandModel, load_model
from handfit_core.skeleton import NUM_KEYPOINTS, TIP_KEYPOINTS, Side

MM = 1000.0


@dataclass(frozen=True, eq=False)
class RowResult:
    """What one method says of one row."""

    points_3d: np.ndarray
    """(21, 3) metres, camera frame"""
    picture_points: np.ndarray
    """(21, 3) pixels with a relative depth in pixels"""
    fit_ms: float = float("nan")
    model: HandModel | None = None
    vertices: np.ndarray | None = None
    """(V, 3) metres in the camera frame"""
    penetration: float = float("nan")
    """metres that the deepest two parts of the hand stand in each other"""
    expected_error: float = float("nan")
    """metres that the hand is likely to be off, as the solver says"""


def score(
    method: str,
    title: str,
    result_of: Callable[[Row], RowResult | None],
    rows: Sequence[Row],
    protocol: ProtocolName,
    problems: dict[Problem, None] | None = None,
    *,
    is_baseline: bool = False,
) -> Scores:
    """Score every row; `result_of` gives None for a miss. `problems` gets each mesh that cannot be read
    once, in order."""
    problems = {} if problems is None else problems
    count = len(rows)
    per_point = {
        name: np.full((count, NUM_KEYPOINTS), np.nan)
        for name in ("camera_error", "epe", "root_error", "pa_error", "error_2d")
    }
    per_hand = {
        name: np.full(count, np.nan)
        for name in ("pa_mpvpe", "f5", "f15", "penetration", "expected_error", "fit_ms")
    }
    points_3d = np.full((count, NUM_KEYPOINTS, 3), np.nan)
    points_2d = np.full((count, NUM_KEYPOINTS, 2), np.nan)
    detected = np.zeros(count, dtype=bool)
    for i, row in enumerate(rows):
        result = result_of(row)
        if result is None:
            continue
        detected[i] = True
        points_3d[i], points_2d[i] = result.points_3d, result.picture_points[:, :2]
        per_hand["fit_ms"][i] = result.fit_ms
        per_hand["penetration"][i] = MM * result.penetration
        per_hand["expected_error"][i] = MM * result.expected_error
        errors = _published(row, result) if protocol == "paper" else _strict(row, result)
        for name, values in errors.items():
            per_point[name][i] = values
        if protocol == "strict":
            for name, value in _surface(row, result, problems).items():
                per_hand[name][i] = value
    return Scores(
        method=method,
        title=title,
        is_baseline=is_baseline,
        samples=tuple(row.entry.name for row in rows),
        hands=np.array([row.hand_index for row in rows], dtype=np.int64),
        pictures=tuple(row.entry.picture for row in rows),
        clips=tuple(row.entry.clip for row in rows),
        times=np.array([row.entry.time for row in rows]),
        views=tuple(row.view for row in rows),
        tags=tuple(row.entry.tags for row in rows),
        detected=detected,
        side_correct=np.array([np.nan if is_baseline else row.side_correct for row in rows]),
        labels_3d=np.array([row.label.joints_3d for row in rows]).reshape(-1, NUM_KEYPOINTS, 3),
        labels_2d=np.array([row.label_2d for row in rows]).reshape(-1, NUM_KEYPOINTS, 2),
        points_3d=points_3d,
        points_2d=points_2d,
        detect_ms=np.array([np.nan if is_baseline else row.detect_ms for row in rows]),
        **per_point,
        **per_hand,
    )


def _strict(row: Row, result: RowResult) -> dict[str, np.ndarray]:
    points, truth = MM * result.points_3d, MM * row.label.joints_3d
    return {
        "camera_error": camera_distances(points, truth),
        "epe": centroid_aligned_distances(points, truth),
        "root_error": root_aligned_distances(points, truth),
        "pa_error": similarity_aligned_distances(points, truth),
        "error_2d": distances_2d(result.picture_points[:, :2], row.label_2d),
    }


def _published(row: Row, result: RowResult) -> dict[str, np.ndarray]:
    assert row.intrinsics is not None, "rows of the paper's protocol have a camera"
    return {"epe": published_error(result.picture_points, row.label.joints_3d, row.intrinsics)}


def published_error(picture_points: np.ndarray, joints_3d: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """(21,) mm by the published evaluation, faults included; NaN but for labelled fingertips.

    What that does (arXiv 2506.11133 and its code; docs/evaluation.md lists the consequences):

    * only fingertips are scored, on every picture with a detection and at least one labelled tip;
    * a predicted tip is a pixel with a depth in pixels, and one pixel of depth counts as one millimetre;
    * the mean depth is moved to the truth's, pixels are unprojected with the data set's own camera, and the
      points' centroid is moved to the truth's: no rotation, no scale;
    * so a picture with one labelled tip has an error of exactly zero.

    picture_points (21, 3): pixels with a relative depth in pixels; joints_3d (21, 3): labels in metres,
    camera frame.
    """
    errors = np.full(NUM_KEYPOINTS, np.nan)
    tips = [tip for tip in TIP_KEYPOINTS if np.isfinite(joints_3d[tip]).all()]
    if not tips:
        return errors
    truth = MM * joints_3d[tips]
    predicted = picture_points[tips]
    depth = predicted[:, 2] - predicted[:, 2].mean() + truth[:, 2].mean()
    unprojected = intrinsics.rays(predicted[:, :2]) * depth[:, None]
    errors[tips] = centroid_aligned_distances(unprojected, truth, min_points=1)
    return errors


def _surface(row: Row, result: RowResult, problems: dict[Problem, None]) -> dict[str, float]:
    """PA-MPVPE and F-scores, where both sides have a surface."""
    mesh = row.label.mesh
    if mesh is None or result.vertices is None or result.model is None:
        return {}
    try:
        truth = MM * mesh.vertices()
    except DatasetError as error:
        problems[Problem("mesh cannot be read", f"{row.entry.name}: {error}")] = None
        return {}
    vertices = MM * result.vertices
    same_mesh = len(truth) == len(vertices) and (not mesh.digests or result.model.digest in mesh.digests)
    points, joints = MM * result.points_3d, MM * row.label.joints_3d
    if same_mesh:
        aligned = aligned_vertices(vertices, truth, points, joints)
    else:
        # Another topology: only the labelled joints tell how the surfaces lie on each other.
        aligned = aligned_vertices(vertices, truth[:0], points, joints)
    scores = {"f5": f_score(aligned, truth, 5.0), "f15": f_score(aligned, truth, 15.0)}
    return {**scores, "pa_mpvpe": pa_mpvpe(vertices, truth)} if same_mesh else scores


def baselines(
    rows: Sequence[Row], protocol: ProtocolName, model: str | None
) -> list[tuple[str, str, Callable[[Row], RowResult | None]]]:
    """The null baselines, which look at the truth instead of the picture: (method, title, result of a row).

    Whatever a protocol gives them for nothing, it gives to every method.
    Under the paper's protocol they see only what was detected, as the methods do.
    """
    sides: set[Side] = {_side(row, protocol) for row in rows}
    models = {side: load_model(model, side) for side in sides}

    def of_truth(make: Callable[[Row, np.ndarray], np.ndarray | None]) -> Callable[[Row], RowResult | None]:
        def result_of(row: Row) -> RowResult | None:
            points = make(row, _tips_only(row, protocol)) if protocol == "strict" or row.track else None
            return None if points is None else RowResult(points, in_picture(points, row.intrinsics))

        return result_of

    centroid = of_truth(lambda _, labels: collapsed_to_centroid(labels))
    mean_pose = of_truth(lambda row, labels: mean_pose_at_truth(models[_side(row, protocol)], labels))
    return [
        ("null-centroid", "null: all points at their centroid", centroid),
        ("null-mean-pose", "null: relaxed hand at the true orientation", mean_pose),
    ]


def collapsed_to_centroid(labels_3d: np.ndarray) -> np.ndarray:
    """(21, 3) points that all stand at the centroid of the labelled ones of (21, 3) labels.

    All NaN where nothing is labelled.
    """
    labelled = labels_3d[~np.isnan(labels_3d).any(axis=-1)]
    centroid = labelled.mean(axis=0) if len(labelled) else np.full(3, np.nan)
    return np.tile(centroid, (len(labels_3d), 1))


def mean_pose_at_truth(model: HandModel, labels_3d: np.ndarray) -> np.ndarray | None:
    """(21, 3) keypoints of the relaxed hand of mean shape, moved rigidly onto the labelled points.

    The relaxed hand is `model.hands_mean` with betas 0; rotation and translation are the best in the
    least-squares sense (Umeyama 1991), without scale and without mirroring, so take the model of the
    labelled side. With one or two labelled points some rotation that meets them best. None without any.
    """
    labelled = ~np.isnan(labels_3d).any(axis=-1)
    if not labelled.any():
        return None
    relaxed = model.keypoints(None, np.zeros(3), model.hands_mean, np.zeros(3))
    return align(relaxed[labelled], labels_3d[labelled], with_scale=False).apply(relaxed)


def _side(row: Row, protocol: ProtocolName) -> Side:
    if protocol == "paper":
        return PAPER_SIDE
    return row.label.side or PAPER_SIDE


def _tips_only(row: Row, protocol: ProtocolName) -> np.ndarray:
    if protocol == "strict":
        return row.label.joints_3d
    tips = np.full_like(row.label.joints_3d, np.nan)
    tips[list(TIP_KEYPOINTS)] = row.label.joints_3d[list(TIP_KEYPOINTS)]
    return tips


def in_picture(points: np.ndarray, intrinsics: Intrinsics | None) -> np.ndarray:
    """(21, 3) metres -> pixels, with depths about their mean in millimetres, which the paper's protocol
    takes pixels for; NaN without a camera."""
    if intrinsics is None:
        return np.full((NUM_KEYPOINTS, 3), np.nan)
    depth = MM * (points[:, 2:] - points[:, 2:].mean())
    return np.concatenate([intrinsics.project(points), depth], axis=-1)
