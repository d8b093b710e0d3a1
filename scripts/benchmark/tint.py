"""Colours of skin and things; where skin is lighter, redder or darker: palms, nails, knuckles, creases."""

from __future__ import annotations

from typing import Final

import numpy as np

from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS
from handfit_core.hand_model.anatomy import anatomical_axes

from .kinematics import model_of
from .meshes import vertex_normals
from .shots import ShotHand

LUMINANCE: Final = np.array([0.2126, 0.7152, 0.0722])
"""Of linear sRGB"""
TONES: Final = np.array(
    [
        *((0.045, 0.022, 0.013), (0.11, 0.05, 0.028), (0.24, 0.115, 0.062)),
        *((0.42, 0.22, 0.13), (0.60, 0.36, 0.24), (0.74, 0.49, 0.37)),
    ]
)
"""Skin from dark to light, linear RGB"""
_NAIL_FROM: Final = 0.52
"""Begin of a nail, between the last joint (0) and the fingertip (1)"""


def skin_tone(rng: np.random.Generator) -> np.ndarray:
    """(3,) linear RGB, as often dark as light."""
    place = rng.uniform(0, len(TONES) - 1)
    below = int(place)
    tone = TONES[below] + (place - below) * (TONES[below + 1] - TONES[below])
    return np.clip(tone * rng.normal(1.0, [0.04, 0.06, 0.08]), 0.01, 0.9)


def random_colour(rng: np.random.Generator) -> np.ndarray:
    """(3,) linear RGB of things: greys as often as colours."""
    value = rng.uniform(0.02, 0.75)
    return np.clip(value * (1 + rng.uniform(0.0, 0.9) * rng.uniform(-1, 1, 3)), 0.01, 0.85)


def hand_tint(hand: ShotHand, tone: np.ndarray) -> np.ndarray:
    """(V, 3) what to multiply skin of that tone (3, linear RGB) with."""
    model = model_of(hand.side)
    shaped = model.shaped(hand.betas)
    normals = vertex_normals(shaped.vertices, model.faces)
    wrist = shaped.joints[0]
    # The arm's skin is plain: the palm's fades before the wrist.
    to_fingers = (wrist - shaped.vertices)[:, 0] * np.sign(wrist[0])
    palm = np.clip(0.2 - 1.5 * normals[:, 1], 0.0, 1.0) * np.clip(to_fingers / 0.03, 0.0, 1.0)
    lighter = np.clip(0.30 / max(float(tone @ LUMINANCE), 0.03), 1.08, 2.6)
    tint = np.repeat((1 + palm * (lighter - 1))[:, None], 3, axis=1)

    near = np.min(
        [np.linalg.norm(shaped.vertices - p, axis=1) for p in (*shaped.tips, *shaped.joints[1:13])], axis=0
    )
    tint *= 1 + np.exp(-((near / 0.011) ** 2))[:, None] * np.array([0.02, -0.12, -0.10])
    axes = anatomical_axes(model)
    owner = model.weights.argmax(axis=1)
    for finger, joints in FINGER_JOINTS.items():
        tip = shaped.tips[FINGERS.index(finger)]
        last = shaped.joints[joints[2]]
        along = (shaped.vertices - last) @ (tip - last) / np.sum((tip - last) ** 2)
        on_back = normals @ axes[joints[2] - 1][:, 1]
        tint[(owner == joints[2]) & (along > _NAIL_FROM) & (along < 0.97) & (on_back > 0.8)] *= (
            1.22,
            1.12,
            1.12,
        )
        for joint in joints:
            back, up = axes[joint - 1][:, 0], axes[joint - 1][:, 1]
            offset = shaped.vertices - shaped.joints[joint]
            crease = np.exp(-(((offset @ back) / 0.0025) ** 2)) * np.clip(-normals @ up, 0.0, 1.0)
            crease *= np.linalg.norm(offset, axis=1) < 0.016
            tint *= 1 - crease[:, None] * np.array([0.18, 0.26, 0.28])
    return np.clip(tint, 0.0, 3.0)
