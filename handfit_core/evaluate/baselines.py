"""Null baselines: guesses that look at the truth instead of the picture.

Whatever a protocol gives them for nothing, it gives to every method. Points are metres, camera frame.
"""

from __future__ import annotations

import numpy as np

from handfit_core.geometry.similarity import align
from handfit_core.hand_model import HandModel


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
