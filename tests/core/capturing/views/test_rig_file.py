"""Calibrations of two cameras, written and read."""

from __future__ import annotations

import numpy as np
import pytest

from handfit_core.capturing.options import CaptureOptions
from handfit_core.capturing.views.joining import joined
from handfit_core.capturing.views.rig_file import read_rig, write_rig
from handfit_core.common.errors import InputError, OptionError
from tests.core.capturing.views.filmed import takes
from tests.core.fit.differences import close


def test_calibrations(tmp_path):
    first, second = takes()
    take = joined(first, second, CaptureOptions())
    assert take.cameras is not None
    path = tmp_path / "rig.toml"
    write_rig(path, take)
    rig = read_rig(path, ["a", "b"], [(640, 480), (640, 480)])
    close(rig.rotation, take.cameras.rotation[1])
    close(rig.translation, take.cameras.translation[1])
    close(list(vars(rig.lenses[1].intrinsics).values()), take.cameras.intrinsics[1])
    other_way = read_rig(path, ["b", "a"], [(640, 480), (320, 240)])
    close(other_way.rotation, rig.rotation.T)
    assert other_way.lenses[1].intrinsics.fx == pytest.approx(rig.lenses[0].intrinsics.fx / 2.0)
    known = joined(first, second, CaptureOptions(), rig)
    assert known.cameras is not None
    close(known.cameras.rotation[1], rig.rotation)
    in_mm = tmp_path / "mm.toml"
    shift = np.round(take.cameras.translation[1], 6).tolist()
    text = path.read_text().replace(
        f"translation = {take.cameras.translation[1].tolist()}", f"translation = {shift}"
    )
    in_mm.write_text(text.replace(f"{shift}", f"{[1000.0 * v for v in shift]}"))
    close(read_rig(in_mm, ["a", "b"], [(640, 480)] * 2).translation, shift)
    with pytest.raises(
        OptionError, match="the first view's camera was calibrated for 640x480, and a has another"
    ):
        read_rig(path, ["a", "b"], [(480, 480), (640, 480)])
    path.write_text(path.read_text() + path.read_text().split("[metadata]")[0].replace("cam_", "more_"))
    with pytest.raises(InputError, match="it has 4 cameras"):
        read_rig(path, ["x", "y"], [(640, 480)] * 2)
    with pytest.raises(OptionError, match="the take has one view"):
        write_rig(path, first.take)


CAMERA = """[cam_{0}]
name = "{0}"
size = [640, 480]
matrix = [[600.0, 0.0, 320.0], [0.0, 600.0, 240.0], [0.0, 0.0, 1.0]]
distortions = [0.0, 0.0, 0.0, 0.0, 0.0]
rotation = [0.0, 0.0, 0.0]
translation = [{0}.0, 0.0, 0.0]
"""
RIG = CAMERA.format(0) + CAMERA.format(1)


@pytest.mark.parametrize(
    ("was", "becomes"),
    [
        ("[cam_0]", "\ufeff[cam_0]"),
        ("rotation", "fisheye = false\nrotation"),
        ("distortions = [", "distortions = [0.0, 0.0, 0.0, "),
    ],
    ids=["byte-order mark", "no fisheye", "rational without effect"],
)
def test_calibrations_that_are_right(tmp_path, was, becomes):
    (tmp_path / "rig.toml").write_text(RIG.replace(was, becomes, 1), encoding="utf-8")
    rig = read_rig(tmp_path / "rig.toml", ["0", "1"], [(640, 480)] * 2)
    assert [lens.intrinsics.fx for lens in rig.lenses] == [600.0, 600.0]
    close(rig.translation, [1.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("was", "becomes", "said"),
    [
        ("rotation", "fisheye = true\nrotation", "camera '0' is a fisheye"),
        ("[[600.0, 0.0", "[[600.0, 5.0", r"not \[\[fx, 0, cx\]"),
        ("[0.0, 600.0", "[0.0, 6.0", "fx 600 and fy 6"),
        ("[[600.0", "[[nan", "matrix must be a finite number"),
        ("[640", "[inf", "size must be a finite number"),
        ("[640", "[1" + "0" * 400, "size must be a finite number"),
        ("[640", "[0", "needs the size of its pictures"),
        ("rotation = [", "rotation = [0.0, ", "rotation has 4 numbers"),
        ("0.0, 0.0, 0.0, 0.0, 0.0]", "0.1, 0.1, 0.0, 0.0, 0.1, 0.2, 0.1, 0.1]", "has 8 distortions"),
        ("distortions = [", "distortions = [" + "0, " * 100_000, "has 100005 distortions"),
        ("distortions = [", "distortions = [" + "0.1, " * 100_000, "longer lines of numbers"),
        ("[cam_0]", "a = " + 2000 * "[" + 2000 * "]" + "\n[cam_0]", "nested deeper"),
        ("[cam_0]", "a" + 50_000 * ".a" + " = 1\n[cam_0]", "nested deeper"),
    ],
)  # fmt: skip
def test_other_cameras_are_refused_in_a_sentence(tmp_path, was, becomes, said):
    (tmp_path / "rig.toml").write_text(RIG.replace(was, becomes, 1))
    with pytest.raises(InputError, match=said) as raised:
        read_rig(tmp_path / "rig.toml", ["0", "1"], [(640, 480)] * 2)
    assert len(str(raised.value)) < 600
