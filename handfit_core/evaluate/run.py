"""A whole evaluation as one readable function: detect, fit, score, summarise, compare."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, count

import pandas as pd

from handfit_core.capturing.options import CaptureOptions
from handfit_core.common.errors import DatasetError, OptionError
from handfit_core.common.skeleton import Side
from handfit_core.common.version import __version__
from handfit_core.detect.keypoints import Detections
from handfit_core.evaluate import CameraChoice, ProtocolName
from handfit_core.evaluate.cache import versions
from handfit_core.evaluate.detections import UnitDetections, UnitDetector
from handfit_core.evaluate.fits import fit_all
from handfit_core.evaluate.flat import Flat, flattened
from handfit_core.evaluate.labels import Dataset, Problem, Unit, units_of
from handfit_core.evaluate.methods import TrackResult, method_names
from handfit_core.evaluate.rows import Rows, rows_of
from handfit_core.evaluate.scores import Evaluation
from handfit_core.evaluate.scoring import Models, baselines, results_of_rows, score
from handfit_core.evaluate.summary import compare, summarise
from handfit_core.hand_model import OPEN_HAND, load_model

COMPARED_METRICS: dict[ProtocolName, tuple[str, ...]] = {
    "strict": ("pa_mpjpe", "epe", "error_2d"),
    "paper": ("epe",),
}


@dataclass(frozen=True)
class EvaluationOptions:
    """The user's choices for an evaluation: the methods, and settings."""

    methods: tuple[str, ...]
    """Names of methods or of groups of them, see `methods.method_names`"""
    protocol: ProtocolName = "strict"
    camera: CameraChoice = "assumed"
    """The camera that solvers get: a guess, or the data set's labels"""
    every: int = 1
    """The n by which every n-th still and every n-th clip is used"""
    clips: bool = True
    """True if clips are fitted as wholes; False takes each of their pictures for a still"""
    jobs: int = 1
    """How many processes fit at the same time"""
    reference: str | None = None
    """The method that every other one is compared with; None for the last of `methods`"""
    flat: Flat | None = None
    """The damage to the keypoints without depth that solvers are given; None gives them what the detector
    found"""
    model: str | None = None
    detector: CaptureOptions = CaptureOptions()  # noqa: RUF009 (frozen)


ReportProgress = Callable[[str, int, int], None]
"""Takes the stage (`detect`, `fit` or `score`), how much of it is done, and how much there is"""


def evaluate(dataset: Dataset, options: EvaluationOptions, progress: ReportProgress) -> Evaluation:
    """Evaluate methods on a data set. Detections and fits are kept in the cache, so that a second run goes on
    where one ended.

    For the paper's protocol on EgoDexter and Dexter+Object, open the set with `published_frame=True`.

    Raises OptionError for unknown methods and settings out of range, DatasetError when nothing in the
    set can be scored.
    """
    protocol, names = options.protocol, method_names(list(options.methods))
    reference = _checked(options, names)
    clips = options.clips and protocol == "strict"
    # The published evaluation looks for one hand, once.
    paper = {"max_hands": 1, "detector": "mediapipe"} if protocol == "paper" else {"max_hands": 2}
    settings = replace(options.detector, **paper)
    with UnitDetector(settings) as detector:
        rows = _detected_rows(
            units_of(dataset.entries, clips=clips, every=options.every), detector, options, progress
        )
    if not rows.listed:
        kinds = _grouped((*dataset.problems, *rows.problems))
        listed = "; ".join(f"{kind}: {len(where)}" for kind, where in kinds.items()) or "it is empty"
        raise DatasetError(f"{dataset.root}: nothing in this data set can be scored ({listed})")

    sides: set[Side] = {view.track.side for view in rows.tracks}
    models: Models = {side: load_model(options.model, side) for side in sides}
    results = _fitted(rows, names, options, progress)
    null = baselines(rows, protocol, options.model)
    judged = null | {name: results_of_rows(rows, results[name]) for name in names}
    of_meshes: dict[Problem, None] = {}
    scores = {}
    for name, found in judged.items():
        scores[name] = score(name, found, rows, protocol, models, of_meshes, is_baseline=name in null)
        progress("score", len(scores), len(judged))
    return Evaluation(
        dataset=dataset.name,
        kind=dataset.kind,
        root=dataset.root,
        protocol=protocol,
        scores=tuple(scores.values()),
        summaries=pd.DataFrame({name: summarise(s, protocol) for name, s in scores.items()}).T,
        comparisons=tuple(
            compare(scores[reference], scores[name], metric)
            for metric in COMPARED_METRICS[protocol]
            for name in names
            if name != reference
        ),
        pictures=rows.pictures,
        labelled_hands=len(rows.listed),
        extra_hands=rows.extra_hands,
        problems=_grouped((*dataset.problems, *rows.problems, *of_meshes)),
        notes=(*dataset.notes, *_notes(options)),
        setup={
            "handfit_core": __version__,
            "protocol": protocol,
            "solvers": ", ".join(names),
            "camera": options.camera,
            "clips": "as wholes" if clips else "picture by picture",
            "every": str(options.every),
            "jobs": str(options.jobs),
            "hand model": options.model or OPEN_HAND,
            "hand model digests": ", ".join(f"{side} {m.digest}" for side, m in sorted(models.items())),
            "detector": options.detector.detector,
            "detection": settings.detector,
            "detection threshold": f"{settings.threshold:g}",
            "detector's models and versions": detector.fingerprint,
            "Python": platform.python_version(),
            "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} CPU cores",
            **versions("numpy", "scipy", "torch", "mediapipe", "opencv-python-headless"),
        },
    )


def _checked(options: EvaluationOptions, names: Sequence[str]) -> str:
    """Check the options; returns the method that others are compared with. Raises OptionError."""
    if not names:
        raise OptionError("no solver was named; give at least one, as in --solvers raw,fused,paper-a")
    for what, value in (("every", options.every), ("jobs", options.jobs)):
        if value < 1:
            raise OptionError(f"{what} must be at least 1, not {value}")
    flat = options.flat
    if flat is not None and not (0.0 <= flat.noise <= 1.0 and 0.0 <= flat.missing < 1.0):
        raise OptionError(
            "flat keypoints want noise from 0 to 1 and a missing part of at least 0 and below 1, not "
            f"{flat.noise:g} and {flat.missing:g}"
        )
    reference = options.reference or names[-1]
    if reference not in names:
        raise OptionError(
            f"the reference '{reference}' is not among the evaluated solvers ({', '.join(names)})"
        )
    return reference


def _detected_rows(
    units: Sequence[Unit], detector: UnitDetector, options: EvaluationOptions, progress: ReportProgress
) -> Rows:
    total, done, seeds = sum(len(unit.entries) for unit in units), count(1), count()

    def detect(unit: Unit) -> UnitDetections:
        seen = detector.detect(unit, lambda: progress("detect", next(done), total))
        flat = options.flat
        if flat is None:
            return seen
        frames = (seen.hands.select(seen.hands.frame == row) for row in range(len(unit.entries)))
        parts = [flattened(hands, flat, seed=next(seeds)) for hands in frames]
        return replace(seen, hands=Detections.concatenate(parts))

    return rows_of(units, detect, protocol=options.protocol, camera=options.camera)


def _fitted(
    rows: Rows, names: Sequence[str], options: EvaluationOptions, progress: ReportProgress
) -> dict[str, list[TrackResult]]:
    """Return every method's results, of all tracks, by the method's name."""
    # Track by track and not method by method: neighbours in time saw the machine in the same mood.
    tasks = [(name, view) for view in rows.tracks for name in names]
    done = list(accumulate(len(view.track.detections) for _, view in tasks))
    results: dict[str, list[TrackResult]] = {name: [] for name in names}
    made = fit_all(tasks, options.protocol, options.model, options.jobs)
    for (name, _), result, reached in zip(tasks, made, done, strict=True):
        results[name].append(result)
        progress("fit", reached, done[-1])
    return results


def _grouped(problems: Sequence[Problem]) -> dict[str, tuple[str, ...]]:
    kinds = dict.fromkeys(problem.kind for problem in problems)
    return {kind: tuple(p.where for p in problems if p.kind == kind) for kind in kinds}


def _notes(options: EvaluationOptions) -> list[str]:
    if options.protocol == "paper":
        return [
            "The paper's protocol, faults included: fingertips only; pictures without a detection are "
            "dropped; every hand is taken for a left one; the true camera and the true mean depth are used; "
            "one pixel of depth counts as one millimetre; a picture with one labelled tip scores 0 mm; "
            "'joints' mix where a tip has no label."
        ]
    camera = {
        "assumed": "Solvers are told nothing about the camera: one with a 53 degree view is assumed.",
        "labelled": "Solvers are told the data set's own camera.",
    }[options.camera]
    flat = options.flat and (
        f"Solvers are given keypoints without depth, with noise of {options.flat.noise:.1%} of the hand's "
        f"size, and {options.flat.missing:.0%} of the points missing."
    )
    return [
        *([flat] if flat else []),
        camera,
        "Every labelled hand counts: one that was not detected is wrong at every threshold of PCK and AUC. "
        "Mean errors are over detected hands only; read them beside the detection rate.",
        "The null baselines know the truth; they show what a number is worth.",
    ]
