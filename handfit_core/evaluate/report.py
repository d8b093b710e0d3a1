"""The report of an evaluation: a page that opens offline, and its tables as CSV."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from jinja2 import Environment, StrictUndefined

from handfit_core.common.files import written_whole
from handfit_core.evaluate.scores import Comparison, Evaluation
from handfit_core.evaluate.summary import METRICS, hands_table

MOST_VALUES = 20
"""The most values of a tag by which results are grouped: one with more is a name or a number, not a group"""


def write_report(folder: Path, evaluation: Evaluation) -> list[Path]:
    """Write `index.html` and its tables into a folder, each file whole; returns them, the page first. Raises
    OutputError where the folder cannot be written."""
    tables = {
        "table.csv": main_table(evaluation),
        "comparisons.csv": pd.DataFrame(evaluation.comparisons, columns=list(Comparison._fields)),
        "by_tag.csv": tag_table(evaluation),
        "per_hand.csv": pd.concat([hands_table(scores) for scores in evaluation.scores]),
        "problems.csv": pd.DataFrame(
            [(kind, where) for kind, places in evaluation.problems.items() for where in places],
            columns=["kind", "where"],
        ),
    }
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    page = environment.from_string(Path(__file__).with_suffix(".html.j2").read_text(encoding="utf-8"))
    texts = {name: as_text(tables[f"{name}.csv"]) for name in ("table", "comparisons", "by_tag")}
    with pd.option_context("display.max_colwidth", None):
        form = {"index": False, "border": 0, "float_format": "{:.2f}".format}
        shown = {name: table.to_html(**form) for name, table in texts.items()}
    metrics = [METRICS[key] for key in tables["table.csv"].columns[1:]]
    files = {"index.html": page.render(evaluation=evaluation, files=list(tables), metrics=metrics, **shown)}
    files |= {name: table.to_csv(index=False, lineterminator="\r\n") for name, table in tables.items()}
    for name, text in files.items():
        with written_whole(folder / name) as beside:
            beside.write_text(text, encoding="utf-8", newline="")
    return [folder / name for name in files]


def main_table(evaluation: Evaluation) -> pd.DataFrame:
    """Make a table with a row for each method and a column for each metric that some method has a value
    of."""
    known = evaluation.summaries.dropna(axis="columns", how="all")
    return known.rename_axis("method").reset_index()


def tag_table(evaluation: Evaluation) -> pd.DataFrame:
    """Make a table of each method's hands, detection rate and mean errors by every tag of the set with 2 to
    MOST_VALUES values. Errors are averaged over the detected hands of a group."""
    hands = pd.concat([hands_table(scores) for scores in evaluation.scores if not scores.is_baseline])
    hands["detection_rate"] = 100.0 * hands["detected"]
    groups = [pd.DataFrame(columns=["tag", "value", "method", "hands", "detection_rate", "epe", "pa_mpjpe"])]
    for tag in hands.columns[hands.columns.str.startswith("tag_")]:
        values = hands[tag].fillna("not said").rename("value")
        if 2 <= values.nunique() <= MOST_VALUES:
            group = hands.groupby([values, "method"])[["detection_rate", "epe", "pa_mpjpe"]].mean()
            group.insert(0, "hands", hands.groupby([values, "method"]).size())
            group = group.reset_index()
            group.insert(0, "tag", tag.removeprefix("tag_"))
            groups.append(group)
    return pd.concat(groups[1:] or groups, ignore_index=True)


def as_text(table: pd.DataFrame) -> pd.DataFrame:
    """Return the table with the titles of its metrics and as many digits as they are worth; a dash for no
    number."""
    texts = {}
    for name, column in table.items():
        metric = METRICS.get(str(name))
        texts[metric.title if metric else name] = (
            column if metric is None else column.map(f"{{:.{metric.digits}f}}".format).replace("nan", "-")
        )
    return pd.DataFrame(texts)
