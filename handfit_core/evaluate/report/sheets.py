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

from handfit_core.common.errors import InputError
from handfit_core.common.files import written_whole
from handfit_core.common.skeleton import KEYPOINT_PARENTS
from handfit_core.evaluate.report.tables import error_metric, focus_of, text_of
from handfit_core.evaluate.scores import Evaluation, Scores
from handfit_core.evaluate.summary import hand_means
from handfit_core.media.pictures import read_picture

CELLS: Final = 12
"""Hands on a sheet at most"""
COLUMNS: Final = 4
MARGIN: Final = 0.25
"""Of the hand's size, around it"""
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
    by = f"by {metric.title} of {scores.method}"
    few = f"of {len(all_missed)}" if len(missed) < len(all_missed) else "all"
    written = []
    for file, title, caption, rows in (
        ("worst.jpg", "Worst hands", f"The {len(worst)} worst hands {by}.", worst),
        ("best.jpg", "Best hands", f"The {len(best)} best hands {by}.", best),
        ("missed.jpg", "Missed hands", f"Hands that were not detected ({len(missed)}, {few}).", missed),
    ):
        texts = (f"{metric.title} {text_of(float(errors[row]), metric, with_unit=True)}" for row in rows)
        told = ["not detected"] * len(rows) if rows is missed else list(texts)
        which = scores.hands.loc[rows]
        if rows:
            hands = [*zip(which["sample"], which["hand"], told, strict=True)]
            with written_whole(folder / file) as beside:
                _sheet(scores, rows, hands).savefig(beside, format="jpg", pil_kwargs={"quality": 90})
            written.append(Sheet(file, title, caption, hands))
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
    columns = min(COLUMNS, len(rows))
    lines = math.ceil(len(rows) / columns)
    figure = Figure(figsize=(2.7 * columns, 3.1 * lines + 0.4), facecolor="#222222", layout="constrained")
    grid = figure.subplots(lines, columns, squeeze=False, subplot_kw={"xticks": [], "yticks": []})
    for axes in grid.flat[len(rows) :]:
        axes.set_axis_off()
    font = {"fontsize": 8, "family": "monospace", "color": "white", "parse_math": False}
    for axes, row, (sample, hand, text) in zip(grid.flat, rows, hands, strict=False):
        draw_hand(axes, scores, row)
        several = f" (hand {hand + 1})" if (scores.hands["sample"] == sample).sum() > 1 else ""
        # The font has Latin letters only; the page has the whole name.
        name = (sample + several).encode("ascii", "replace").decode()
        name = name if len(name) <= NAME_LETTERS else f"..{name[2 - NAME_LETTERS :]}"
        axes.set_title(f"{name}\n{text}", loc="left", **font)
    legend = "label: cyan" + (f", {scores.method}: magenta" if scores.detected[list(rows)].any() else "")
    figure.suptitle(legend, **font)
    return figure


def draw_hand(axes: Axes, scores: Scores, row: int) -> None:
    """One hand in its picture, label and prediction over it; grey where there is no picture."""
    axes.set_facecolor(NOTHING)
    axes.set_box_aspect(1.0)
    try:
        picture, _ = read_picture(scores.hands["picture"][row], as_stored=True)
    except InputError:
        axes.text(0.5, 0.5, "picture cannot be read", transform=axes.transAxes, ha="center", color="white")
        return
    height, width = picture.shape[:2]
    label, prediction = scores.labels_2d[row], scores.points_2d[row]
    low, high = crop_box(label, prediction, width, height)
    # Pixel centres are at .5.
    axes.imshow(picture, extent=(0, width, height, 0), aspect="auto")
    for points, colour in ((label, LABEL), (prediction, PREDICTION)):
        # Far outside of the cell nothing is seen, and drawing there would overflow.
        near = (np.abs(points - low) < 20 * (high - low)).all(axis=-1, keepdims=True)
        points = np.where(near, points, np.nan)
        bones = [(points[i], points[parent], (np.nan, np.nan)) for i, parent in enumerate(KEYPOINT_PARENTS)]
        line = np.array(bones[1:]).reshape(-1, 2)
        outline = [withStroke(linewidth=2.2, foreground="black")]
        axes.plot(*line.T, "o-", color=colour, linewidth=1.4, markersize=3, path_effects=outline)
    axes.set(xlim=(low[0], high[0]), ylim=(high[1], low[1]))


def crop_box(
    label: np.ndarray, prediction: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray]:
    """The square around a hand: its (2,) corners in pixels, perhaps beyond the picture.

    label and prediction: (21, 2) pixels, NaN where there is none. It holds the labelled points and the
    predicted ones, but those no further than one size of the label away from it: a lost prediction must
    not make the hand a dot. Without any point, the whole picture.
    """
    whole = np.array([[0.0, 0.0], [width, height]])
    known = [p for points in (label, prediction, whole) if len(p := points[np.isfinite(points).all(axis=-1)])]
    low, high = known[0].min(axis=0), known[0].max(axis=0)
    reach = max(*(high - low), 24.0)
    near = np.clip(known[1] if len(known) > 2 else known[0], low - reach, high + reach)
    low, high = np.minimum(low, near.min(axis=0)), np.maximum(high, near.max(axis=0))
    half = (0.5 + MARGIN) * max(*(high - low), 24.0)
    return (low + high) / 2 - half, (low + high) / 2 + half
