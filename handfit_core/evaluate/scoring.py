"""Comparing a method's results with the labels of all rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from handfit_core.common.batch import SLICE
from handfit_core.common.skeleton import NUM_KEYPOINTS, TIP_KEYPOINTS, Side
from handfit_core.evaluate import ProtocolName
from handfit_core.evaluate.labels import Problem, said
from handfit_core.evaluate.methods import TrackResult
from handfit_core.evaluate.metrics import (
    aligned_vertices,
    camera_distances,
    centroid_aligned_distances,
    distances_2d,
    f_score,
    root_aligned_distances,
    similarity_aligned_distances,
)
from handfit_core.evaluate.rows import PAPER_SIDE, Rows
from handfit_core.evaluate.scores import Scores
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.similarity import align
from handfit_core.hand_model import HandModel, load_model
from handfit_core.hand_model.surface import surface_of

MM = 1000.0

Models = Mapping[Side, HandModel]


def results_of_rows(rows: Rows, results: Sequence[TrackResult]) -> TrackResult:
    """Return the result of each of N rows, NaN for a miss. `results` are one method's, of `rows.tracks`."""
    nothing = np.full((1, NUM_KEYPOINTS, 3), np.nan)
    width = results[0].parameters.shape[1] if results else 0
    miss = replace(TrackResult.of_points(nothing, nothing), parameters=np.full((1, width), np.nan))
    starts = np.cumsum([0, *map(len, results)])
    track, frame = rows.hands["track"].to_numpy(), rows.hands["frame"].to_numpy()
    return TrackResult.concatenate([*results, miss]).select(np.where(track < 0, -1, starts[track] + frame))


def score(
    method: str,
    found: TrackResult,
    rows: Rows,
    protocol: ProtocolName,
    models: Models | None = None,
    problems: dict[Problem, None] | None = None,
    *,
    is_baseline: bool = False,
) -> Scores:
    """Score N rows. `found` has each row's result, and `models` the hand models behind them, for surfaces.

    `problems` gets each mesh that cannot be read once, in order.
    """
    hands, truth = rows.hands, MM * rows.labels_3d
    detected = np.asarray(hands["track"].to_numpy() >= 0)
    if is_baseline:
        detected = np.asarray(np.isfinite(found.points_3d).any(axis=(1, 2)))
        hands = hands.assign(side_correct=np.nan)
    points = np.where(detected[:, None, None], found.points_3d, np.nan)
    nothing = np.full((len(hands), NUM_KEYPOINTS), np.nan)
    errors = {name: nothing.copy() for name in ("epe", "mpjpe", "pa_mpjpe", "error_2d")}
    surfaces = pd.DataFrame(np.nan, hands.index, ["pa_mpvpe", "f5"])
    if protocol == "paper":
        for i in np.flatnonzero(detected):
            camera = hands["camera"][i]
            assert camera is not None, "rows of the paper's protocol have a camera"
            errors["epe"][i] = published_error(found.picture_points[i], rows.labels_3d[i], camera)
    else:
        labels_2d = np.stack(hands["label_2d"].to_list())
        points_2d = np.where(detected[:, None, None], found.picture_points[..., :2], np.nan)
        errors = {
            "epe": centroid_aligned_distances(MM * points, truth),
            "mpjpe": root_aligned_distances(MM * points, truth),
            "pa_mpjpe": similarity_aligned_distances(MM * points, truth),
            "error_2d": distances_2d(points_2d, labels_2d),
        }
        surfaces = _surfaces(rows, found, models or {}, {} if problems is None else problems)
    return Scores(
        method=method,
        is_baseline=is_baseline,
        hands=hands.assign(
            detected=detected,
            penetration=MM * _penetration(rows, found, models or {}),
            expected_error=MM * found.expected_error,
            fit_ms=found.milliseconds,
        ).join(surfaces),
        labels_3d=rows.labels_3d,
        points_3d=points,
        errors=errors,
    )


def published_error(picture_points: np.ndarray, joints_3d: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """Return (21,) mm by the published evaluation, faults included; NaN but for labelled fingertips.

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


def _fitted(rows: Rows, found: TrackResult, models: Models) -> list[tuple[HandModel, np.ndarray]]:
    """Return the hand models, each with the numbers (indices) of the rows that have parameters of it."""
    if not found.parameters.size:
        return []
    known = np.isfinite(found.parameters).all(axis=1)
    sides = rows.hands["side"].to_numpy()
    return [(model, np.flatnonzero(known & (sides == side))) for side, model in models.items()]


def _penetration(rows: Rows, found: TrackResult, models: Models) -> np.ndarray:
    """Return (N,) metres that the deepest two parts of each hand stand in each other; NaN without a hand
    model."""
    depths = np.full(len(rows.hands), np.nan)
    for model, fitted in _fitted(rows, found, models):
        surface = surface_of(model)
        for part in np.split(fitted, range(SLICE, len(fitted), SLICE)):
            posed = found.parameters[part]
            depths[part] = surface.depths(surface.of(posed[:, :10], posed[:, 13:58]))
    return depths


def _surfaces(rows: Rows, found: TrackResult, models: Models, problems: dict[Problem, None]) -> pd.DataFrame:
    """Return a table of N rows with PA-MPVPE and F-score where both the method and the labels have a
    surface."""
    scores = pd.DataFrame(np.nan, rows.hands.index, ["pa_mpvpe", "f5"])
    for model, fitted in _fitted(rows, found, models):
        for i in fitted:
            label = rows.hands["label"][i]
            mesh = label.mesh
            if mesh is None:
                continue
            try:
                truth = MM * mesh.vertices()
            except Exception as error:  # a damaged file can fail in any way
                where = f"{rows.hands['sample'][i]}: {said(error)}"
                problems[Problem("mesh cannot be read", where)] = None
                continue
            row = found.parameters[i]
            vertices = MM * model.posed(row[:10], row[10:13], row[13:58], row[58:]).vertices
            same = len(truth) == len(vertices) and (not mesh.digests or model.digest in mesh.digests)
            # Of another topology, only the labelled joints tell how the surfaces lie on each other.
            joints = MM * found.points_3d[i], MM * label.joints_3d
            aligned = aligned_vertices(vertices, *((vertices, truth) if same else joints))
            scores.loc[i, "f5"] = f_score(aligned, truth, 5.0)
            if same:
                scores.loc[i, "pa_mpvpe"] = camera_distances(aligned, truth).mean()
    return scores


def baselines(rows: Rows, protocol: ProtocolName, model: str | None) -> dict[str, TrackResult]:
    """Return the results of the null baselines, which look at the truth instead of the picture, by name.

    Whatever a protocol gives them for nothing, it gives to every method.
    Under the paper's protocol they see only what was detected, as the methods do.
    """
    hands, labels = rows.hands, rows.labels_3d.copy()
    sides: list[Side] = [label.side or PAPER_SIDE for label in hands["label"]]
    if protocol == "paper":
        labels[hands["track"] < 0] = np.nan
        labels[:, [k for k in range(NUM_KEYPOINTS) if k not in TIP_KEYPOINTS]] = np.nan
        sides = [PAPER_SIDE] * len(sides)
    models = {side: load_model(model, side) for side in set(sides)}
    centroid = [collapsed_to_centroid(points) for points in labels]
    mean_pose = [mean_pose_at_truth(models[side], points) for side, points in zip(sides, labels, strict=True)]

    def result(points: list[np.ndarray]) -> TrackResult:
        pixels = [in_picture(*seen) for seen in zip(points, hands["camera"], strict=True)]
        return TrackResult.of_points(np.array(points), np.array(pixels))

    return {"null-centroid": result(centroid), "null-mean-pose": result(mean_pose)}


def collapsed_to_centroid(labels_3d: np.ndarray) -> np.ndarray:
    """Return (21, 3) points that all stand at the centroid of the labelled ones of (21, 3) labels.

    All NaN where nothing is labelled.
    """
    labelled = labels_3d[~np.isnan(labels_3d).any(axis=-1)]
    centroid = labelled.mean(axis=0) if len(labelled) else np.full(3, np.nan)
    return np.tile(centroid, (len(labels_3d), 1))


def mean_pose_at_truth(model: HandModel, labels_3d: np.ndarray) -> np.ndarray:
    """Return (21, 3) keypoints of the relaxed hand of mean shape, moved rigidly onto the labelled points,
    metres.

    The relaxed hand is `model.hands_mean` with betas 0; rotation and translation are the best in the
    least-squares sense (Umeyama 1991), without scale and without mirroring, so take the model of the
    labelled side. With one or two labelled points some rotation that meets them best. NaN without any.
    """
    labelled = ~np.isnan(labels_3d).any(axis=-1)
    if not labelled.any():
        return np.full_like(labels_3d, np.nan)
    relaxed = model.keypoints(None, np.zeros(3), model.hands_mean, np.zeros(3))
    return align(relaxed[labelled], labels_3d[labelled], with_scale=False).apply(relaxed)


def in_picture(points: np.ndarray, intrinsics: Intrinsics | None) -> np.ndarray:
    """Project points (21, 3) in metres to pixels, with depths about their mean in millimetres, which the
    paper's protocol takes pixels for; NaN without a camera."""
    if intrinsics is None:
        return np.full((NUM_KEYPOINTS, 3), np.nan)
    depth = MM * (points[:, 2:] - points[:, 2:].mean())
    return np.concatenate([intrinsics.project(points), depth], axis=-1)
