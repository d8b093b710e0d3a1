"""The command line's `evaluate`."""

from __future__ import annotations

import argparse
import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

from handfit_core.capturing.options import CaptureOptions, add_options, add_progress
from handfit_core.capturing.pipeline import Progress
from handfit_core.common.errors import OptionError
from handfit_core.common.files import check_writable, path_of
from handfit_core.evaluate import CAMERA_CHOICES, ProtocolName

REPORTS_NEED = ("pandas", "jinja2", "joblib")
DEFAULT_METHODS = ("raw", "fused", CaptureOptions.solver)


def add_evaluate_command(subparsers: argparse._SubParsersAction) -> None:
    """Add `evaluate`; its handler raises HandfitError for what the user can mend."""
    command = subparsers.add_parser(
        "evaluate",
        help="how accurate and how fast solvers are on labelled pictures",
        description="Detect every picture once, fit with every solver, and write a report. A run that was "
        "stopped goes on where it ended when the same command is given again.",
    )
    command.set_defaults(handler=_evaluate)
    add = command.add_argument
    add("dataset", type=Path, metavar="DIR", help="the data set's folder (docs/data-sets.md)")
    text = "folder for the report (default: out/evaluation/NAME-PROTOCOL)"
    add("-o", "--output", type=path_of, metavar="REPORT", help=text)
    text = "solvers, and raw, fused, paper or all, separated by commas or spaces "
    text += f"(default: {','.join(DEFAULT_METHODS)})"
    add("--solvers", nargs="+", default=list(DEFAULT_METHODS), metavar="NAMES", help=text)
    text = "strict counts misses; paper is the published evaluation, faults included (default: strict)"
    add("--protocol", choices=get_args(ProtocolName), default="strict", help=text)
    add("--kind", metavar="KIND", help="the data set's layout (default: recognised)")
    add("--split", metavar="SPLIT", help="which part of a data set that has several")
    text = "which labels of EgoDexter and Dexter+Object (default: cleaned where they are)"
    add("--labels", choices=("original", "cleaned"), help=text)
    text = "what solvers are told about the camera (default: assumed, that is nothing)"
    add("--camera", choices=CAMERA_CHOICES, default="assumed", help=text)
    add("--every", type=int, default=1, metavar="N", help="every n-th still and every n-th clip only")
    add("--stills", action="store_true", help="take each picture of a clip for a still of its own")
    text = (
        "give solvers keypoints without depth, as other programs do, with that much noise (0.01: 1 %% of the "
    )
    text += "hand's size) and that part of the points missing"
    add("--flat", nargs=2, type=float, metavar=("NOISE", "MISSING"), help=text)
    add("--reference", metavar="NAME", help="compare the others with this solver (default: the last one)")
    add("--jobs", type=int, default=1, metavar="N", help="fit in N processes; times then compare less well")
    add_options(command, ("model", "detector", "threshold", "plain_detection", "quality", "landmark_model"))
    add_progress(command)


def _evaluate(args: argparse.Namespace) -> int:
    missing = [name for name in REPORTS_NEED if importlib.util.find_spec(name) is None]
    if missing:  # said now, not after an hour of fitting
        raise OptionError(
            f"evaluate's report needs {' and '.join(missing)}, which this Python lacks; "
            f"run `python -m pip install {' '.join(REPORTS_NEED)}`"
        )
    # Other commands need none of these, and reports need the packages of above.
    from handfit_core.evaluate.datasets import open_dataset
    from handfit_core.evaluate.flat import Flat
    from handfit_core.evaluate.report import as_text, main_table, write_report
    from handfit_core.evaluate.run import EvaluationOptions, evaluate
    from handfit_core.evaluate.views import KIND, is_two_cameras

    if args.kind == KIND or (args.kind is None and is_two_cameras(args.dataset)):
        return _evaluate_views(args)
    options = EvaluationOptions(
        methods=tuple(name for word in args.solvers for name in word.split(",") if name),
        protocol=args.protocol,
        camera=args.camera,
        every=args.every,
        clips=not args.stills,
        jobs=args.jobs,
        reference=args.reference,
        flat=None if args.flat is None else Flat(*args.flat),
        model=args.model,
        detector=CaptureOptions.of_arguments(args),
    )
    dataset = open_dataset(
        args.dataset,
        args.kind,
        split=args.split,
        labels=args.labels,
        published_frame=args.protocol == "paper",
    )
    folder = args.output or Path("out", "evaluation", f"{args.dataset.resolve().name}-{args.protocol}")
    check_writable(folder / "index.html")  # now, not after an hour of fitting
    evaluation = evaluate(dataset, options, _progress(args))
    files = write_report(folder, evaluation)
    args.reporter.evaluated(
        {
            "output": str(folder / "index.html"),
            "files": [str(file) for file in files],
            "pictures": evaluation.pictures,
            "hands": evaluation.labelled_hands,
            "problems": {kind: len(where) for kind, where in evaluation.problems.items()},
            "summaries": evaluation.summaries.to_dict("index"),
        },
        as_text(main_table(evaluation)).set_index("method").T.to_string(),
    )
    return 0


def _evaluate_views(args: argparse.Namespace) -> int:
    """Clips of two cameras, whose pairs are joined as captures do it, with nothing, lenses or all told."""
    from handfit_core.evaluate.views import evaluate_views, views_table

    folder = args.output or Path("out", "evaluation", f"{args.dataset.resolve().name}-views")
    path = folder / "views.csv"
    check_writable(path)
    rows = evaluate_views(args.dataset, CaptureOptions.of_arguments(args), _progress(args))
    folder.mkdir(parents=True, exist_ok=True)
    rows.to_csv(path, index=False)
    args.reporter.evaluated({"output": str(path), "problems": {}, "pairs": len(rows)}, views_table(rows))
    return 0


def _progress(args: argparse.Namespace) -> Callable[[Any, int, int], None]:
    if args.progress == "none":
        return lambda *_: None
    return lambda stage, done, total: args.reporter.progress(Progress(stage, done, total))
