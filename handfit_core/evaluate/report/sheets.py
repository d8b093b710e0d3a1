"""Picture sheets: the worst and the best hands with labels and predictions drawn over them, and misses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

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


@dataclass(frozen=True)
class SheetLayout:
    """Sizes and colours of a sheet."""

    cells: int = 12
    """Hands on a sheet at most"""
    columns: int = 4
    cell: int = 260
    """pixels of a hand's picture"""
    caption: int = 40
    """pixels above it"""
    legend: int = 30
    """pixels above all"""
    gap: int = 6
    """pixels between cells"""
    dpi: float = 100.0
    min_crop: float = 24.0
    """pixels; a smaller crop shows pixels instead of a hand"""
    name_letters: int = 37
    """letters that a caption has room for"""
    label: str = "#00e6ff"
    prediction: str = "#ff28be"
    """Neither cyan nor magenta is a colour of skin"""
    nothing: str = "#5a5a5a"
    """What is beyond the picture"""


LAYOUT: Final = SheetLayout()


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
    metric = error_metric(evaluation)
    errors = hand_means(scores, metric.key)
    worst_first = np.argsort(-errors, kind="stable")[: np.isfinite(errors).sum()].tolist()
    worst = _spread(scores, worst_first, min(LAYOUT.cells, math.ceil(len(worst_first) / 2)))
    rest = [row for row in reversed(worst_first) if row not in worst]
    best = _spread(scores, rest, min(LAYOUT.cells, len(worst_first) // 2))
    all_missed = np.flatnonzero(~scores.detected)
    from_all_over = np.linspace(0, len(all_missed) - 1, min(LAYOUT.cells, len(all_missed)))
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
            hands = tuple(Shown(scores.samples[r], int(scores.hands[r]), text[r]) for r in rows)
            figure = _sheet(scores, rows, hands)
            with written_whole(folder / file) as beside:
                figure.savefig(beside, format="jpg", dpi=LAYOUT.dpi, pil_kwargs={"quality": 90})
            width, height = figure.canvas.get_width_height()
            written.append(Sheet(file, title, caption, width, height, hands))
    return written


def _spread(scores: Scores, ranked: Sequence[int], wanted: int) -> list[int]:
    """The first rows of a ranking, frames of one clip half a second apart as long as others remain."""

    def are_twins(a: int, b: int) -> bool:
        same = (scores.clips[a], scores.hands[a]) == (scores.clips[b], scores.hands[b])
        # Frames of a clip that are nearer than that look the same
        apart = abs(scores.times[a] - scores.times[b]) >= 0.5
        return same and scores.clips[a] is not None and not apart

    chosen: list[int] = []
    for row in ranked:
        if len(chosen) < wanted and not any(are_twins(row, other) for other in chosen):
            chosen.append(row)
    chosen += [row for row in ranked if row not in chosen][: wanted - len(chosen)]
    return sorted(chosen, key=ranked.index)


def _sheet(scores: Scores, rows: Sequence[int], hands: Sequence[Shown]) -> Figure:
    """A legend above a grid of cells."""
    cell, gap, above = LAYOUT.cell, LAYOUT.gap, LAYOUT.caption
    columns = min(LAYOUT.columns, len(rows))
    width = columns * (cell + gap) + gap
    height = math.ceil(len(rows) / columns) * (cell + above + gap) + LAYOUT.legend
    figure = Figure(figsize=(width / LAYOUT.dpi, height / LAYOUT.dpi), dpi=LAYOUT.dpi, facecolor="#222222")
    for i, (row, hand) in enumerate(zip(rows, hands, strict=True)):
        x = gap + i % columns * (cell + gap)
        y = height - LAYOUT.legend - (i // columns + 1) * (cell + above + gap) + gap
        box = (x / width, y / height, cell / width, cell / height)
        axes = figure.add_axes(box, facecolor=LAYOUT.nothing, xticks=[], yticks=[])
        _draw(axes, scores, row)
        several = f" (hand {hand.hand + 1})" if scores.samples.count(hand.sample) > 1 else ""
        # The font has Latin letters only; the page has the whole name.
        name = (hand.sample + several).encode("ascii", "replace").decode()
        name = name if len(name) <= LAYOUT.name_letters else f"..{name[2 - LAYOUT.name_letters :]}"
        font = {"fontsize": 8, "family": "monospace", "color": "white"}
        axes.set_title(f"{name}\n{hand.text}", loc="left", pad=3, parse_math=False, **font)
    place = {"y": 1.0 - LAYOUT.legend / 2 / height, "va": "center", "fontsize": 9}
    figure.text(gap / width, s="label", color=LAYOUT.label, **place)
    if scores.detected[list(rows)].any():
        figure.text((gap + 45) / width, s=scores.method, color=LAYOUT.prediction, **place)
    return figure


def _draw(axes: Axes, scores: Scores, row: int) -> None:
    """One hand in its picture, label and prediction over it; grey where there is no picture."""
    try:
        picture, _ = read_picture(scores.pictures[row], as_stored=True)
    except InputError:
        axes.text(0.5, 0.5, "picture cannot be read", transform=axes.transAxes, ha="center", color="white")
        return
    height, width = picture.shape[:2]
    label, prediction = scores.labels_2d[row], scores.points_2d[row]
    x, y, side = crop_box(label, prediction, width, height)
    # Pixel centres are at .5.
    axes.imshow(picture, extent=(0, width, height, 0), aspect="auto")
    for points, colour in ((label, LAYOUT.label), (prediction, LAYOUT.prediction)):
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
        reach = max(*(high - low), LAYOUT.min_crop)
        seen = np.clip(known[1], low - reach, high + reach)
        low, high = np.minimum(low, seen.min(axis=0)), np.maximum(high, seen.max(axis=0))
    extent = float((high - low).max())
    # In parts of the hand's size: the margin that is kept even where the picture ends
    edge = 0.04 * extent
    content = max(extent + 2.0 * edge, LAYOUT.min_crop)
    # The margin is there to show more of the picture, not what lies beyond it.
    side = max(content, min((1.0 + 2.0 * 0.25) * content, float(size.max())))
    corner = (low + high - side) / 2.0
    corner = np.where(side <= size, np.clip(corner, 0.0, np.maximum(size - side, 0.0)), (size - side) / 2.0)
    x, y = np.clip(corner, high + edge - side, low - edge)
    return float(x), float(y), side
