"""A lens from a film of a chessboard: known lenses are found, films that do not tell enough say what is
missing, and lenses are kept by name."""

import json

import cv2
import numpy as np
import pytest

from handfit_core.common.errors import Cancelled, InputError, OptionError
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.lens import Lens
from handfit_core.media.chessboard import CORNERS, board_png, measure_lens
from handfit_core.media.lenses import MeasuredLens, lenses_path, save_lens, saved_lens, saved_lenses
from tests.films import all_around, film

WEBCAM = Lens(Intrinsics(430.0, 430.0, 330.0, 172.0), (-0.15, 0.05, 0.0, 0.0, 0.0), 640, 360)
PHONE = Lens(Intrinsics(520.0, 520.0, 176.0, 322.0), (0.0, 0.0, 0.0, 0.0, 0.0), 360, 640)
"""Upright, and without distortion"""
MEASURED = MeasuredLens(WEBCAM, 0.2, 1.5, 20)


def test_the_board_is_found_in_its_own_picture():
    picture = cv2.imdecode(np.frombuffer(board_png(), np.uint8), cv2.IMREAD_UNCHANGED)
    assert picture.shape == (1080, 1920)
    found, corners = cv2.findChessboardCornersSB(picture, CORNERS)
    assert found
    steps = np.diff(corners.reshape(CORNERS[1], CORNERS[0], 2), axis=1)[..., 0]
    np.testing.assert_allclose(np.abs(steps), 120.0, atol=0.1)
    edges = [picture[:119], picture[-119:], picture[:, :119], picture[:, -119:]]
    assert min(edge.min() for edge in edges) == 255


@pytest.mark.parametrize("lens", [WEBCAM, PHONE], ids=["wide", "upright"])
def test_a_known_lens_is_measured(tmp_path, lens):
    measured = measure_lens(film(tmp_path / "film.mp4", lens, all_around(lens, 24), still=1))
    found = measured.lens
    assert (found.width, found.height) == (lens.width, lens.height)
    assert found.intrinsics.fx == found.intrinsics.fy == pytest.approx(lens.intrinsics.fx, rel=0.004)
    assert found.distortion == pytest.approx(lens.distortion, abs=0.02)
    assert measured.focal_sigma < 0.004 * lens.intrinsics.fx
    corners = np.array([[5.0, 5.0], [lens.width - 5.0, 5.0], [lens.width / 2.0, lens.height - 5.0]])
    np.testing.assert_allclose(
        found.intrinsics.rays(found.undistorted(corners)),
        lens.intrinsics.rays(lens.undistorted(corners)),
        atol=0.01,
    )


def far_left(lens):
    """Small boards in one corner."""
    return [(turn, place * (0.6, 0.6, 2.0) - (0.35, 0.2, 0.0)) for turn, place in all_around(lens, 16)]


def wobbling(picture):
    """As stabilisation bends pictures."""
    y, x = np.mgrid[: picture.shape[0], : picture.shape[1]].astype(np.float32)
    phase = float(picture[::9, ::9].sum() % 6)
    return cv2.remap(
        picture, x + 4 * np.sin(y / 40 + phase), y + 4 * np.sin(x / 50 - phase), cv2.INTER_LINEAR
    )


BAD = {
    "no board": (
        all_around(WEBCAM, 4),
        lambda picture: picture * 0 + 90,
        "in none of 4 frames: show the whole",
    ),
    "few": (all_around(WEBCAM, 5), None, "in 5 places only"),
    "frontal": (all_around(WEBCAM, 16, tilt=0.02), None, "always filmed from the front"),
    "one corner": (
        far_left(WEBCAM),
        None,
        r"parts of the picture only: film it also at the right and the bottom",
    ),
    "stabilised": (
        all_around(WEBCAM, 16),
        wobbling,
        "px from where a lens would show them: turn the camera's",
    ),
}


@pytest.mark.parametrize("bad", BAD)
def test_a_film_that_does_not_tell_enough_says_what_to_film(tmp_path, bad):
    poses, change, said = BAD[bad]
    path = film(tmp_path / "film.mp4", WEBCAM, poses, still=1, change=change)
    with pytest.raises(InputError, match=said):
        measure_lens(path)


def test_measuring_tells_how_far_it_is_and_can_be_stopped(tmp_path):
    path, told = film(tmp_path / "film.mp4", WEBCAM, all_around(WEBCAM, 3), still=1), []
    with pytest.raises(Cancelled, match="stopped before the lens"):
        measure_lens(path, lambda done, total: told.append((done, total)), lambda: len(told) == 2)
    assert told == [(1, 3), (2, 3)]


@pytest.fixture
def data(tmp_path, monkeypatch):
    monkeypatch.setenv("HANDFIT_DATA", str(tmp_path / "data"))
    return tmp_path / "data"


def test_lenses_are_kept_by_any_name(data):
    """In one file, whose name is none of theirs."""
    assert saved_lenses() == {}
    names = ["my phone", "../../etc/passwd", "a/b\\c", "nul\0\nx", "\ud800x"]
    for name in names:
        save_lens(name, MEASURED)
    assert saved_lenses() == dict.fromkeys(sorted([*names[:-1], "?x"]), MEASURED)
    assert [path.name for path in data.iterdir()] == ["lenses.json"]
    save_lens("a/b\\c", None)
    better = MeasuredLens(WEBCAM, 0.1, 0.5, 30)
    save_lens(" my phone ", better)
    assert saved_lens("my phone") == better
    with pytest.raises(OptionError, match=r"no measured lens a/b\\c; saved are "):
        saved_lens("a/b\\c")


@pytest.mark.parametrize("name", ["  ", "..", "1.2,0.5,0.5", "x" * 61])
def test_names_that_mean_something_else_are_refused(data, name):
    with pytest.raises(OptionError, match="a name with a letter"):
        save_lens(name, MEASURED)
    assert not data.exists()


@pytest.mark.parametrize("content", ["", '{"a": {"error": 1}}', "[" * 100_000])
def test_a_damaged_file_is_told_of_and_stays(data, content):
    data.mkdir()
    lenses_path().write_text(content)
    with pytest.raises(InputError, match="the saved lenses cannot be read"):
        save_lens("mine", MEASURED)
    assert lenses_path().read_text() == content


@pytest.mark.parametrize(
    ("name", "value"),
    [("distortion", [np.nan] * 5), ("boards", np.inf), ("error", np.nan), ("width", np.inf)],
)
def test_a_saved_lens_with_impossible_numbers(data, name, value):
    save_lens("mine", MEASURED)
    content = json.loads(lenses_path().read_text())
    content["mine"][name] = value
    lenses_path().write_text(json.dumps(content))
    with pytest.raises(InputError, match=f"{name} must be a"):
        saved_lens("mine")
