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
