"""Published numbers on EgoDexter and Dexter+Object, to stand beside ours.

Source: "Monocular 3D Hand Pose Estimation with Implicit Camera Alignment", arXiv 2506.11133, its table
of experiments A-H and the results of others that it lists. Nobody ran them again here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from handfit_core.evaluate.report.focus import best_method, focus_of, methods_of, value_of
from handfit_core.evaluate.report.layout import Cell, Column, Table, name, words
from handfit_core.evaluate.report.numbers import text_of
from handfit_core.evaluate.scores import Evaluation, Scores
from handfit_core.evaluate.summary import METRICS

SOURCE: Final = "arXiv 2506.11133"


@dataclass(frozen=True)
class Experiment:
    """One row of the paper's table."""

    solver: str
    """Our name for it"""
    optimiser: str
    loss: str
    results: Mapping[str, tuple[float, float]]
    """kind of data set -> (EPE in mm, AUC of PCK 20-50 mm)"""


def _experiment(
    letter: str, optimiser: str, loss: str, egodexter: tuple[float, float], dexter: tuple[float, float]
) -> Experiment:
    return Experiment(f"paper-{letter}", optimiser, loss, {"egodexter": egodexter, "dexter-object": dexter})


EXPERIMENTS: Final = (
    _experiment("a", "L-BFGS", "MSE + tips", (17.724, 0.883), (13.985, 0.946)),
    _experiment("b", "L-BFGS", "MSE", (19.642, 0.859), (14.859, 0.943)),
    _experiment("c", "L-BFGS", "Geman-McClure + tips", (17.729, 0.883), (13.980, 0.946)),
    _experiment("d", "L-BFGS", "Geman-McClure", (19.648, 0.859), (14.878, 0.942)),
    _experiment("e", "L-BFGS", "Huber + tips", (17.864, 0.882), (13.978, 0.946)),
    _experiment("f", "L-BFGS", "Huber", (19.963, 0.855), (15.279, 0.939)),
    _experiment("g", "BFGS", "MSE + tips", (17.787, 0.883), (13.975, 0.946)),
    _experiment("h", "L-BFGS", "MSE, then anatomical + 2D MSE", (42.833, 0.492), (24.574, 0.784)),
)
"""The paper's experiments A-H"""

OTHERS_AUC: Final[Mapping[str, Mapping[str, float]]] = {
    "dexter-object": {
        "Zhou 2020": 0.948,
        "DetNet+BMC (other alignment)": 0.948,
        "DetNet+LM+AIK (other alignment)": 0.940,
        "Xiang": 0.912,
        "Zhang": 0.825,
        "Drosakis": 0.764,
        "Boukhayma": 0.763,
        "Iqbal": 0.672,
        "Baek": 0.650,
        "Zimmermann": 0.573,
        "Spurr": 0.511,
        "Mueller": 0.482,
    },
    "egodexter": {
        "DetNet+LM+AIK (other alignment)": 0.937,
        "DetNet+BMC (other alignment)": 0.918,
        "Zhou 2020": 0.811,
        "Boukhayma": 0.674,
        "Drosakis": 0.563,
        "Iqbal": 0.543,
    },
}
"""kind of data set -> method -> AUC of PCK 20-50 mm, as published; curves are not"""


def has_published(evaluation: Evaluation) -> bool:
    """Whether there are published numbers on this data set."""
    return evaluation.kind in OTHERS_AUC


def experiments_table(evaluation: Evaluation) -> Table | None:
    """The paper's A-H beside our runs of the same solvers; None on other data sets."""
    if not has_published(evaluation):
        return None
    epe, auc = METRICS["epe"], METRICS["auc"]
    columns = (
        *(Column("Solver", is_number=False), Column("Optimiser", is_number=False)),
        *(Column("Loss", is_number=False), Column("EPE published, mm"), Column("EPE here, mm")),
        *(Column("Difference, mm"), Column("AUC published"), Column("AUC here"), Column("Difference")),
    )
    rows = []
    for experiment in EXPERIMENTS:
        their_epe, their_auc = experiment.results[evaluation.kind]
        our_epe = value_of(evaluation, experiment.solver, "epe")
        our_auc = value_of(evaluation, experiment.solver, "auc")
        numbers = (
            *((their_epe, epe), (our_epe, epe), (our_epe - their_epe, epe)),
            *((their_auc, auc), (our_auc, auc), (our_auc - their_auc, auc)),
        )
        rows.append(
            (
                *(name(experiment.solver), words(experiment.optimiser), words(experiment.loss)),
                *(Cell(text_of(value, metric)) for value, metric in numbers),
            )
        )
    return Table(columns, tuple(rows))


def beside_published(evaluation: Evaluation, focus: str | None = None) -> tuple[Scores, ...]:
    """Our methods that stand beside others' results: the best by AUC, and the one in focus."""
    chosen = {s.method for s in (best_method(evaluation, "auc"), focus_of(evaluation, focus)) if s}
    return tuple(s for s in methods_of(evaluation) if s.method in chosen)


def others_table(evaluation: Evaluation, focus: str | None = None) -> Table | None:
    """AUC of others' methods and of `beside_published`, best first, ours bold; None on other data sets."""
    if not has_published(evaluation):
        return None
    auc = METRICS["auc"]
    results = [(value, method, False) for method, value in OTHERS_AUC[evaluation.kind].items()]
    results += [(e.results[evaluation.kind][1], f"{e.solver}, as published", False) for e in EXPERIMENTS[:1]]
    results += [
        (value, f"{s.method}, here", True)
        for s in beside_published(evaluation, focus)
        if math.isfinite(value := value_of(evaluation, s.method, "auc"))
    ]
    results.sort(key=lambda result: -result[0])
    rows = tuple(
        (Cell(method, is_best=ours, is_number=False), Cell(text_of(value, auc), is_best=ours))
        for value, method, ours in results
    )
    return Table((Column("Method", is_number=False), Column("AUC 20-50 mm")), rows)


def published_note(evaluation: Evaluation) -> str:
    """What a reader of the published numbers should know."""
    if evaluation.protocol == "paper":
        return f"Published numbers: {SOURCE}. Ours are measured by the same protocol, faults included."
    return (
        f"Published numbers: {SOURCE}, by the paper's protocol. Ours are by the strict one, which counts "
        "misses, so the two do not compare; run again with --protocol paper to compare them."
    )
