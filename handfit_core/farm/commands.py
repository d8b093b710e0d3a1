"""Commands of a batch that need no Blender: how tasks are done, whoever does them, and `work` with Dask."""

from __future__ import annotations

import argparse
import itertools
import math
import signal
import sys
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, closing
from functools import partial
from pathlib import Path
from typing import Any, Final, NoReturn, Protocol

from handfit_core.errors import HandfitError, InputError, OptionError
from handfit_core.farm.collect import Report
from handfit_core.farm.plan import Plan, Task, places_of, plans_in, warn_once
from handfit_core.farm.pool import ATTEMPTS, CURABLE, OF_MACHINE, Listener, is_final, last_kind
from handfit_core.farm.report import Result
from handfit_core.farm.show import STYLES, ProgressReporter
from handfit_core.files import shown
from handfit_core.options import OPTIONS
from handfit_core.version import __version__
from handfit_core.worker.process import end_with_parent

EXIT_SOME_FAILED: Final = 1
EXIT_USAGE: Final = 2
EXIT_LATER: Final = 75
_DONE_HERE: Final = (
    "jobs",
    "timeout",
    "progress",
    "python",
    "processes",
    "scheduler",
    "cluster",
    "tls",
    "program",
)
_SWITCHES: Final = ("again", "retry_failed", "debug")


class Doer(Protocol):
    """Does the tasks of a plan: a `Pool`, or a `Cluster`."""

    def run(
        self, plan: Plan, tasks: Sequence[Task], listener: Listener, *, again: bool, retry_failed: bool
    ) -> list[Result]:
        """As `Pool.run`."""
        ...


def do(plans: Sequence[Plan], doer: AbstractContextManager[Doer], args: argparse.Namespace) -> bool:
    """Have all tasks of some plans of one folder done that are not sealed, and keep the report up to date.
    Returns whether all are done. `args`: what `add_running_arguments` adds."""
    report = Report(plans_in(plans[0].output))
    # Of several plans a later one may have taken a name of an earlier one.
    tasks = [[task for task in plan.tasks if len(plans) == 1 or report.has(task)] for plan in plans]
    report.look()
    report.write()
    results: list[Result] = []
    with closing(ProgressReporter(list(itertools.chain(*tasks)), args.progress, report)) as listener:
        try:
            with doer as it:
                for plan, some in zip(plans, tasks, strict=True):
                    results += it.run(plan, some, listener, again=args.again, retry_failed=args.retry_failed)
        except (KeyboardInterrupt, HandfitError) as error:
            listener.interrupted(str(error))
            raise
    return not listener.trouble and all(result.status == "ok" for result in results)


def task_exit_code(results: Sequence[Result], *, accept_failed: bool) -> int:
    """What `task` ends with. `accept_failed`: failures that lie in the input are none of the farm's, and also
    what has killed the process that captures in every attempt; those of a machine are never accepted, or one
    machine that lacks something would empty a whole queue."""
    left = [result for result in results if result.status != "ok"]
    if accept_failed:
        left = [result for result in left if not _lies_in_input(result)]
    if any(result.status == "running" or last_kind(result) in (*CURABLE, *OF_MACHINE) for result in left):
        return EXIT_LATER
    return EXIT_SOME_FAILED if left else 0


def _lies_in_input(result: Result) -> bool:
    deaths = sum(each.get("kind") == "WorkerDied" for each in result.attempts)
    failed = result.status == "failed"
    return failed and (is_final(result) or last_kind(result) == "PartFailed" or deaths >= ATTEMPTS)


def given_plans(args: argparse.Namespace) -> list[Plan]:
    """The plans that a command line names, with paths as they are here. Those of a folder that another
    version made are passed over. Raises InputError, and OptionError where none is left."""
    places = [place for text in args.map for place in places_of(text)]
    plans, refused = [], []
    for plan in plans_in(args.plan):
        if plan.made_by == __version__:
            plans.append(plan.mapped(places))
            continue
        refused.append(
            f"{shown(plan.path)}: this plan was made by version {plan.made_by}, and this is version "
            f"{__version__}; use the same version on all machines, or make the plan anew"
        )
    if not plans:
        raise OptionError(refused[0])
    for text in refused:
        warn_once(f"{text}; it is passed over")
    return plans


def add_plan(parser: argparse.ArgumentParser) -> None:
    """Add the plan that is meant."""
    parser.add_argument(
        "plan", type=Path, metavar="PLAN", help="a plan's file, or a folder of results for all in it"
    )


def add_map(parser: argparse.ArgumentParser) -> None:
    """Add how a plan's paths are called here."""
    parser.add_argument(
        "--map",
        action="append",
        default=[],
        metavar="THERE=HERE",
        help="paths that begin with THERE in the plan begin with HERE on this machine; or a file with Open "
        "Job Description's path mapping rules",
    )


def add_running_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what says how tasks are done, which changes nothing in their results."""
    parser.add_argument("--timeout", type=seconds, metavar="SECONDS", help="longest time for one input")
    parser.add_argument(
        "--jobs", type=count, metavar="N", help="inputs at a time (default: by cores and memory)"
    )
    parser.add_argument("--again", action="store_true", help="also do what is done already")
    parser.add_argument(
        "--retry-failed", action="store_true", help="also try inputs that failed for reasons of their own"
    )
    parser.add_argument("--progress", choices=STYLES, default="text", help="how to tell (default: text)")


def add_cluster_arguments(parser: argparse.ArgumentParser, *, required: bool = False) -> None:
    """Add what has the workers of a Dask cluster do the tasks."""
    which = parser.add_mutually_exclusive_group(required=required)
    which.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="have the workers of this Dask scheduler do it: tcp://HOST:8786",
    )
    which.add_argument(
        "--cluster",
        metavar="KIND",
        help="have N Dask workers do it (--jobs), started as jobs of slurm, pbs, sge, lsf, htcondor, moab or "
        "oar, or on this machine: local",
    )
    parser.add_argument(
        "--tls", metavar="CA,CERT,KEY", help="files for connections to Dask that are encrypted"
    )
    parser.add_argument(
        "--command", dest="program", metavar="WORDS", help="does the tasks on workers, instead of the plan's"
    )


def add_work_command(commands: Any) -> None:
    """Add `work`, which sets `handler`, called as handler(args) -> exit code."""
    parser = commands.add_parser(
        "work", help="have a Dask cluster do what is left of a plan; needs no Blender on this machine"
    )
    parser.set_defaults(handler=_work)
    add_plan(parser)
    add_map(parser)
    add_running_arguments(parser)
    OPTIONS["processes"].add_to(parser)
    add_cluster_arguments(parser, required=True)
    parser.add_argument("--python", metavar="PATH", help="Python that captures, on the workers")
    parser.add_argument("--parent", type=int, help=argparse.SUPPRESS)  # the process with which it ends


def work_words(args: argparse.Namespace, plan: Path) -> list[str]:
    """The command `work` for a plan's file, with what a command line of the add-on says of it."""
    said: Mapping[str, Any] = vars(args)
    found = ["work", str(plan)]
    for name in _DONE_HERE:
        if said.get(name) is not None:
            option = "--command" if name == "program" else f"--{name}"
            found += [f"{option}={said[name]}"]
    found += [f"--map={text}" for text in said.get("map", ())]
    return found + [f"--{name.replace('_', '-')}" for name in _SWITCHES if said.get(name)]


def _work(args: argparse.Namespace) -> int:
    from handfit_core.farm.dask_engine import Cluster, words

    before = {number: signal.signal(number, _interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
    if args.parent is not None:
        end_with_parent(args.parent, partial(signal.raise_signal, signal.SIGTERM))
    try:
        plans = given_plans(args)
        doer = Cluster(
            scheduler=args.scheduler,
            cluster=args.cluster,
            jobs=args.jobs or 1,
            tls=args.tls,
            command=words(args.program) if args.program else None,
            timeout=args.timeout,
            debug=args.debug,
            python=args.python,
            processes=args.processes,
        )
        return 0 if do(plans, doer, args) else EXIT_SOME_FAILED
    except (OptionError, InputError) as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_USAGE
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _interrupt(_number: int, _frame: object) -> NoReturn:
    """Once is enough: the rest of the time is for cleaning up."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt


def seconds(text: str) -> float:
    """A time of more than 0 seconds."""
    number = float(text)
    if not 0.0 < number < math.inf:
        raise argparse.ArgumentTypeError("more than 0 seconds are needed")
    return number


def count(text: str) -> int:
    """A number of at least 1."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError("at least 1 is needed")
    return number
