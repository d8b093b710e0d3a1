"""Fits are kept by all that decides them, and made by as many processes as asked for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from handfit_core.evaluate.fits import Task, fit_all
from handfit_core.evaluate.rows import TrackInView
from tests.core.evaluate.hands import CAMERA, joints, seen
from tests.core.fit.detections import track_of


def tasks(method: str, count: int) -> list[Task]:
    places = [(0.1 + 0.01 * i, 0.08, 0.5) for i in range(count)]
    return [(method, TrackInView(track_of("right", [seen(joints(at=at))]), CAMERA)) for at in places]


def kept(folder: Path) -> dict[Path, int]:
    return {path: path.stat().st_mtime_ns for path in folder.rglob("output.pkl")}


def test_goes_on_where_an_earlier_run_ended(cache: Path) -> None:
    wanted = tasks("fused", 3)
    list(fit_all(wanted[:1], "strict"))
    first = kept(cache)
    list(fit_all(wanted, "strict"))
    second = kept(cache)
    assert (len(first), len(second)) == (1, 3)
    assert second.items() >= first.items()  # the first was not made again


@pytest.mark.slow
def test_several_processes_find_the_same(cache: Path) -> None:
    wanted = tasks("paper-b", 2)
    together = [result.points_3d for result in fit_all(wanted, "strict", jobs=2)]
    for file in kept(cache):
        file.write_bytes(b"cut off")  # and so is made again
    alone = [result.points_3d for result in fit_all(wanted, "strict")]
    np.testing.assert_array_equal(alone, together)


@pytest.mark.parametrize("change", ["side", "camera", "method", "protocol"])
def test_whatever_decides_a_result_decides_where_it_is_kept(cache: Path, change: str) -> None:
    ((name, view),) = tasks("fused", 1)
    list(fit_all([(name, view)], "strict"))
    other = {
        "side": (name, view._replace(track=replace(view.track, side="left"))),
        "camera": (name, view._replace(intrinsics=type(CAMERA)(900.0, 900.0, 320.0, 240.0))),
        "method": ("raw-image", view),
        "protocol": (name, view),
    }[change]
    list(fit_all([other], "paper" if change == "protocol" else "strict"))
    assert len(kept(cache)) == 2
