"""A lens that is measured once: the board, its film, and captures with it."""

from __future__ import annotations

from pathlib import Path

import bpy
import pytest

from blender_manient.operators.capture import new_request
from blender_manient.panels.advanced import MANIENT_PT_advanced
from blender_manient.scene.store import captured_hands, hand_of
from blender_manient.session import properties
from handfit_core.common.errors import OptionError
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.lens import Lens
from handfit_core.media.lenses import MeasuredLens, lenses_path, save_lens
from tests.capturing import needs_capture
from tests.drawn import drawn

SAMPLE = Path(__file__).resolve().parents[2] / "samples" / "rendered_hand" / "hand.0001.jpg"
LENS = Lens(Intrinsics(430.0, 430.0, 322.0, 238.0), (-0.1, 0.0, 0.0, 0.0, 0.0), 640, 480)


@pytest.fixture
def settings(registered, tmp_path, monkeypatch):
    """The panel's, with a picture as the source, and no lens saved."""
    monkeypatch.setenv("HANDFIT_DATA", str(tmp_path / "data"))
    bpy.context.scene.manient.source = str(SAMPLE)
    return bpy.context.scene.manient


def test_measured_lenses_are_offered_by_name(settings):
    settings.camera = "LENS"
    with pytest.raises(OptionError, match="choose the measured lens"):
        new_request(bpy.context, only_frame=False)
    page = drawn(MANIENT_PT_advanced)
    assert {"Chessboard", "Measure"} <= set(page.rows)
    assert "Film the chessboard for half a minute" in page.said
    for name in ("my/phone", "Webcam 📷"):
        save_lens(name, MeasuredLens(LENS, 0.2, 1.0, 20))
    assert properties.choices_of_option["measured_lens"]() == ["Webcam 📷", "my/phone"]
    settings.measured_lens = "my/phone"
    assert new_request(bpy.context, only_frame=False).options.lens == LENS
    save_lens("my/phone", None)
    with pytest.raises(OptionError, match="no measured lens my/phone; saved are Webcam"):
        new_request(bpy.context, only_frame=False)
    lenses_path().write_text("damaged")
    assert properties.choices_of_option["measured_lens"]() == []


@needs_capture
def test_a_lens_is_measured_and_captured_with(settings, tmp_path):
    from tests.films import all_around, film  # which needs OpenCV

    assert bpy.ops.manient.show_chessboard() == {"FINISHED"}
    assert (tmp_path / "cache" / "manient" / "chessboard.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(RuntimeError, match="Choose the film"):
        bpy.ops.manient.measure_lens(filepath=str(tmp_path / "gone.mp4"), lens="mine")
    short = film(tmp_path / "short.mp4", LENS, all_around(LENS, 3), still=1)
    with pytest.raises(RuntimeError, match="the chessboard was found in 3 places only: show"):
        bpy.ops.manient.measure_lens(filepath=str(short), lens="mine")
    assert (settings.camera, lenses_path().exists()) == ("SOLVE", False)

    clip = film(tmp_path / "film.mp4", LENS, all_around(LENS, 20), still=1)
    assert bpy.ops.manient.measure_lens(filepath=str(clip), lens="mine") == {"FINISHED"}
    assert (settings.camera, settings.measured_lens) == ("LENS", "mine")
    assert bpy.ops.manient.capture() == {"FINISHED"}
    (armature,) = captured_hands(bpy.context.scene)
    hand = hand_of(armature)
    assert hand is not None
    assert hand.camera is not None
    assert hand.take.intrinsics.fx == pytest.approx(430.0, rel=0.005)
    assert hand.camera.data.lens == pytest.approx(hand.take.intrinsics.fx * 36.0 / 640.0, rel=1e-4)
