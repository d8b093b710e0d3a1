"""Picture sheets: the worst and the best hands with labels and predictions drawn over them, and misses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from handfit_core.errors import InputError
from handfit_core.evaluate.report.tables import error_metric, focus_of, text_of
from handfit_core.evaluate.scores import Evaluation, Scores
from handfit_core.evaluate.summary import hand_means
from handfit_core.files import written_whole
from handfit_core.media.pictures import read_picture
from handfit_core.skeleton import KEYPOINT_PARENTS

CELLS: Final = 12
"""Hands on a sheet at most"""
COLUMNS: Final = 4
CELL: Final = 260
"""Pixels of a hand's picture, below a caption of CAPTION pixels, GAP pixels from the next"""
CAPTION: Final = 40
GAP: Final = 6
LEGEND: Final = 30
"""Pixels above all"""
DPI: Final = 100.0
MIN_CROP: Final = 24.0
"""Pixels; a smaller crop shows pixels instead of a hand"""
NAME_LETTERS: Final = 37
"""Letters that a caption has room for"""
LABEL: Final = "#00e6ff"
PREDICTION: Final = "#ff28be"
"""Neither cyan nor magenta is a colour of skin"""
NOTHING: Final = "#5a5a5a"
"""What is beyond the picture"""


class Sheet(NamedTuple):
    """A sheet that was written."""

    file: str
    """Its name in the report's folder"""
    title: str
    caption: str
    width: int
    """pixels"""
    height: int
    """pixels"""
    hands: list[tuple[str, int, str]]
    """Picture, number of the hand in it, and its error, or what is wrong"""


def write_sheets(folder: Path, evaluation: Evaluation) -> list[Sheet]:
    """Write `worst.jpg`, `best.jpg` and `missed.jpg`, each where there is a hand to show.

    The last method's predictions are shown. A picture that cannot be read again leaves a grey cell. Raises
    OutputError.
    """
    scores = focus_of(evaluation)
    if scores is None:
        return []
    metric = error_metric(evaluation)
    errors = hand_means(scores, metric.key)
    worst_first = np.argsort(-errors, kind="stable")[: np.isfinite(errors).sum()].tolist()
    worst = _spread(scores, worst_first, min(CELLS, math.ceil(len(worst_first) / 2)))
    rest = [row for row in reversed(worst_first) if row not in worst]
    best = _spread(scores, rest, min(CELLS, len(worst_first) // 2))
    all_missed = np.flatnonzero(~scores.detected)
    from_all_over = np.linspace(0, len(all_missed) - 1, min(CELLS, len(all_missed)))
    missed = all_missed[from_all_over.round().astype(int)].tolist()
    text = {
        row: f"{metric.title} {text_of(float(errors[row]), metric, with_unit=True)}" for row in worst_first
    }
    text |= dict.fromkeys(missed, "not detected")
    by = f"by {metric.title} of {scores.method}"
    few = f"of {len(all_missed)}" if len(missed) < len(all_missed) else "all"
    written = []
    for file, title, caption, rows in (
        ("worst.jpg", "Worst hands", f"The {len(worst)} worst hands {by}.", worst),
        ("best.jpg", "Best hands", f"The {len(best)} best hands {by}.", best),
        ("missed.jpg", "Missed hands", f"Hands that were not detected ({len(missed)}, {few}).", missed),
    ):
        if rows:
            which = scores.hands.loc[rows]
            hands = [*zip(which["sample"], which["hand"], (text[r] for r in rows), strict=True)]
            figure = _sheet(scores, rows, hands)
            with written_whole(folder / file) as beside:
                figure.savefig(beside, format="jpg", dpi=DPI, pil_kwargs={"quality": 90})
            width, height = figure.canvas.get_width_height()
            written.append(Sheet(file, title, caption, width, height, hands))
    return written


def _spread(scores: Scores, ranked: Sequence[int], wanted: int) -> list[int]:
    """The first rows of a ranking, one of each half second of a clip as long as others remain."""
    hands = scores.hands.loc[list(ranked)]
    # Frames of a clip that are nearer than that look the same.
    moments = hands.assign(clip=hands["clip"].fillna(hands["sample"]), time=hands["time"] // 0.5)
    twins = moments.duplicated(["clip", "hand", "time"])
    chosen = twins.sort_values(kind="stable").index[:wanted]
    return [row for row in ranked if row in chosen]


def _sheet(scores: Scores, rows: Sequence[int], hands: Sequence[tuple[str, int, str]]) -> Figure:
    """A legend above a grid of cells."""
    columns = min(COLUMNS, len(rows))
    width = columns * (CELL + GAP) + GAP
    height = math.ceil(len(rows) / columns) * (CELL + CAPTION + GAP) + LEGEND
    figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI, facecolor="#222222")
    for i, (row, (sample, hand, text)) in enumerate(zip(rows, hands, strict=True)):
        x = GAP + i % columns * (CELL + GAP)
        y = height - LEGEND - (i // columns + 1) * (CELL + CAPTION + GAP) + GAP
        box = (x / width, y / height, CELL / width, CELL / height)
        axes = figure.add_axes(box, facecolor=NOTHING, xticks=[], yticks=[])
        _draw(axes, scores, row)
        several = f" (hand {hand + 1})" if (scores.hands["sample"] == sample).sum() > 1 else ""
        # The font has Latin letters only; the page has the whole name.
        name = (sample + several).encode("ascii", "replace").decode()
        name = name if len(name) <= NAME_LETTERS else f"..{name[2 - NAME_LETTERS :]}"
        font = {"fontsize": 8, "family": "monospace", "color": "white"}
        axes.set_title(f"{name}\n{text}", loc="left", pad=3, parse_math=False, **font)
    place = {"y": 1.0 - LEGEND / 2 / height, "va": "center", "fontsize": 9}
    figure.text(GAP / width, s="label", color=LABEL, **place)
    if scores.detected[list(rows)].any():
        figure.text((GAP + 45) / width, s=scores.method, color=PREDICTION, **place)
    return figure


def _draw(axes: Axes, scores: Scores, row: int) -> None:
    """One hand in its picture, label and prediction over it; grey where there is no picture."""
    try:
        picture, _ = read_picture(scores.hands["picture"][row], as_stored=True)
    except InputError:
        axes.text(0.5, 0.5, "picture cannot be read", transform=axes.transAxes, ha="center", color="white")
        return
    height, width = picture.shape[:2]
    label, prediction = scores.labels_2d[row], scores.points_2d[row]
    x, y, side = crop_box(label, prediction, width, height)
    # Pixel centres are at .5.
    axes.imshow(picture, extent=(0, width, height, 0), aspect="auto")
    for points, colour in ((label, LABEL), (prediction, PREDICTION)):
        # Far outside of the cell nothing is seen, and drawing there would overflow.
        near = (np.abs(points - (x, y)) < 20 * side).all(axis=-1, keepdims=True)
        points = np.where(near, points, np.nan)
        bones = [(points[i], points[parent], (np.nan, np.nan)) for i, parent in enumerate(KEYPOINT_PARENTS)]
        line = np.array(bones[1:]).reshape(-1, 2)
        outline = [withStroke(linewidth=2.2, foreground="black")]
        axes.plot(*line.T, "o-", color=colour, linewidth=1.4, markersize=3, path_effects=outline)
    axes.set(xlim=(x, x + side), ylim=(y + side, y))


def crop_box(
    label: np.ndarray, prediction: np.ndarray, width: int, height: int
) -> tuple[float, float, float]:
    """The square around a hand: left and top edge and side in pixels, perhaps beyond the picture.

    label and prediction: (21, 2) pixels, NaN where there is none. It holds the labelled points and the
    predicted ones, but those no further than one size of the label away from it: a lost prediction must
    not make the hand a dot. Without any point, the whole picture.
    """
    size = np.array([width, height], dtype=np.float64)
    known = [p for points in (label, prediction) if len(p := points[np.isfinite(points).all(axis=-1)])]
    if not known:
        known = [np.array([[0.0, 0.0], size])]
    low, high = known[0].min(axis=0), known[0].max(axis=0)
    if len(known) == 2:
        reach = max(*(high - low), MIN_CROP)
        seen = np.clip(known[1], low - reach, high + reach)
        low, high = np.minimum(low, seen.min(axis=0)), np.maximum(high, seen.max(axis=0))
    extent = float((high - low).max())
    # In parts of the hand's size: the margin that is kept even where the picture ends
    edge = 0.04 * extent
    content = max(extent + 2.0 * edge, MIN_CROP)
    # The margin is there to show more of the picture, not what lies beyond it.
    side = max(content, min((1.0 + 2.0 * 0.25) * content, float(size.max())))
    corner = (low + high - side) / 2.0
    corner = np.where(side <= size, np.clip(corner, 0.0, np.maximum(size - side, 0.0)), (size - side) / 2.0)
    x, y = np.clip(corner, high + edge - side, low - edge)
    return float(x), float(y), side
