from __future__ import annotations

import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from handfit_core.evaluate.fits import Fits, FitTask
from tests.conftest import ROOT
from tests.core.evaluate.hands import CAMERA, joints, seen
from tests.core.fit.detections import track_of


def tasks(method: str, count: int) -> list[FitTask]:
    return [
        FitTask(method, track_of("right", [seen(joints(at=(0.1 + 0.01 * i, 0.08, 0.5)))]), CAMERA)
        for i in range(count)
    ]


def fits(folder: Path) -> Fits:
    return Fits(folder, "strict", None, {"right"})


def times(folder: Path) -> dict[Path, int]:
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*.npz")}


def test_a_run_goes_on_where_an_earlier_one_ended(tmp_path: Path) -> None:
    wanted = tasks("fused", 3)
    run = fits(tmp_path).run(wanted, jobs=1)
    next(run)
    run.close()  # stopped after the first
    after_first = times(tmp_path)
    assert len(after_first) == 1
    assert len(list(fits(tmp_path).run(wanted, jobs=1))) == 3
    after_second = times(tmp_path)
    assert len(after_second) == 3
    assert after_second.items() >= after_first.items()  # the first was not made again
    list(fits(tmp_path).run(wanted, jobs=1))
    assert times(tmp_path) == after_second


def test_several_processes_find_the_same(tmp_path: Path) -> None:
    wanted = tasks("paper-b", 2)
    alone, together = fits(tmp_path / "alone"), fits(tmp_path / "together")
    list(alone.run(wanted, jobs=1))
    assert len(list(together.run(wanted, jobs=2))) == 2
    for task in wanted:
        np.testing.assert_array_equal(alone.result(task).points_3d, together.result(task).points_3d)


def test_a_damaged_result_is_made_again(tmp_path: Path) -> None:
    (task,) = tasks("fused", 1)
    made = fits(tmp_path)
    list(made.run([task], jobs=1))
    expected = made.result(task).points_3d
    (file,) = tmp_path.rglob("*.npz")
    file.write_bytes(b"cut off")
    np.testing.assert_array_equal(made.result(task).points_3d, expected)


@pytest.mark.parametrize("change", ["side", "camera", "method", "protocol"])
def test_whatever_decides_a_result_decides_its_file(tmp_path: Path, change: str) -> None:
    (task,) = tasks("fused", 1)
    list(Fits(tmp_path, "strict", None, {"left", "right"}).run([task], jobs=1))
    other = {
        "side": FitTask("fused", replace(task.track, side="left"), CAMERA),
        "camera": FitTask("fused", task.track, type(CAMERA)(900.0, 900.0, 320.0, 240.0)),
        "method": FitTask("raw-image", task.track, CAMERA),
        "protocol": task,
    }[change]
    protocol = "paper" if change == "protocol" else "strict"
    list(Fits(tmp_path, protocol, None, {"left", "right"}).run([other], jobs=1))
    assert len(times(tmp_path)) == 2


_KILLED = """
import multiprocessing, sys
from pathlib import Path
from handfit_core.evaluate.fits import Fits
from tests.core.evaluate.test_fits import tasks
from tests.core.fit.detections import track_of

if __name__ == "__main__":
    run = Fits(Path(sys.argv[1]), "strict", None, {"right"}).run(tasks("paper-h", 20), jobs=2)
    next(run)
    print(*(child.pid for child in multiprocessing.active_children()), flush=True)
    for _ in run:
        pass
"""


@pytest.mark.skipif(sys.platform == "win32", reason="asks for processes as POSIX does")
def test_children_end_with_a_parent_that_is_killed(tmp_path: Path) -> None:
    script = tmp_path / "killed.py"
    script.write_text(_KILLED)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, str(script), str(tmp_path / "fits")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as parent:
        assert parent.stdout is not None
        children = [int(pid) for pid in parent.stdout.readline().split()]
        parent.kill()
    assert len(children) == 2
    deadline = time.monotonic() + 60
    while any(_alive(pid) for pid in children) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not any(_alive(pid) for pid in children)


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True
