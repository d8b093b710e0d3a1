"""A shot's pictures as entries of the plain folder form's `index.json`."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

from handfit_core.hand_model import OPEN_HAND

from .kinematics import model_of
from .shots import FPS, Shot

NAME: Final = "rendered benchmark"
NOTES: Final = (
    "Rendered with Blender Cycles from the bundled open hand: its joints and fingertips are the labels, "
    "exact, and other models have theirs elsewhere in the hand.",
    "Keypoints that are hidden, or lie outside of a picture (its tag framing is cut), are labelled all the "
    "same.",
)


def entries(shot: Shot) -> list[dict[str, Any]]:
    """One entry per picture, in order: file, hands, K, clip, time, tags."""
    points = [hand.keypoints() for hand in shot.hands]
    pixels = [shot.camera.project(p) for p in points]
    k = shot.camera
    found = []
    for number, (file, tags) in enumerate(zip(shot.files, shot.tags, strict=True)):
        t = number + shot.lead
        entry: dict[str, Any] = {
            "file": file,
            "hands": [
                {
                    "hand": hand.side,
                    "joints_3d_mm": _rounded(p[t] * 1000.0, 5),
                    "keypoints_2d_px": _rounded(uv[t], 4),
                    "mano": {
                        "model": OPEN_HAND,
                        "digest": model_of(hand.side).digest,
                        "betas": _rounded(hand.betas, 9),
                        "global_orient": _rounded(hand.global_orient[t], 9),
                        "hand_pose": _rounded(hand.hand_pose[t], 9),
                        "transl": _rounded(hand.transl[t], 9),
                    },
                }
                for hand, p, uv in zip(shot.hands, points, pixels, strict=True)
            ],
            "K": [[k.fx, 0.0, k.cx], [0.0, k.fy, k.cy], [0.0, 0.0, 1.0]],
            "time": number / FPS,
            "tags": dict(tags),
        }
        if shot.clip is not None:
            entry["clip"] = shot.clip
        found.append(entry)
    return found


def save(root: Path, pictures: list[dict[str, Any]]) -> Path:
    """Write `index.json`, whole or not at all. Raises OutputError."""
    from handfit_core.evaluate.datasets.plain import save_index

    return save_index(root, pictures, name=NAME, notes=NOTES, fps=FPS)


def _rounded(values: np.ndarray, decimals: int) -> list:
    """Digits enough for the labels to be exact to a nanometre, and files that people can read."""
    return np.round(values, decimals).tolist()
