"""The report of an evaluation: tables, plots and picture sheets in a folder, with a page that shows them. A
line here draws and writes what was scored, and scores nothing."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path

import pandas as pd
from jinja2 import Environment, StrictUndefined

from handfit_core.common.files import written_whole
from handfit_core.evaluate.report import tables
from handfit_core.evaluate.report.plots import write_plots
from handfit_core.evaluate.report.sheets import Sheet, write_sheets
from handfit_core.evaluate.report.tables import (
    best_method,
    count,
    error_metric,
    group_table,
    main_table,
    methods_of,
    metrics_shown,
    numbers_of,
    text_of,
)
from handfit_core.evaluate.scores import Evaluation
from handfit_core.evaluate.summary import hands_table

REPORT_FILES = (
    *("index.html", "table.md", "table.csv", "per_hand.csv", "comparisons.csv", "by_tag.md", "problems.csv"),
    *("setup.json", "pck.svg", "pck_pa.svg", "per_joint.svg"),
    *("worst.jpg", "best.jpg", "missed.jpg"),
)
"""Every name that a report may use. Those that one does not need are removed, so that none is from before"""


def write_report(folder: Path, evaluation: Evaluation) -> list[Path]:
    """Write the report into a folder and return its files, `index.html` first.

    Each file is written whole, and REPORT_FILES that an earlier report left are replaced or removed; other
    files stay. Raises OutputError where the folder cannot be written.
    """
    about = f"# {evaluation.dataset}, {evaluation.protocol} protocol\n\n{headline(evaluation)}\n\n"
    files = {
        "table.md": about + main_table(evaluation).markdown(),
        "table.csv": _csv(_main_numbers(evaluation)),
        "per_hand.csv": _csv(pd.concat([hands_table(s) for s in evaluation.scores])),
        "setup.json": json.dumps(_setup(evaluation), indent=2, ensure_ascii=False) + "\n",
    }
    if evaluation.comparisons:
        compared = pd.DataFrame(evaluation.comparisons)
        compared["is_significant"] = [int(c.is_significant) for c in evaluation.comparisons]
        files["comparisons.csv"] = _csv(compared)
    if groups := group_table(evaluation):
        files["by_tag.md"] = groups.markdown()
    if evaluation.problems:
        places = pd.Series(evaluation.problems).explode()
        files["problems.csv"] = _csv(places.rename_axis("kind").reset_index(name="where"))
    numbers = list(files)

    plots = write_plots(folder, evaluation)
    sheets = write_sheets(folder, evaluation)
    files["index.html"] = _page(evaluation, numbers, plots, sheets)
    for name, text in files.items():
        with written_whole(folder / name) as beside:
            beside.write_text(text, encoding="utf-8", newline="")
    names = ["index.html", *numbers, *plots, *(sheet.file for sheet in sheets)]
    for name in set(REPORT_FILES) - set(names):
        with contextlib.suppress(OSError):
            (folder / name).unlink(missing_ok=True)
    return [folder / name for name in names]


def headline(evaluation: Evaluation) -> str:
    """Pictures, hands, how many of them were found, and the best method: one or two sentences."""
    methods, metric = methods_of(evaluation), error_metric(evaluation)
    text = f"{count(evaluation.pictures, 'picture')}, {count(evaluation.labelled_hands, 'labelled hand')}"
    found = {f"{100.0 * s.detected.mean():.1f} %" for s in methods if len(s.detected)}
    if found:
        text += f", {' to '.join(sorted(found))} of them detected"
    best = best_method(evaluation, metric)
    if best is None:
        return f"{text}. No method has an error to show."
    value = text_of(float(numbers_of(evaluation)[metric.key][best.method]), metric, with_unit=True)
    if len(methods) == 1:
        return f"{text}. {best.method} has {metric.title} {value}."
    return f"{text}. Best of {len(methods)} methods: {best.method}, {metric.title} {value}."


def _main_numbers(evaluation: Evaluation) -> pd.DataFrame:
    """The main table's numbers in full precision, in METRICS's units; empty where there is none."""
    about = {key: getattr(evaluation, key) for key in ("dataset", "kind", "protocol")}
    rows = [
        {**about, "method": s.method, "title": s.title, "is_baseline": int(s.is_baseline)}
        for s in evaluation.scores
    ]
    numbers = numbers_of(evaluation)[[metric.key for metric in metrics_shown(evaluation)]]
    return pd.DataFrame(rows).join(numbers.reset_index(drop=True))


def _csv(frame: pd.DataFrame) -> str:
    return frame.to_csv(index=False, lineterminator="\r\n")


def _setup(evaluation: Evaluation) -> dict[str, object]:
    plain = ("dataset", "kind", "protocol", "pictures", "labelled_hands", "extra_hands", "notes")
    setup = {key: getattr(evaluation, key) for key in plain}
    return {**setup, "root": str(evaluation.root), "setup": dict(evaluation.setup)}


def _page(
    evaluation: Evaluation, numbers: list[str], plots: dict[str, tuple[str, str]], sheets: list[Sheet]
) -> str:
    """One HTML file beside its pictures, that opens offline."""
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    by_number = sorted(evaluation.problems.items(), key=lambda problem: -len(problem[1]))
    environment.globals |= {**vars(tables), "headline": headline}
    page = environment.from_string(Path(__file__).with_name("page.html.j2").read_text(encoding="utf-8"))
    return page.render(evaluation=evaluation, problems=by_number, plots=plots, sheets=sheets, files=numbers)


__all__ = ["REPORT_FILES", "write_report"]
