from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from handfit_core.capturing.options import CaptureOptions
from handfit_core.common.arrays import arrays_of
from handfit_core.common.skeleton import SIDES
from handfit_core.evaluate.detections import UnitDetections, UnitDetector
from handfit_core.evaluate.labels import Entry, Labels, Unit
from handfit_core.media.pictures import read_picture

SAMPLE = Path(__file__).resolve().parents[3] / "samples" / "rendered_hand"


pytestmark = pytest.mark.usefixtures("landmark_model", "cache")


def entries(*pictures: Path) -> tuple[Entry, ...]:
    return tuple(Entry(p.stem, p, lambda: Labels((), None), "clip", i / 25) for i, p in enumerate(pictures))


def still(picture: Path) -> Unit:
    return Unit(entries(picture), is_clip=False)


def detect(unit: Unit, options: CaptureOptions | None = None) -> tuple[UnitDetections, int]:
    """And how often the caller was told of a picture."""
    told: list[None] = []
    with UnitDetector(options or CaptureOptions()) as detector:
        return detector.detect(unit, lambda: told.append(None)), len(told)


def kept(folder: Path) -> list[Path]:
    return sorted(folder.rglob("output.pkl"))


def assert_same(a: UnitDetections, b: UnitDetections) -> None:
    one, other = arrays_of(a.hands), arrays_of(b.hands)
    assert one.keys() == other.keys()
    for name, column in one.items():
        np.testing.assert_array_equal(column, other[name], err_msg=name)
    np.testing.assert_array_equal(a.sizes, b.sizes)


def test_a_second_run_reads_what_the_first_found(cache: Path) -> None:
    unit = Unit(entries(*(SAMPLE / f"hand.{i:04}.jpg" for i in (1, 2, 3))), is_clip=True)
    fresh, told = detect(unit)
    assert told == 3
    assert fresh.hands.frame.tolist() == [0, 1, 2]
    assert fresh.hands.side[0] == SIDES.index("right")
    assert fresh.sizes.tolist() == [[640, 480]] * 3
    written = [file.stat().st_mtime_ns for file in kept(cache)]
    again, told = detect(unit)
    assert told == 3
    assert_same(fresh, again)
    assert [file.stat().st_mtime_ns for file in kept(cache)] == written


def test_content_settings_and_clips_have_results_of_their_own(tmp_path: Path, cache: Path) -> None:
    picture = SAMPLE / "hand.0001.jpg"
    found, _ = detect(still(picture))
    shutil.copy(picture, tmp_path / "moved.jpg")
    assert_same(found, detect(still(tmp_path / "moved.jpg"))[0])
    assert len(kept(cache)) == 1
    detect(still(SAMPLE / "hand.0009.jpg"))
    detect(still(picture), CaptureOptions(max_hands=1))
    detect(replace(still(picture), is_clip=True))
    detect(still(picture), CaptureOptions(plain_detection=True))
    detect(still(picture), CaptureOptions(quality="draft"))
    assert len(kept(cache)) == 6


def test_unreadable_pictures_are_known_as_such(tmp_path: Path) -> None:
    broken = tmp_path / "broken.jpg"
    broken.write_bytes(b"no picture")
    unit = Unit(entries(SAMPLE / "hand.0001.jpg", broken, tmp_path / "gone.jpg"), is_clip=True)
    for _ in range(2):
        found, told = detect(unit)
        assert found.readable.tolist() == [True, False, False]
        assert found.hands.frame.tolist() == [0]
        assert told == 3


def test_pictures_are_taken_as_stored_like_their_labels(tmp_path: Path) -> None:
    plain = (SAMPLE / "hand.0001.jpg").read_bytes()
    tag = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    turned = tmp_path / "turned.jpg"
    turned.write_bytes(plain[:2] + b"\xff\xe1" + (len(tag) + 2).to_bytes(2, "big") + tag + plain[2:])
    assert read_picture(turned)[1] == 6  # a viewer turns it
    found, _ = detect(still(turned))
    assert found.sizes.tolist() == [[640, 480]]
