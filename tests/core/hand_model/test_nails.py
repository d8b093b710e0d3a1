"""Fingernails of the open hand: one plate per finger, on its back, at its end."""

from __future__ import annotations

import numpy as np
import pytest

from handfit_core.hand_model import load_model
from handfit_core.hand_model.anatomy import anatomical_axes
from handfit_core.hand_model.nails import nail_polygons
from handfit_core.skeleton import FINGER_JOINTS, FINGERS, SIDES
from tests.imitation_mano import imitation_model


@pytest.mark.parametrize("side", SIDES)
def test_nails(side):
    model = load_model(None, side)
    nails = np.flatnonzero(nail_polygons(model))
    corners = model.v_template[model.polygons[nails]]
    normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    axes, shaped = anatomical_axes(model), model.shaped()
    counted = 0
    for finger, tip in zip(FINGERS, shaped.tips, strict=True):
        joint = FINGER_JOINTS[finger][2]
        own = model.weights[model.polygons[nails]][..., joint].min(axis=1) > 0.9
        counted += int(own.sum())
        along = (corners[own].mean(axis=1) - shaped.joints[joint]) @ -axes[joint - 1][:, 0]
        length = np.linalg.norm(tip - shaped.joints[joint])
        assert 0.4 < along.min() / length < along.max() / length < 1.0, finger
        assert (normals[own] @ axes[joint - 1][:, 1]).min() > 0.6, finger
        grown = {int(model.polygons[nails[own]][0, 0])}
        for _ in range(own.sum()):
            touching = [q for q in model.polygons[nails[own]].tolist() if grown & set(q)]
            grown |= {v for q in touching for v in q}
        assert grown == set(model.polygons[nails[own]].ravel().tolist()), f"{finger}: one piece"
    assert counted == len(nails)


def test_other_models_have_skin_alone():
    assert not nail_polygons(imitation_model("right")).any()
