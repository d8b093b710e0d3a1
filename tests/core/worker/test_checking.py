"""What the request `check` advises where a part is missing or does not work."""

from __future__ import annotations

import sys

import pytest

from handfit_core.errors import HandfitError
from handfit_core.worker import checking


def test_a_package_that_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(HandfitError) as caught:
        checking._package("opencv-python-headless")
    assert str(caught.value).startswith("not installed; install the add-on's zip again; a Python of your own")
    assert str(caught.value).endswith("opencv-python-headless>=4.9")


@pytest.mark.parametrize(
    ("step", "broken", "result", "own"),
    [
        ("_detector", "blank_picture_hands", lambda: 2, "fetch the landmark model again"),
        ("_solver", "synthetic_fit_error_mm", lambda _side: 9.0, "NumPy and SciPy into a Python of your own"),
        ("_solver", "synthetic_fit_error_mm", lambda _side: float("nan"), "NumPy and SciPy"),
    ],
    ids=["detector", "solver", "solver-nan"],
)
def test_a_failed_self_test_says_what_to_do(monkeypatch, step, broken, result, own):
    monkeypatch.setattr(checking, broken, result)
    with pytest.raises(HandfitError) as caught:
        getattr(checking, step)()
    assert own in str(caught.value)
    assert "install the add-on's zip again" in str(caught.value)
