"""A whole evaluation as one readable function: detect, fit, score, summarise, compare."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from itertools import count
from pathlib import Path

from handfit_core.detect.keypoints import Detections
from handfit_core.errors import DatasetError, OptionError
from handfit_core.evaluate.detections import UnitDetections, UnitDetector
from handfit_core.evaluate.fits import Fits, FitTask
from handfit_core.evaluate.flat import Flat, flattened
from handfit_core.evaluate.labels import Dataset, Problem, Unit, units_of
from handfit_core.evaluate.methods import TrackResult, method_names, method_title
from handfit_core.evaluate.rows import Row, Rows, TrackInView, rows_of
from handfit_core.evaluate.scores import CAMERA_CHOICES, CameraChoice, Evaluation, ProtocolName, Scores
from handfit_core.evaluate.scoring import RowResult, baselines, score
from handfit_core.evaluate.summary import compare, summarise
from handfit_core.hand_model import OPEN_HAND
from handfit_core.options import CaptureOptions
from handfit_core.version import __version__

COMPARED_METRICS: dict[ProtocolName, tuple[str, ...]] = {
    "strict": ("pa_mpjpe", "epe", "error_2d"),
    "paper": ("epe",),
}


@dataclass(frozen=True)
class EvaluationOptions:
    """What to evaluate, and how."""

    methods: tuple[str, ...]
    """Names or groups, see `methods.method_names`"""
    protocol: ProtocolName = "strict"
    camera: CameraChoice = "assumed"
    """What solvers are told about the camera: nothing, or the data set's labels"""
    every: int = 1
    """Use every n-th still and every n-th clip"""
    clips: bool = True
    """Fit clips as wholes; False takes each of their pictures for a still"""
    jobs: int = 1
    """Processes that fit at the same time"""
    max_hands: int = 2
    reference: str | None = None
    """Every other method is compared with this one; the last of `methods` by default"""
    flat: Flat | None = None
    """Solvers are given keypoints without depth, spoilt like that; None: what the detector found"""
    model: str | None = None
    detector: CaptureOptions = CaptureOptions()  # noqa: RUF009 (frozen)


ReportProgress = Callable[[str, int, int], None]
"""(stage, done, total); stages are `detect`, `fit` and `score`"""


def evaluate(
    dataset: Dataset, options: EvaluationOptions, folder: Path, progress: ReportProgress
) -> Evaluation:
    """Evaluate methods on a data set; `folder` keeps fits, so that a second run goes on where one ended.

    For the paper's protocol on EgoDexter and Dexter+Object, open the set with `published_frame=True`.

    Raises OptionError for unknown methods and settings out of range, DatasetError when nothing in the
    set can be scored.
    """
    names = method_names(list(options.methods))
    reference = _checked(options, names)
    units = units_of(
        dataset.entries, clips=options.clips and options.protocol == "strict", every=options.every
    )
    settings = _detector_settings(options)
    with UnitDetector(settings) as detector:
        found = _detected_rows(units, detector, options, settings.max_hands, progress)
    if not found.rows:
        kinds = _grouped((*dataset.problems, *found.problems))
        listed = "; ".join(f"{kind}: {len(where)}" for kind, where in kinds.items()) or "it is empty"
        raise DatasetError(f"{dataset.root}: nothing in this data set can be scored ({listed})")

    fits = Fits(folder / "fits", options.protocol, options.model, {v.track.side for v in found.tracks})
    _fit_all(fits, names, found, options.jobs, progress)

    scores: list[Scores] = []
    of_meshes: dict[Problem, None] = {}
    truths = baselines(found.rows, options.protocol, options.model)
    judged = [*truths, *((name, method_title(name), _results(fits, name)) for name in names)]
    for i, method in enumerate(judged):
        is_baseline = i < len(truths)
        scores.append(score(*method, found.rows, options.protocol, of_meshes, is_baseline=is_baseline))
        progress("score", len(scores), len(judged))
    by_name = {s.method: s for s in scores}
    return Evaluation(
        dataset=dataset.name,
        kind=dataset.kind,
        root=dataset.root,
        protocol=options.protocol,
        scores=tuple(scores),
        summaries={s.method: summarise(s, options.protocol) for s in scores},
        comparisons=tuple(
            compare(by_name[reference], by_name[name], metric)
            for metric in COMPARED_METRICS[options.protocol]
            for name in names
            if name != reference
        ),
        pictures=found.pictures,
        labelled_hands=len(found.rows),
        extra_hands=found.extra_hands,
        problems=_grouped((*dataset.problems, *found.problems, *of_meshes)),
        notes=(*dataset.notes, *_notes(options)),
        setup=_setup(options, names, detector, fits),
    )


def _checked(options: EvaluationOptions, names: Sequence[str]) -> str:
    """The method that others are compared with. Raises OptionError."""
    if not names:
        raise OptionError("no solver was named; give at least one, as in --solvers raw,fused,paper-a")
    for what, value in (("every", options.every), ("jobs", options.jobs), ("max_hands", options.max_hands)):
        if value < 1:
            raise OptionError(f"{what} must be at least 1, not {value}")
    if options.flat is not None and not (
        0.0 <= options.flat.noise <= 1.0 and 0.0 <= options.flat.missing < 1.0
    ):
        raise OptionError(
            "flat keypoints want noise from 0 to 1 and a missing part of at least 0 and below 1, not "
            f"{options.flat.noise:g} and {options.flat.missing:g}"
        )
    if options.camera not in CAMERA_CHOICES:
        raise OptionError(f"camera must be one of {', '.join(CAMERA_CHOICES)}; got {options.camera!r}")
    reference = options.reference or names[-1]
    if reference not in names:
        raise OptionError(
            f"the reference '{reference}' is not among the evaluated solvers ({', '.join(names)})"
        )
    return reference


def _detector_settings(options: EvaluationOptions) -> CaptureOptions:
    if options.protocol == "paper":
        # The published evaluation looks for one hand, once.
        return replace(options.detector, max_hands=1, detector="mediapipe")
    return replace(options.detector, max_hands=options.max_hands)


def _detected_rows(
    units: Sequence[Unit],
    detector: UnitDetector,
    options: EvaluationOptions,
    max_hands: int | None,
    progress: ReportProgress,
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

    return rows_of(units, detect, protocol=options.protocol, max_hands=max_hands, camera=options.camera)


def _fit_all(fits: Fits, names: Sequence[str], found: Rows, jobs: int, progress: ReportProgress) -> None:
    # Track by track and not method by method: neighbours in time saw the machine in the same mood.
    tasks = [FitTask(name, view.track, view.intrinsics) for view in found.tracks for name in names]
    total = sum(int(task.track.detected.sum()) for task in tasks)
    done = 0
    for task in fits.run(tasks, jobs):
        done += int(task.track.detected.sum())
        progress("fit", done, total)


def _results(fits: Fits, name: str) -> Callable[[Row], RowResult | None]:
    """A method's result of a row, reading each track's file once for neighbouring rows."""

    @lru_cache(maxsize=1)
    def of_track(view: TrackInView) -> TrackResult:
        return fits.result(FitTask(name, view.track, view.intrinsics))

    def result_of(row: Row) -> RowResult | None:
        if row.track is None:
            return None
        found, model = of_track(row.track), fits.models[row.track.track.side]
        return RowResult(
            points_3d=found.points_3d[row.frame],
            picture_points=found.picture_points[row.frame],
            fit_ms=float(found.milliseconds[row.frame]),
            model=model,
            vertices=found.vertices(model, row.frame) if row.label.mesh else None,
            penetration=found.penetration(model, row.frame),
            expected_error=float(found.expected_error[row.frame]),
        )

    return result_of


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


def _setup(
    options: EvaluationOptions, names: Sequence[str], detector: UnitDetector, fits: Fits
) -> dict[str, str]:
    setup = {
        "handfit_core": __version__,
        "protocol": options.protocol,
        "solvers": ", ".join(names),
        "camera": options.camera,
        "clips": "as wholes" if options.clips and options.protocol == "strict" else "picture by picture",
        "every": str(options.every),
        "jobs": str(options.jobs),
        "hand model": options.model or OPEN_HAND,
        "hand model digests": ", ".join(f"{side} {m.digest}" for side, m in sorted(fits.models.items())),
        "detector": options.detector.detector,
        "detection": _detector_settings(options).detector,
        "detection threshold": f"{options.detector.threshold:g}",
        "detector's models and versions": detector.fingerprint,
        "Python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} CPU cores",
    }
    for package in ("numpy", "scipy", "torch", "mediapipe", "opencv-python-headless"):
        with suppress(PackageNotFoundError):
            setup[package] = version(package)
    return setup
