"""Rows: labelled hands with their detected tracks, matched whatever the order and the side."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from handfit_core.common.errors import DatasetError
from handfit_core.detect.keypoints import Detections
from handfit_core.evaluate.detections import UnitDetections
from handfit_core.evaluate.labels import Entry, Labels, units_of
from handfit_core.evaluate.methods import TrackResult
from handfit_core.evaluate.rows import label_pixels, match
from handfit_core.evaluate.scoring import score
from handfit_core.evaluate.summary import summarise
from handfit_core.geometry.camera import Intrinsics
from tests.core.evaluate.hands import CAMERA, HEIGHT, WIDTH, entry, found, joints, label, rows, seen

TRUTH = joints()
AWAY = joints(at=(-0.15, 0.08, 0.5))


def test_a_detection_of_nothing_labelled_is_an_extra_hand() -> None:
    made = rows([entry("a", label(TRUTH))], found((seen(AWAY), seen(TRUTH))))
    assert (made.pictures, made.extra_hands, len(made.listed)) == (1, 1, 1)
    detections = made.tracks[made.listed[0]["track"]].track.detections
    np.testing.assert_allclose(detections.keypoints_2d[0], CAMERA.project(TRUTH))


def test_a_wrong_side_shows_in_handedness_alone() -> None:
    made = rows([entry("a", label(TRUTH, "right"))], found((seen(TRUTH, "left"),)))
    result = TrackResult.of_points(TRUTH[None], seen(TRUTH).keypoints)
    summary = summarise(score("m", result, made, "strict"), "strict")
    assert summary["handedness"] == 0.0
    assert summary["detection_rate"] == 100.0
    assert summary["pa_mpjpe"] < 1e-6


def test_two_labelled_hands_are_two_rows_and_one_may_be_missed() -> None:
    made = rows([entry("a", label(TRUTH), label(AWAY, "left"))], found((seen(AWAY, "left"),)))
    assert [(row["hand"], row["track"]) for row in made.listed] == [(0, -1), (1, 0)]
    assert made.extra_hands == 0


def test_a_clip_is_one_track_and_a_frame_without_a_hand_is_a_miss() -> None:
    frames = [entry(f"{i}", label(TRUTH), clip="walk", time=i / 25) for i in range(3)]
    made = rows(frames, found((seen(TRUTH),), (), (seen(TRUTH),)))
    assert len(made.tracks) == 1
    assert [row["track"] for row in made.listed] == [0, -1, 0]
    assert [row["frame"] for row in made.listed] == [0, 1, 2]
    # A frame that cannot be read is none.
    dark = UnitDetections(Detections.of([[], [seen(TRUTH)]]), np.array([[0, 0], [WIDTH, HEIGHT]]))
    made = rows(frames[:2], dark)
    assert [row["sample"] for row in made.listed] == ["1"]
    assert [(p.kind, p.where) for p in made.problems] == [("picture cannot be read", "0")]


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
    unreadable = UnitDetections(Detections.of([[]]), np.zeros((1, 2), dtype=int))
    made = rows(entries, unreadable, found((seen(TRUTH),)))
    assert [row["sample"] for row in made.listed] == ["good"]
    assert [(p.kind, p.where.split(":")[0]) for p in made.problems] == [
        ("labels cannot be read", "damaged"),
        ("no labelled hand", "empty"),
        ("picture cannot be read", "dark"),
    ]
    assert made.pictures == 1


def test_solvers_are_told_the_true_camera_only_if_asked() -> None:
    assumed = rows([entry("a", label(TRUTH))], found((seen(TRUTH),)))
    assert assumed.tracks[0].intrinsics == Intrinsics.assumed(WIDTH, HEIGHT)
    told = rows([entry("a", label(TRUTH))], found((seen(TRUTH),)), camera="labelled")
    assert told.tracks[0].intrinsics == CAMERA
    unknown = rows([entry("a", label(TRUTH), camera=None)], found((seen(TRUTH),)), camera="labelled")
    assert unknown.tracks[0].intrinsics == Intrinsics.assumed(WIDTH, HEIGHT)
    assert [p.kind for p in unknown.problems] == ["camera missing: one is assumed"]
    zoomed = Intrinsics(900.0, 900.0, 320.0, 240.0)
    frames = [entry(str(c.fx), label(TRUTH), camera=c, clip="zoom", time=c.fx / 25) for c in (CAMERA, zoomed)]
    changed = rows(frames, found((seen(TRUTH),), (seen(TRUTH),)), camera="labelled")
    assert changed.tracks[0].intrinsics == CAMERA
    assert [(p.kind, p.where) for p in changed.problems] == [
        ("camera changes within the clip: its first one is used throughout", "900.0")
    ]


def test_whatever_is_found_in_a_picture_without_hands_is_extra() -> None:
    made = rows([entry("table"), entry("a", label(TRUTH))], found((seen(AWAY),)), found((seen(TRUTH),)))
    assert (made.pictures, made.extra_hands, len(made.listed)) == (2, 1, 1)
    assert made.problems == []


# Matching

LEFT_OF_PICTURE, RIGHT_OF_PICTURE = joints(at=(-0.12, 0.08, 0.5)), joints(at=(0.12, 0.08, 0.5))


def pixels_of(points: np.ndarray, *known: int) -> np.ndarray:
    """(21, 2) labelled pixels, of the `known` points alone where any are named."""
    pixels = label(points).keypoints_2d
    return np.where(np.isin(np.arange(21), known)[:, None], pixels, np.nan) if known else pixels


ONE, OTHER = pixels_of(LEFT_OF_PICTURE), pixels_of(RIGHT_OF_PICTURE)


@pytest.mark.parametrize(
    ("labels", "detections", "matched"),
    [
        ([ONE, OTHER], [OTHER, ONE], [1, 0]),  # whatever the order
        ([ONE], [OTHER], [None]),  # a stray is no detection of the hand
        ([ONE, OTHER], [ONE], [0, None]),  # and pushes no pair apart
        ([ONE, OTHER], [], [None, None]),
        ([pixels_of(LEFT_OF_PICTURE, 8)], [OTHER, ONE], [1]),  # one labelled point is enough
        ([np.full((21, 2), np.nan), OTHER], [OTHER, ONE], [1, 0]),  # without pixels: what is left
    ],
)
def test_matching(labels, detections, matched) -> None:
    assert match(labels, detections) == matched


def test_missing_pixels_are_projected_and_points_behind_the_camera_are_not() -> None:
    points = LEFT_OF_PICTURE.copy()
    points[4, 2] = -0.1
    hand = label(points)
    without = type(hand)(hand.side, points, np.full((21, 2), np.nan))
    pixels = label_pixels(without, CAMERA)
    assert np.isnan(pixels[4]).all()
    np.testing.assert_allclose(pixels[8], CAMERA.project(points[8]))
    assert np.isnan(label_pixels(without, None)).all()


ENTRIES = [
    Entry(name, Path(name), lambda: Labels((), None), clip)
    for name, clip in (("a", None), ("b", None), ("c", None), ("x1", "x"), ("x2", "x"), ("y1", "y"))
]


@pytest.mark.parametrize(
    ("every", "clips", "expected"),
    [
        (1, True, [["a"], ["b"], ["c"], ["x1", "x2"], ["y1"]]),
        (2, True, [["a"], ["c"], ["x1", "x2"]]),
        (1, False, [["a"], ["b"], ["c"], ["x1"], ["x2"], ["y1"]]),
        (3, False, [["a"], ["x1"]]),
    ],
)
def test_stills_are_units_and_clips_stay_whole(every: int, clips: bool, expected: list[list[str]]) -> None:
    units = units_of(ENTRIES, clips=clips, every=every)
    assert [[e.name for e in unit.entries] for unit in units] == expected
    assert [unit.is_clip for unit in units] == [clips and len(u) > 0 and u[0][0] in "xy" for u in expected]
