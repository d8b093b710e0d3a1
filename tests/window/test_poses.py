"""The library of poses, in Blender's window."""

from __future__ import annotations

import numpy as np

from tests.window.blender_window import ROOT

TAKE = ROOT / "samples" / "rendered_hand" / "truth.take.npz"


def test_a_pose_is_chosen_by_its_picture_and_ones_own_is_saved(blender):
    played = blender.play("poses.library", take=TAKE).value
    assert played["chosen"] == "Fist"
    assert np.abs(np.subtract(played["before"], played["fist"])).max() > 0.5
    np.testing.assert_allclose(played["applied"], played["fist"], atol=1e-4)
    np.testing.assert_allclose(played["undone"], played["before"], atol=1e-5)
    for pose in played["held"]:
        np.testing.assert_allclose(pose, played["fist"], atol=1e-4)
    assert np.abs(np.subtract(played["released"], played["fist"])).max() > 0.5
    np.testing.assert_allclose(played["own"], played["fist"], atol=1e-4)
    assert all(icon > 0 for icon in played["icons"])
    assert len(set(played["icons"])) == len(played["icons"])


def test_a_pose_asset_is_applied_from_the_asset_browser(blender):
    played = blender.play("poses.from_the_asset_browser", take=TAKE).value
    assert np.abs(np.subtract(played["before"], played["saved"])).max() > 0.5
    np.testing.assert_allclose(played["after"], played["saved"], atol=1e-4)
