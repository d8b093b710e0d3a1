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


def test_a_run_goes_on_where_an_earlier_one_ended(tmp_path: Path) -> None:
    wanted = tasks("fused", 3)
    list(fit_all(wanted[:1], tmp_path, "strict"))
    first = kept(tmp_path)
    list(fit_all(wanted, tmp_path, "strict"))
    second = kept(tmp_path)
    assert (len(first), len(second)) == (1, 3)
    assert second.items() >= first.items()  # the first was not made again
    list(fit_all(wanted, tmp_path, "strict"))
    assert kept(tmp_path) == second


def test_several_processes_find_the_same(tmp_path: Path) -> None:
    wanted = tasks("paper-b", 2)
    alone = fit_all(wanted, tmp_path / "alone", "strict")
    together = fit_all(wanted, tmp_path / "together", "strict", jobs=2)
    for one, other in zip(alone, together, strict=True):
        np.testing.assert_array_equal(one.points_3d, other.points_3d)
    assert len(kept(tmp_path / "together")) == 2


def test_a_damaged_result_is_made_again(tmp_path: Path) -> None:
    (expected,) = fit_all(tasks("fused", 1), tmp_path, "strict")
    (file,) = kept(tmp_path)
    file.write_bytes(b"cut off")
    (again,) = fit_all(tasks("fused", 1), tmp_path, "strict")
    np.testing.assert_array_equal(again.points_3d, expected.points_3d)


@pytest.mark.parametrize("change", ["side", "camera", "method", "protocol"])
def test_whatever_decides_a_result_decides_where_it_is_kept(tmp_path: Path, change: str) -> None:
    ((name, view),) = tasks("fused", 1)
    list(fit_all([(name, view)], tmp_path, "strict"))
    other = {
        "side": (name, view._replace(track=replace(view.track, side="left"))),
        "camera": (name, view._replace(intrinsics=type(CAMERA)(900.0, 900.0, 320.0, 240.0))),
        "method": ("raw-image", view),
        "protocol": (name, view),
    }[change]
    list(fit_all([other], tmp_path, "paper" if change == "protocol" else "strict"))
    assert len(kept(tmp_path)) == 2
