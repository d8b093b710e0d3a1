"""EgoDexter (Mueller et al. 2017): left hands with objects, seen from the wearer's shoulder, 640x480."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from handfit_core.evaluate.datasets.tips import DepthToColor, TipSet
from handfit_core.geometry.camera import Intrinsics

KIND = "egodexter"
LAYOUT = (
    "EgoDexter's layout: data/Desk/color/*.png and data/Desk/annotation.txt_3D.txt (original labels) or "
    "data/Desk/my_annotation.txt_3D.txt (cleaned), likewise Fruits, Kitchen, Rotunda"
)

CALIBRATION = DepthToColor(
    Intrinsics(617.173, 617.173, 315.453, 242.259),
    np.array(
        [[1.0, 0.00090442, -0.0074], [-0.00071933, 0.9997, 0.0248], [0.0075, -0.0248, 0.9997]],
    ),
    np.array([20.2365, 1.2846, 5.7360]),
)
"""As published with the set, and as its evaluations use it."""


def _candidates(folder: Path, sequence: str, labels: str) -> tuple[Path, ...]:
    names = {
        "cleaned": ("my_annotation.txt_3D.txt",),
        # annotation.txt itself holds pixels of the depth picture in the released set.
        "original": ("annotation.txt_3D.txt", "annotation_3D.txt", "annotation.txt"),
    }[labels]
    return tuple(folder / sequence / name for name in names)


def _clean(tips: np.ndarray) -> np.ndarray:
    """Missing tips are written as zeros."""
    given = np.isfinite(tips) & (np.abs(tips) >= 1e-6)
    return np.where(np.all(given, axis=1, keepdims=True), tips, np.nan)


EGODEXTER = TipSet(
    kind=KIND,
    title="EgoDexter",
    layout=LAYOUT,
    sequences=("Desk", "Fruits", "Kitchen", "Rotunda"),
    candidates=_candidates,
    clean=_clean,
    calibration=CALIBRATION,
    notes=(),
)
