"""What the request `check` advises where a package is missing."""

from __future__ import annotations

import sys

import pytest

from handfit_core.worker import checking


@pytest.mark.parametrize(
    ("bundled", "left_out", "remedy"),
    [
        ("", "", "not installed; install torch>=2.2 into this Python, or choose another one"),
        ("1", "", "not installed; remove the add-on, restart Blender and install its zip again, or choose"),
        ("1", "mediapipe", "not installed; remove the add-on"),
        ("1", "scipy,torch", "not installed; the add-on's zip does not have it for this Python: choose"),
    ],
    ids=["own", "bundled", "other-left-out", "left-out"],
)
def test_a_remedy_that_can_work(monkeypatch, bundled, left_out, remedy):
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.setenv(checking.BUNDLED_VARIABLE, bundled)
    monkeypatch.setenv(checking.LEFT_OUT_VARIABLE, left_out)
    with pytest.raises(checking.HandfitError) as caught:
        checking._package("torch")()
    assert str(caught.value).startswith(remedy)


@pytest.mark.parametrize(
    ("step", "broken", "result", "own"),
    [
        ("_detector", "blank_picture_hands", lambda: 2, "fetch the landmark model again"),
        ("_solver", "synthetic_fit_error_mm", lambda _side: 9.0, "install torch and handfit-core again"),
        ("_solver", "synthetic_fit_error_mm", lambda _side: float("nan"), "install torch and handfit-core"),
    ],
    ids=["detector", "solver", "solver-nan"],
)
@pytest.mark.parametrize("bundled", ["", "1"], ids=["own", "bundled"])
def test_a_failed_self_test_says_what_to_do(monkeypatch, step, broken, result, own, bundled):
    from handfit_core.worker import trial

    monkeypatch.setattr(trial, broken, result)
    monkeypatch.setenv(checking.BUNDLED_VARIABLE, bundled)
    with pytest.raises(checking.HandfitError) as caught:
        getattr(checking, step)()
    assert (own in str(caught.value)) == (not bundled)
    assert ("install its zip again" in str(caught.value)) == bool(bundled)
