from __future__ import annotations

from pathlib import Path

import numpy as np

from handfit_core.detect.keypoints import Detections
from handfit_core.errors import DatasetError
from handfit_core.evaluate.detections import UnitDetections
from handfit_core.evaluate.labels import Entry, Labels, units_of
from handfit_core.evaluate.rows import rows_of
from handfit_core.evaluate.scoring import RowResult, score
from handfit_core.evaluate.summary import summarise
from handfit_core.geometry.camera import Intrinsics
from tests.core.evaluate.hands import CAMERA, HEIGHT, WIDTH, entry, found, joints, label, seen

TRUTH = joints()
AWAY = joints(at=(-0.15, 0.08, 0.5))


def strict_rows(entries, *detections: UnitDetections, camera: str = "assumed"):
    made = iter(detections)
    return rows_of(units_of(entries), lambda _: next(made), protocol="strict", max_hands=2, camera=camera)


def test_a_detection_of_nothing_labelled_is_an_extra_hand() -> None:
    made = strict_rows([entry("a", label(TRUTH))], found((seen(AWAY), seen(TRUTH))))
    assert (made.pictures, made.extra_hands, len(made.rows)) == (1, 1, 1)
    assert made.rows[0].track is not None
    detections = made.rows[0].track.track.detections
    np.testing.assert_allclose(detections.keypoints_2d[0], CAMERA.project(TRUTH))


def test_a_wrong_side_shows_in_handedness_alone() -> None:
    made = strict_rows([entry("a", label(TRUTH, "right"))], found((seen(TRUTH, "left"),)))
    result = RowResult(TRUTH, seen(TRUTH).keypoints)
    summary = summarise(score("m", "m", lambda _: result, made.rows, "strict"), "strict")
    assert summary["handedness"] == 0.0
    assert summary["detection_rate"] == 100.0
    assert summary["pa_mpjpe"] < 1e-6


def test_two_labelled_hands_are_two_rows_and_one_may_be_missed() -> None:
    made = strict_rows([entry("a", label(TRUTH), label(AWAY, "left"))], found((seen(AWAY, "left"),)))
    assert [(row.hand_index, row.track is not None) for row in made.rows] == [(0, False), (1, True)]
    assert made.extra_hands == 0


def test_a_clip_is_one_track_and_a_frame_without_a_hand_is_a_miss() -> None:
    frames = [entry(f"{i}", label(TRUTH), clip="walk", time=i / 25) for i in range(3)]
    made = strict_rows(frames, found((seen(TRUTH),), (), (seen(TRUTH),)))
    assert len(made.tracks) == 1
    assert [row.track is not None for row in made.rows] == [True, False, True]
    assert [row.frame for row in made.rows] == [0, 1, 2]


def test_what_cannot_be_used_is_named_and_the_rest_goes_on() -> None:
    def damaged() -> Labels:
        raise DatasetError("xyz of picture 7 holds a word")

    nothing = np.full((21, 3), np.nan)
    entries = [
        Entry("damaged", Path("damaged.png"), damaged),
        entry("empty", label(nothing)),
        entry("dark", label(TRUTH)),
        entry("good", label(TRUTH)),
    ]
    unreadable = UnitDetections(((),), np.zeros((1, 2), dtype=int), np.zeros(1))
    made = strict_rows(entries, unreadable, found((seen(TRUTH),)))
    assert [row.entry.name for row in made.rows] == ["good"]
    assert [(p.kind, p.where.split(":")[0]) for p in made.problems] == [
        ("labels cannot be read", "damaged"),
        ("no labelled hand", "empty"),
        ("picture cannot be read", "dark"),
    ]
    assert made.pictures == 1


def test_an_unreadable_frame_of_a_clip_is_no_miss() -> None:
    frames = [entry(f"{i}", label(TRUTH), clip="c", time=i / 25) for i in range(2)]
    detections = UnitDetections(
        Detections.of([[], [seen(TRUTH)]]), np.array([[0, 0], [WIDTH, HEIGHT]]), np.zeros(2)
    )
    made = strict_rows(frames, detections)
    assert [row.entry.name for row in made.rows] == ["1"]
    assert [(p.kind, p.where) for p in made.problems] == [("picture cannot be read", "0")]


def test_solvers_are_told_the_true_camera_only_if_asked() -> None:
    assumed = strict_rows([entry("a", label(TRUTH))], found((seen(TRUTH),)))
    assert assumed.tracks[0].intrinsics == Intrinsics.assumed(WIDTH, HEIGHT)
    told = strict_rows([entry("a", label(TRUTH))], found((seen(TRUTH),)), camera="labelled")
    assert told.tracks[0].intrinsics == CAMERA
    unknown = strict_rows([entry("a", label(TRUTH), camera=None)], found((seen(TRUTH),)), camera="labelled")
    assert unknown.tracks[0].intrinsics == Intrinsics.assumed(WIDTH, HEIGHT)
    assert [p.kind for p in unknown.problems] == ["camera missing: one is assumed"]


def test_a_camera_that_changes_within_a_clip_is_named() -> None:
    zoomed = Intrinsics(900.0, 900.0, 320.0, 240.0)
    frames = [
        entry(f"{i}", label(TRUTH), camera=camera, clip="zoom", time=i / 25)
        for i, camera in enumerate((CAMERA, zoomed))
    ]
    made = strict_rows(frames, found((seen(TRUTH),), (seen(TRUTH),)), camera="labelled")
    assert made.tracks[0].intrinsics == CAMERA
    assert [(p.kind, p.where) for p in made.problems] == [
        ("camera changes within the clip: its first one is used throughout", "1")
    ]


def test_whatever_is_found_in_a_picture_without_hands_is_extra() -> None:
    made = strict_rows(
        [entry("table"), entry("a", label(TRUTH))], found((seen(AWAY),)), found((seen(TRUTH),))
    )
    assert (made.pictures, made.extra_hands, len(made.rows)) == (2, 1, 1)
    assert made.problems == []
