"""The report of an evaluation: tables, plots and picture sheets in a folder, with a page that shows them."""

from __future__ import annotations

import contextlib
import json
import logging
from pathlib import Path

from handfit_core.evaluate.report.focus import focus_of
from handfit_core.evaluate.report.groups import group_table
from handfit_core.evaluate.report.layout import markdown
from handfit_core.evaluate.report.page import headline, write_page
from handfit_core.evaluate.report.plots import INSTALL_HINT, Plot, can_plot, write_plots
from handfit_core.evaluate.report.sheets import write_sheets
from handfit_core.evaluate.report.tables import markdown_table, write_csv, write_hands_csv, write_table_csv
from handfit_core.evaluate.report.verdicts import write_comparisons_csv
from handfit_core.evaluate.scores import Evaluation
from handfit_core.files import written_whole

log = logging.getLogger("handfit")

REPORT_FILES = (
    *("index.html", "table.md", "table.csv", "per_hand.csv", "comparisons.csv", "by_tag.md", "problems.csv"),
    *("setup.json", "pck.svg", "pck_published.svg", "pck_pa.svg", "per_joint.svg", "per_view.svg"),
    *("worst.jpg", "best.jpg", "missed.jpg"),
)
"""Every name that a report may use. Those that one does not need are removed, so that none is from before"""


def write_report(folder: Path, evaluation: Evaluation, *, focus: str | None = None) -> list[Path]:
    """Write the report into a folder and return its files, `index.html` first.

    focus: the method whose hands the picture sheets show; the last one by default. Without matplotlib
    there are no plots; the page and a warning say so. Each file is written whole, and REPORT_FILES that
    an earlier report left are replaced or removed; other files of the folder stay.

    Raises OptionError where `focus` is not among the methods, OutputError where the folder cannot be
    written.
    """
    focus_of(evaluation, focus)  # before anything is written
    files = [
        _write(
            folder / "table.md",
            f"# {evaluation.dataset}, {evaluation.protocol} protocol\n\n"
            f"{headline(evaluation)}\n\n{markdown_table(evaluation)}",
        ),
        write_table_csv(folder / "table.csv", evaluation),
        write_hands_csv(folder / "per_hand.csv", evaluation),
        _write_setup(folder / "setup.json", evaluation),
    ]
    if evaluation.comparisons:
        files.append(write_comparisons_csv(folder / "comparisons.csv", evaluation))
    if groups := group_table(evaluation):
        files.append(_write(folder / "by_tag.md", markdown(groups)))
    if evaluation.problems:
        rows = ((kind, where) for kind, places in evaluation.problems.items() for where in places)
        files.append(write_csv(folder / "problems.csv", ("kind", "where"), rows))
    numbers = [path.name for path in files]

    plots: list[Plot] = []
    if possible := can_plot():
        plots = write_plots(folder, evaluation, focus)
    else:
        log.warning("the report has no plots. %s", INSTALL_HINT)
    sheets = write_sheets(folder, evaluation, focus)
    files += [folder / made.file for made in (*plots, *sheets)]
    page = write_page(
        folder / "index.html", evaluation, plots, sheets, numbers, focus=focus, plots_are_possible=possible
    )
    files = [page, *files]
    for name in set(REPORT_FILES) - {path.name for path in files}:
        with contextlib.suppress(OSError):
            (folder / name).unlink(missing_ok=True)
    return files


def _write_setup(path: Path, evaluation: Evaluation) -> Path:
    setup = {
        "dataset": evaluation.dataset,
        "kind": evaluation.kind,
        "root": str(evaluation.root),
        "protocol": evaluation.protocol,
        "pictures": evaluation.pictures,
        "labelled_hands": evaluation.labelled_hands,
        "extra_hands": evaluation.extra_hands,
        "notes": list(evaluation.notes),
        "setup": dict(evaluation.setup),
    }
    return _write(path, json.dumps(setup, indent=2, ensure_ascii=False) + "\n")


def _write(path: Path, text: str) -> Path:
    with written_whole(path) as beside:
        beside.write_text(text, encoding="utf-8")
    return path


__all__ = ["REPORT_FILES", "write_report"]
