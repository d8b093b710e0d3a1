"""The commands of a batch: a plan, its tasks, and what came of them.

The process that runs here stays light: slots (slot.py), which are processes of their own, do the tasks.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path

from handfit_core.detect.detector import DETECTORS
from handfit_core.errors import HandfitError, OptionError
from handfit_core.farm.collect import Report, state
from handfit_core.farm.commands import do, given_plans, task_exit_code, work_words
from handfit_core.farm.folder import Lost
from handfit_core.farm.inputs import Input, expand
from handfit_core.farm.plan import FOLDER, Plan, PlanGone, make_plan, plans_in
from handfit_core.farm.pool import Pool, is_final, share, usable_jobs
from handfit_core.farm.show import ProgressReporter, clock
from handfit_core.farm.templates import write_template
from handfit_core.files import check_writable
from handfit_core.media.frame_range import FrameRange, part_ranges
from handfit_core.worker.interpreter import find_python, worker_command, worker_environment
from handfit_core.worker.runner import Runner

from . import slot
from .console import blender_silenced, print_error, show_all_names, stopped_by_signals
from .exit_codes import EXIT_INTERRUPTED, EXIT_LATER, EXIT_OK, EXIT_SOME_FAILED, EXIT_USAGE
from .host import Host
from .one_input import start_empty
from .order import Order, files_named, options_of


def run(args: argparse.Namespace, host: Host) -> int:
    """Run the command that parsed arguments (arguments.py) ask for. Returns the exit code; raises nothing."""
    show_all_names()
    with stopped_by_signals():
        try:
            return _COMMANDS[args.command](args, host)
        except Lost as error:
            print_error(str(error), args.debug)
            return EXIT_LATER if args.command == "task" else EXIT_SOME_FAILED
        except HandfitError as error:
            print_error(str(error), args.debug)
            return EXIT_LATER if args.command == "task" and isinstance(error, PlanGone) else EXIT_USAGE
        except KeyboardInterrupt:
            print("stopped; what was finished is kept", file=sys.stderr)
            return EXIT_INTERRUPTED
        except Exception as error:  # a defect of ours: still one line, and never exit code 0
            print_error(f"unexpected {type(error).__name__}: {error}", args.debug)
            return EXIT_SOME_FAILED


def _capture(args: argparse.Namespace, host: Host) -> int:
    """A plan, its tasks, and the report."""
    plan = _planned(args, host)
    if args.dry_run:
        return _tell(plan, args)
    plan.save()  # also finds out now, not after an hour, that nothing can be written
    return _do(args, host, [plan])


def _plan(args: argparse.Namespace, host: Host) -> int:
    """A plan alone; its file's name on stdout."""
    plan = _planned(args, host)
    print(plan.save())
    return EXIT_OK


def _work(args: argparse.Namespace, host: Host) -> int:
    """What is left of a plan, beside whoever else is at it."""
    return _do(args, host, given_plans(args))


def _task(args: argparse.Namespace, host: Host) -> int:
    """One task, or some that one machine gets together."""
    (plan, *others) = given_plans(args)
    for other in others:
        if args.id in other.by_id:
            plan = other
    tasks = plan.chosen(args.id)
    with closing(ProgressReporter(tasks, args.progress)) as shown, _pool(args, host, 1) as pool:
        results = pool.run(plan, tasks, shown, again=args.again, retry_failed=args.retry_failed, wait=False)
    return task_exit_code(results, accept_failed=args.accept_failed)


def _farm_template(args: argparse.Namespace, _host: Host) -> int:
    """Job files; their names on stdout."""
    plans = plans_in(args.plan)
    if args.output and len(plans) > 1:
        raise OptionError(f"{args.plan} has {len(plans)} plans; name the one that {args.output} is to be for")
    for plan in plans:
        how = {"most": args.jobs, "timeout": args.timeout, "places": args.map}
        print(write_template(args.kind, plan, args.output, **how))
    return EXIT_OK


def _collect(args: argparse.Namespace, _host: Host) -> int:
    """The report as it is now."""
    report = Report(plans_in(args.plan if args.plan.is_dir() else args.plan.absolute().parent.parent))
    report.look()
    report.write()
    counts = {s: sum(r.status == s for r in report.results) for s in ("ok", "failed", "running", "pending")}
    print(", ".join(f"{count} {status}" for status, count in counts.items() if count) or "nothing to do")
    return EXIT_OK if counts["ok"] == len(report.results) else EXIT_SOME_FAILED


def _slot(_args: argparse.Namespace, host: Host) -> int:
    """Do tasks for whoever has started this process."""
    return slot.serve(host)


_COMMANDS: dict[str, Callable[[argparse.Namespace, Host], int]] = {
    "capture": _capture,
    "apply": _capture,
    "plan": _plan,
    "work": _work,
    "task": _task,
    "farm-template": _farm_template,
    "collect": _collect,
    "slot": _slot,
}


def _planned(args: argparse.Namespace, host: Host) -> Plan:
    """The plan of the inputs and options of a command line. Raises HandfitError."""
    order = Order.of_arguments(args, args.python or host.python)
    if order.character is not None:  # before hours of work for nothing
        with blender_silenced(order.debug):
            start_empty(keep_addons=host.keep_addons)
            order.character.check()
    options = options_of(args, order)
    inputs = [each for text in args.inputs for each in expand(text, args.grouping)]
    check_writable(args.output / FOLDER / "plan.json")
    make = partial(
        make_plan,
        inputs,
        args.output,
        options,
        files=files_named(options),
        flat=args.flat,
        overwrite=args.overwrite,
        command=host.command,
        frames=order.options.frames,
    )
    if not args.split:
        return make()
    if DETECTORS.get(order.options.detector).clip is None:
        raise OptionError(
            f"the detector {order.options.detector} looks at whole clips alone: leave out --split"
        )
    with slot.make_worker(host, args.python, None, args.debug) as runner:
        return make(parts_of=partial(_parts_of, args.split, order, runner))


def _parts_of(most: int, order: Order, runner: Runner, each: Input) -> list[str]:
    """The ranges of a clip with more than `most` frames; of other inputs, and of those that cannot be opened,
    none."""
    if each.take or each.error:
        return []
    try:
        known = runner.wait(runner.submit("probe", input=list(each.source)))
    except HandfitError:  # which its task will tell
        return []
    frames = (order.options.frames or FrameRange()).within(known["first"], known["last"])
    ranges = part_ranges(frames, -(-len(frames) // most))
    return [str(part) for part in ranges] if known["kind"] != "photo" and len(ranges) > 1 else []


def _tell(plan: Plan, args: argparse.Namespace) -> int:
    """What would be done."""
    left = []
    for task in plan.tasks:
        found, said = state(plan, task), task.error
        if is_final(found) and not (args.again or args.retry_failed):
            said = f"{found.error}; --retry-failed tries it again"
        elif found.status != "running" and (args.again or found.status != "ok"):
            found.status = "to do"
            left.append(task.cost)
        status = "done" if found.status == "ok" else found.status
        print(f"{status:8} {task.shown} -> {plan.folder(task).path}{said and f': {said}'}")
    jobs = _jobs(args, len(left))
    guess = clock(max(sum(left) / jobs, *left)) if left else ""
    print(f"{len(left)} of {len(plan.tasks)} to do" + (guess and f", {jobs} at a time: about {guess}"))
    return EXIT_OK


def _do(args: argparse.Namespace, host: Host, plans: Sequence[Plan]) -> int:
    """All tasks of some plans that are not sealed. Returns the exit code."""
    if args.scheduler or args.cluster:
        return _do_elsewhere(args, host, getattr(args, "plan", plans[0].path))
    pool = _pool(args, host, sum(len(plan.tasks) for plan in plans))
    return EXIT_OK if do(plans, pool, args) else EXIT_SOME_FAILED


def _do_elsewhere(args: argparse.Namespace, host: Host, plan: Path) -> int:
    """The same with Dask, whose client has threads: in a process of the Python that captures."""
    python = find_python(args.python or host.python)
    command = worker_command(python, *work_words(args, plan), f"--parent={os.getpid()}")
    try:
        client = subprocess.Popen(command, env=worker_environment(python))
    except OSError as error:
        raise OptionError(f"{python} cannot be started ({error.strerror}); name another Python") from error
    try:
        return client.wait()
    except KeyboardInterrupt:
        client.terminate()  # of Ctrl-C it knows already
        client.wait()
        raise


def _jobs(args: argparse.Namespace, tasks: int) -> int:
    """How many tasks run at a time."""
    return max(1, min(args.jobs or usable_jobs(), tasks))


def _pool(args: argparse.Namespace, host: Host, tasks: int) -> Pool:
    jobs = _jobs(args, tasks)
    return Pool(
        host.command,
        jobs=jobs,
        timeout=args.timeout,
        debug=args.debug,
        python=args.python or host.python,
        threads=min(filter(None, (host.threads, share(jobs))), default=None),
        processes=args.processes,
    )
