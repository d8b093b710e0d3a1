"""Published numbers on EgoDexter and Dexter+Object, to stand beside ours.

Source: "Monocular 3D Hand Pose Estimation with Implicit Camera Alignment", arXiv 2506.11133, its table
of experiments A-H and the results of others that it lists. Nobody ran them again here.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import pandas as pd

from handfit_core.evaluate.report.tables import (
    Table,
    best_method,
    focus_of,
    methods_of,
    numbers_of,
    text_of,
)
from handfit_core.evaluate.scores import Evaluation, Scores
from handfit_core.evaluate.summary import METRICS

SOURCE: Final = "arXiv 2506.11133"


EXPERIMENTS: Final = pd.DataFrame(
    [
        ("paper-a", "L-BFGS", "MSE + tips", 17.724, 0.883, 13.985, 0.946),
        ("paper-b", "L-BFGS", "MSE", 19.642, 0.859, 14.859, 0.943),
        ("paper-c", "L-BFGS", "Geman-McClure + tips", 17.729, 0.883, 13.980, 0.946),
        ("paper-d", "L-BFGS", "Geman-McClure", 19.648, 0.859, 14.878, 0.942),
        ("paper-e", "L-BFGS", "Huber + tips", 17.864, 0.882, 13.978, 0.946),
        ("paper-f", "L-BFGS", "Huber", 19.963, 0.855, 15.279, 0.939),
        ("paper-g", "BFGS", "MSE + tips", 17.787, 0.883, 13.975, 0.946),
        ("paper-h", "L-BFGS", "MSE, then anatomical + 2D MSE", 42.833, 0.492, 24.574, 0.784),
    ],
    columns=[
        *("Solver", "Optimiser", "Loss"),
        *("egodexter epe", "egodexter auc", "dexter-object epe", "dexter-object auc"),
    ],
).set_index("Solver", drop=False)
"""The paper's experiments A-H by our names: for each kind of data set EPE in mm and AUC of PCK 20-50 mm"""

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
    cells = EXPERIMENTS[["Solver", "Optimiser", "Loss"]].copy()
    here = numbers_of(evaluation).reindex(EXPERIMENTS.index)
    for key, title, unit in (("epe", "EPE", ", mm"), ("auc", "AUC", "")):
        published = EXPERIMENTS[f"{evaluation.kind} {key}"]
        difference = f"{title}, difference{unit}"
        columns = (f"{title} published{unit}", published), (f"{title} here{unit}", here[key])
        for name, values in (*columns, (difference, here[key] - published)):
            cells[name] = [text_of(value, METRICS[key]) for value in values]
    return Table(cells, words=3)


def beside_published(evaluation: Evaluation, focus: str | None = None) -> tuple[Scores, ...]:
    """Our methods that stand beside others' results: the best by AUC, and the one in focus."""
    chosen = {s.method for s in (best_method(evaluation, METRICS["auc"]), focus_of(evaluation, focus)) if s}
    return tuple(s for s in methods_of(evaluation) if s.method in chosen)


def others_table(evaluation: Evaluation, focus: str | None = None) -> Table | None:
    """AUC of others' methods and of `beside_published`, best first, ours bold; None on other data sets."""
    if not has_published(evaluation):
        return None
    here = numbers_of(evaluation)["auc"]
    results = {**OTHERS_AUC[evaluation.kind]}
    results["paper-a, as published"] = float(EXPERIMENTS[f"{evaluation.kind} auc"]["paper-a"])
    ours = {f"{s.method}, here": here[s.method] for s in beside_published(evaluation, focus)}
    ranked = pd.Series({**results, **ours}).dropna().sort_values(ascending=False, kind="stable")
    texts = [text_of(value, METRICS["auc"]) for value in ranked]
    cells = pd.DataFrame({"Method": ranked.index, "AUC 20-50 mm": texts})
    return Table(cells, best=pd.DataFrame(dict.fromkeys(cells, ranked.index.isin(list(ours)))))


def published_note(evaluation: Evaluation) -> str:
    """What a reader of the published numbers should know."""
    if evaluation.protocol == "paper":
        return f"Published numbers: {SOURCE}. Ours are measured by the same protocol, faults included."
    return (
        f"Published numbers: {SOURCE}, by the paper's protocol. Ours are by the strict one, which counts "
        "misses, so the two do not compare; run again with --protocol paper to compare them."
    )
