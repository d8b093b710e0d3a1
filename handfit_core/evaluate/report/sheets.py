"""Picture sheets: the worst and the best hands with labels and predictions drawn over them, and misses."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from handfit_core.errors import InputError, OutputError
from handfit_core.evaluate.report.focus import error_metric, focus_of
from handfit_core.evaluate.report.numbers import with_unit
from handfit_core.evaluate.scores import Evaluation, Scores
from handfit_core.evaluate.summary import METRICS, hand_means
from handfit_core.files import written_whole
from handfit_core.media.opening import read_picture
from handfit_core.skeleton import KEYPOINT_PARENTS

CELLS = 12
"""Hands on a sheet at most"""

_COLUMNS = 4
_SIDE = 260
"""pixels of a cell's picture"""
_STRIP = 44
"""pixels of the caption below it"""
_GAP = 6
_LEGEND = 30
_MARGIN = 0.25
"""of the hand's size, on each side"""
_EDGE = 0.04
"""of the hand's size: the margin that is kept even where the picture ends"""
_SMALLEST_CROP = 24.0
"""pixels; a smaller crop shows pixels instead of a hand"""
_REACH = 1.0
"""of the label's size: how far a prediction may pull the crop away from the label"""
_APART_SECONDS = 0.5
"""Frames of a clip that are nearer than that look the same"""

_BACKGROUND = (34, 34, 34)
_NOTHING = (90, 90, 90)
_TEXT = (235, 235, 235)
_LABEL = (0, 230, 255)
_PREDICTION = (255, 40, 190)
_OUTLINE = (0, 0, 0)
"""RGB. Neither cyan nor magenta is a colour of skin"""


@dataclass(frozen=True)
class Shown:
    """One hand on a sheet."""

    sample: str
    hand: int
    text: str
    """Its error, or what is wrong"""


@dataclass(frozen=True)
class Sheet:
    """A sheet that was written."""

    file: str
    """Its name in the report's folder"""
    title: str
    caption: str
    width: int
    """pixels"""
    height: int
    """pixels"""
    hands: tuple[Shown, ...]


def write_sheets(folder: Path, evaluation: Evaluation, focus: str | None = None) -> list[Sheet]:
    """Write `worst.jpg`, `best.jpg` and `missed.jpg`, each where there is a hand to show.

    focus: the method whose predictions are shown; the last by default. A picture that cannot be read
    again leaves a grey cell. Raises OutputError and OptionError.
    """
    scores = focus_of(evaluation, focus)
    if scores is None:
        return []
    metric = METRICS[error_metric(evaluation)]
    errors = hand_means(scores, metric.key)
    worst_first = [int(row) for row in np.argsort(-errors, kind="stable") if not np.isnan(errors[row])]
    worst = _spread(scores, worst_first, min(CELLS, math.ceil(len(worst_first) / 2)))
    rest = [row for row in reversed(worst_first) if row not in worst]
    best = _spread(scores, rest, min(CELLS, len(worst_first) // 2))
    missed = _evenly(np.flatnonzero(~scores.detected), CELLS)
    text = {row: f"{metric.title} {with_unit(errors[row], metric)}" for row in worst_first}
    text |= dict.fromkeys(missed, "not detected")
    by = f"by {metric.title} of {scores.method}"
    few = f"of {int((~scores.detected).sum())}" if len(missed) < (~scores.detected).sum() else "all"
    sheets = (
        ("worst.jpg", "Worst hands", f"The {len(worst)} worst hands {by}.", worst),
        ("best.jpg", "Best hands", f"The {len(best)} best hands {by}.", best),
        ("missed.jpg", "Missed hands", f"Hands that were not detected ({len(missed)}, {few}).", missed),
    )
    written = []
    for file, title, caption, rows in sheets:
        if rows:
            rgb = _sheet(scores, rows, text)
            _save(folder / file, rgb)
            hands = tuple(Shown(scores.samples[r], int(scores.hands[r]), text[r]) for r in rows)
            written.append(Sheet(file, title, caption, rgb.shape[1], rgb.shape[0], hands))
    return written


def _spread(scores: Scores, ranked: Sequence[int], wanted: int) -> list[int]:
    """The first rows of a ranking, frames of one clip half a second apart as long as others remain."""
    chosen: list[int] = []
    skipped: list[int] = []
    for row in ranked:
        if len(chosen) == wanted:
            break
        twins = (
            scores.clips[row] is not None
            and scores.clips[row] == scores.clips[other]
            and scores.hands[row] == scores.hands[other]
            and abs(scores.times[row] - scores.times[other]) < _APART_SECONDS
            for other in chosen
        )
        (skipped if any(twins) else chosen).append(row)
    chosen += skipped[: wanted - len(chosen)]
    return sorted(chosen, key=ranked.index)


def _evenly(rows: np.ndarray, count: int) -> list[int]:
    """Up to `count` of the rows, from all over the set."""
    if len(rows) <= count:
        return [int(row) for row in rows]
    return [int(rows[i]) for i in np.linspace(0, len(rows) - 1, count).round().astype(int)]


def _save(path: Path, rgb: np.ndarray) -> None:
    import cv2

    done, data = cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])
    if not done:
        raise OutputError(f"{path}: OpenCV could not write this JPEG; install opencv-python-headless again")
    with written_whole(path) as beside:
        beside.write_bytes(data.tobytes())


def _sheet(scores: Scores, rows: Sequence[int], text: dict[int, str]) -> np.ndarray:
    """(H, W, 3) uint8 RGB: a legend above a grid of cells."""
    columns = min(_COLUMNS, len(rows))
    lines = math.ceil(len(rows) / columns)
    height, width = _SIDE + _STRIP, _SIDE
    sheet = np.empty(
        (_LEGEND + lines * (height + _GAP) + _GAP, columns * (width + _GAP) + _GAP, 3), dtype=np.uint8
    )
    sheet[:] = _BACKGROUND
    _draw_legend(sheet[:_LEGEND], scores.method if scores.detected[list(rows)].any() else "")
    for i, row in enumerate(rows):
        y = _LEGEND + _GAP + (i // columns) * (height + _GAP)
        x = _GAP + (i % columns) * (width + _GAP)
        sheet[y : y + height, x : x + width] = _cell(scores, row, text[row])
    return sheet


def _cell(scores: Scores, row: int, text: str) -> np.ndarray:
    """(_SIDE + _STRIP, _SIDE, 3) uint8 RGB: the hand, its name and its error."""
    cell = np.empty((_SIDE + _STRIP, _SIDE, 3), dtype=np.uint8)
    cell[:] = _BACKGROUND
    label, prediction = scores.labels_2d[row], scores.points_2d[row]
    try:
        picture, _ = read_picture(scores.pictures[row], as_stored=True)
    except InputError:
        cell[:_SIDE] = _NOTHING
        _write(cell[:_SIDE], "picture cannot be read", 12, _SIDE // 2)
    else:
        x, y, side = crop_box(label, prediction, picture.shape[1], picture.shape[0])
        cell[:_SIDE] = _cropped(picture, x, y, side)
        scale = _SIDE / side
        view = np.ascontiguousarray(cell[:_SIDE])
        _draw_hand(view, (label - [x, y]) * scale, _LABEL)
        _draw_hand(view, (prediction - [x, y]) * scale, _PREDICTION)
        cell[:_SIDE] = view
    several = f" #{int(scores.hands[row]) + 1}" if _has_several(scores, row) else ""
    _write(cell, scores.samples[row] + several, 6, _SIDE + 17)
    _write(cell, text, 6, _SIDE + 36)
    return cell


def _has_several(scores: Scores, row: int) -> bool:
    """Whether the row's picture has other labelled hands, which stand beside it."""
    return any(
        0 <= other < len(scores.samples) and scores.samples[other] == scores.samples[row]
        for other in (row - 1, row + 1)
    )


def crop_box(label: np.ndarray, prediction: np.ndarray, width: int, height: int) -> tuple[int, int, int]:
    """The square around a hand: left and top edge and side in pixels, perhaps beyond the picture.

    label and prediction: (21, 2) pixels, NaN where there is none. It holds the labelled points and the
    predicted ones, but those no further than one size of the label away from it: a lost prediction must
    not make the hand a dot. Without any point, the whole picture.
    """
    boxes = [box for points in (label, prediction) if (box := _box(points)) is not None]
    if not boxes:
        side = max(width, height)
        return (width - side) // 2, (height - side) // 2, side
    low, high = boxes[0]
    if len(boxes) == 2:
        reach = _REACH * max(*(high - low), _SMALLEST_CROP)
        wider_low = np.minimum(low, np.maximum(boxes[1][0], low - reach))
        wider_high = np.maximum(high, np.minimum(boxes[1][1], high + reach))
        low, high = wider_low, wider_high
    # A label far outside of its picture is damaged; memory is not spent on it.
    size = np.array([width, height], dtype=np.float64)
    low, high = np.clip(low, -size, 2 * size), np.clip(high, -size, 2 * size)
    edge = _EDGE * float((high - low).max())
    content = max(float((high - low).max()) + 2.0 * edge, _SMALLEST_CROP)
    # The margin is there to show more of the picture, not what lies beyond it.
    side = math.ceil(max(content, min((1.0 + 2.0 * _MARGIN) * content, float(size.max()))))
    corner = (low + high - side) / 2.0
    corner = np.where(side <= size, np.clip(corner, 0.0, np.maximum(size - side, 0.0)), (size - side) / 2.0)
    corner = np.clip(corner, high + edge - side, low - edge)
    return math.floor(corner[0]), math.floor(corner[1]), side


def _box(points: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    known = points[np.isfinite(points).all(axis=-1)]
    return (known.min(axis=0), known.max(axis=0)) if len(known) else None


def _cropped(picture: np.ndarray, x: int, y: int, side: int) -> np.ndarray:
    """(_SIDE, _SIDE, 3) of the square at (x, y); grey beyond the picture."""
    import cv2

    height, width = picture.shape[:2]
    square = np.empty((side, side, 3), dtype=np.uint8)
    square[:] = _NOTHING
    left, top, right, bottom = max(x, 0), max(y, 0), min(x + side, width), min(y + side, height)
    if left < right and top < bottom:
        square[top - y : bottom - y, left - x : right - x] = picture[top:bottom, left:right]
    way = cv2.INTER_AREA if side > _SIDE else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(square, (_SIDE, _SIDE), interpolation=way))


def _draw_hand(picture: np.ndarray, points: np.ndarray, colour: tuple[int, int, int]) -> None:
    """Draw (21, 2) points, in pixels of the picture, and the bones between neighbours that are known."""
    import cv2

    known = np.asarray(np.isfinite(points).all(axis=-1))
    # Far outside of the cell nothing is seen, and OpenCV's fixed point would overflow.
    known[known] = (np.abs(points[known]) < 20 * _SIDE).all(axis=-1)
    bones = [(i, p) for i, p in enumerate(KEYPOINT_PARENTS) if p >= 0 and known[i] and known[p]]
    for thickness, tone in ((3, _OUTLINE), (2, colour)):
        for i, parent in bones:
            cv2.line(
                picture, _fixed(points[i]), _fixed(points[parent]), tone, thickness, cv2.LINE_AA, _FRACTION
            )
    for i in np.flatnonzero(known):
        for radius, tone in ((3.5, _OUTLINE), (2.5, colour)):
            size = round(radius * 2**_FRACTION)
            cv2.circle(picture, _fixed(points[i]), size, tone, cv2.FILLED, cv2.LINE_AA, _FRACTION)


_FRACTION = 4
"""Bits of a pixel that OpenCV's drawing gets"""


def _fixed(point: np.ndarray) -> tuple[int, int]:
    """A point in fixed numbers; OpenCV's whole numbers are pixel centres, which are at .5 here."""
    x, y = np.round((point - 0.5) * 2**_FRACTION).astype(int)
    return int(x), int(y)


_FONT_SCALE = 0.45


def _write(picture: np.ndarray, text: str, x: int, y: int, colour: Iterable[int] = _TEXT) -> None:
    """Write a line whose baseline begins at (x, y), its beginning left out where it is too long.

    OpenCV's fonts are ASCII only; the page has the full name.
    """
    import cv2

    text = text.encode("ascii", "replace").decode()
    room = picture.shape[1] - x - 4
    shown = text
    while len(text) > 1 and _text_width(shown) > room:
        text = text[1:]
        shown = ".." + text
    area = np.ascontiguousarray(picture)
    tone = tuple(int(c) for c in colour)
    cv2.putText(area, shown, (x, y), cv2.FONT_HERSHEY_SIMPLEX, _FONT_SCALE, tone, 1, cv2.LINE_AA)
    picture[:] = area


def _text_width(text: str) -> int:
    import cv2

    return cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, _FONT_SCALE, 1)[0][0]


def _draw_legend(strip: np.ndarray, method: str) -> None:
    x = _GAP + 2
    baseline = _LEGEND - 9
    _write(strip, "label", x, baseline, _LABEL)
    _write(strip, method, x + _text_width("label") + 18, baseline, _PREDICTION)
