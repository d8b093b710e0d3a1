"""The page that shows a whole evaluation: one HTML file beside its pictures, that opens offline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from handfit_core.evaluate.report.focus import best_method, error_metric, methods_of, value_of
from handfit_core.evaluate.report.groups import group_table
from handfit_core.evaluate.report.numbers import count, with_unit
from handfit_core.evaluate.report.plots import INSTALL_HINT, Plot
from handfit_core.evaluate.report.published import experiments_table, others_table, published_note
from handfit_core.evaluate.report.sheets import Sheet
from handfit_core.evaluate.report.tables import main_table
from handfit_core.evaluate.report.verdicts import comparison_tables
from handfit_core.evaluate.scores import Evaluation
from handfit_core.evaluate.summary import METRICS
from handfit_core.files import written_whole

EXAMPLES = 10
"""Examples of each kind of problem on the page; `problems.csv` has them all"""


@dataclass(frozen=True)
class _ProblemKind:
    kind: str
    count: int
    examples: tuple[str, ...]


def headline(evaluation: Evaluation) -> str:
    """Pictures, hands, how many of them were found, and the best method: one or two sentences."""
    methods = methods_of(evaluation)
    text = f"{count(evaluation.pictures, 'picture')}, {count(evaluation.labelled_hands, 'labelled hand')}"
    found = {f"{100.0 * s.detected.mean():.1f} %" for s in methods if len(s.detected)}
    if found:
        text += f", {' to '.join(sorted(found))} of them detected"
    metric = METRICS[error_metric(evaluation)]
    best = best_method(evaluation, metric.key)
    if best is None:
        return f"{text}. No method has an error to show."
    value = with_unit(value_of(evaluation, best.method, metric.key), metric)
    if len(methods) == 1:
        return f"{text}. {best.method} has {metric.title} {value}."
    return f"{text}. Best of {len(methods)} methods: {best.method}, {metric.title} {value}."


def write_page(
    path: Path,
    evaluation: Evaluation,
    plots: Sequence[Plot],
    sheets: Sequence[Sheet],
    files: Sequence[str],
    *,
    focus: str | None,
    plots_are_possible: bool,
) -> Path:
    """Write the page. `files` are the names of the report's other files, to link to.

    Raises OutputError.
    """
    from jinja2 import Environment, StrictUndefined

    source = (
        resources.files("handfit_core.evaluate.report").joinpath("page.html.j2").read_text(encoding="utf-8")
    )
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    by_file = {plot.file: plot for plot in plots}
    metric = METRICS[error_metric(evaluation)]
    text = environment.from_string(source).render(
        evaluation=evaluation,
        headline=headline(evaluation),
        problems=_problems(evaluation),
        problem_total=sum(map(len, evaluation.problems.values())),
        examples=EXAMPLES,
        main=main_table(evaluation),
        published=experiments_table(evaluation),
        others=others_table(evaluation, focus),
        published_note=published_note(evaluation),
        comparisons=comparison_tables(evaluation),
        groups=group_table(evaluation),
        group_error=f"{metric.title} in {metric.unit} ({metric.alignment})",
        pck=[by_file[f] for f in ("pck.svg", "pck_pa.svg") if f in by_file],
        pck_published=by_file.get("pck_published.svg"),
        breakdown=[by_file[f] for f in ("per_joint.svg", "per_view.svg") if f in by_file],
        no_joints=evaluation.protocol == "paper",
        plot_hint=None if plots_are_possible else INSTALL_HINT,
        sheets=sheets,
        files=files,
    )
    with written_whole(path) as beside:
        beside.write_text(text, encoding="utf-8")
    return path


def _problems(evaluation: Evaluation) -> list[_ProblemKind]:
    kinds = [_ProblemKind(kind, len(where), where[:EXAMPLES]) for kind, where in evaluation.problems.items()]
    return sorted(kinds, key=lambda kind: -kind.count)
