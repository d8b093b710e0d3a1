"""Dexter+Object (Sridhar et al. 2016): a left hand with a box, seen from the front, 640x480."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from handfit_core.evaluate.datasets.tips import DepthToColor, TipSet
from handfit_core.geometry.camera import Intrinsics

KIND = "dexter-object"
LAYOUT = (
    "Dexter+Object's layout: data/Grasp1/color/*.png and data/Grasp1/annotations/Grasp13D.txt (original "
    "labels) or my_Grasp13D.txt (cleaned), or all of them in annotations/, likewise Grasp2, Occlusion, "
    "Rigid, Pinch, Rotate"
)
MISSING_DEPTH = 32001.0
"""What the depth camera gives where it sees nothing."""

CALIBRATION = DepthToColor(
    Intrinsics(587.45209, 600.67456, 325.0, 249.0),
    np.array(
        [[0.9999, 0.0034, 0.0161], [-0.0033, 1.0, -0.0079], [-0.0162, 0.0079, 0.9998]],
    ),
    np.array([19.0473, -1.8514, -4.7501]),
)
"""As published with the set, and as its evaluations use it."""


def _candidates(folder: Path, sequence: str, labels: str) -> tuple[Path, ...]:
    name = f"{sequence}3D.txt" if labels == "original" else f"my_{sequence}3D.txt"
    root = folder.parent if folder.name == "data" else folder
    return tuple(
        place / name for place in (folder / sequence / "annotations", root / "annotations", folder / sequence)
    )


def _clean(tips: np.ndarray) -> np.ndarray:
    """x and y are written with the opposite sign."""
    depth = tips[:, 2:]
    given = np.all(np.isfinite(tips), axis=1, keepdims=True) & (depth >= 1e-6) & (depth < MISSING_DEPTH)
    return np.where(given, tips * np.array([-1.0, -1.0, 1.0]), np.nan)


DEXTER_OBJECT = TipSet(
    kind=KIND,
    title="Dexter+Object",
    layout=LAYOUT,
    sequences=("Grasp1", "Grasp2", "Occlusion", "Rigid", "Pinch", "Rotate"),
    candidates=_candidates,
    clean=_clean,
    calibration=CALIBRATION,
    notes=("Its *2D.txt files hold pixels of the depth picture and are not used.",),
)
