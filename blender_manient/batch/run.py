"""A whole batch: every input with one process that captures, and a report that is always up to date."""

from __future__ import annotations

import argparse
import contextlib
import sys
import time
import traceback
from dataclasses import dataclass

from handfit_core.errors import HandfitError
from handfit_core.worker.client import Advice
from handfit_core.worker.interpreter import PYTHON_VARIABLE
from handfit_core.worker.runner import Runner

from .. import shared_worker
from .console import blender_silenced, print_error, show_all_names, stopped_by_signals
from .exit_codes import EXIT_INTERRUPTED, EXIT_OK, EXIT_SOME_FAILED, EXIT_USAGE
from .inputs import Job, expand, with_free_names
from .one_input import fit, start_empty
from .order import Order
from .report import Result, line, write_report


@dataclass(frozen=True)
class Host:
    """Where a batch runs: what differs between the script and the installed add-on."""

    python: str | None = None
    """Captures where --python names none; None: as `find_python` chooses"""
    threads: int | None = None
    """How many a capture may use; None: its own choice"""
    python_is_chosen: str = f"with --python or in ${PYTHON_VARIABLE}"
    """Part of a sentence: where the user names the Python that captures"""
    keep_addons: bool = False
    """Whether add-ons and preferences stay as they are; else the run is under Blender's factory settings"""


def run(args: argparse.Namespace, host: Host) -> int:
    """Run the batch that parsed arguments (arguments.py) ask for. Returns the exit code; raises nothing."""
    show_all_names()
    with stopped_by_signals():
        try:
            order = Order.of_arguments(args, args.python or host.python)
            if order.character is not None:  # before hours of work for nothing
                with blender_silenced(order.debug):
                    start_empty(keep_addons=host.keep_addons)
                    order.character.check()
            jobs = with_free_names(
                [job for text in args.inputs for job in expand(text, args.grouping)],
                order.output,
                # In a flat folder names only need to differ from each other: results replace older ones.
                args.overwrite or order.flat,
            )
            return _run(jobs, order, args.python, host)
        except HandfitError as error:
            print_error(str(error), args.debug)
            return EXIT_USAGE
        except KeyboardInterrupt:
            print("stopped; what was finished is kept", file=sys.stderr)
            return EXIT_INTERRUPTED
        except Exception as error:  # a defect of ours: still one line, and never exit code 0
            print_error(f"unexpected {type(error).__name__}: {error}", args.debug)
            return EXIT_SOME_FAILED


def _run(jobs: list[Job], order: Order, python: str | None, host: Host) -> int:
    """Every job with one worker process, which starts with the first capture and again after a crash."""
    where = host.python_is_chosen
    advice = Advice(where, crash=f"try again with --debug, or choose another Python {where}")
    with shared_worker.make(python or host.python, host.threads, order.debug, advice) as runner:
        return _run_with(runner, jobs, order, host.keep_addons)


def _run_with(runner: Runner, jobs: list[Job], order: Order, keep_addons: bool) -> int:
    results = [Result(job.shown, job.name) for job in jobs]
    report = order.output / "report.json"
    write_report(report, results)  # also finds out now, not after an hour, that it cannot be written
    reported = True
    for number, (job, result) in enumerate(zip(jobs, results, strict=True), 1):
        started = time.perf_counter()
        try:
            fit(job, result, order, runner, keep_addons=keep_addons)
            result.status = "ok"
        except KeyboardInterrupt:
            result.status, result.error = "interrupted", "stopped by the user"
            raise
        except HandfitError as error:
            result.status, result.error = "failed", " ".join(str(error).split())
            if order.debug:
                traceback.print_exc()
        except Exception as error:
            result.status = "failed"
            result.error = f"unexpected {type(error).__name__}: {' '.join(str(error).split())} (see --debug)"
            if order.debug:
                traceback.print_exc()
        finally:
            result.seconds = round(time.perf_counter() - started, 3)
            if not order.flat:
                with contextlib.suppress(OSError, ValueError):
                    order.folder(job.name).rmdir()  # only if nothing was written
            try:
                write_report(report, results)
                reported = True
            except HandfitError as error:  # the inputs that are left may still succeed
                reported = False
                print_error(str(error), order.debug)
            print(f"[{number}/{len(jobs)}] {line(result)}", flush=True)
    return EXIT_OK if reported and all(r.status == "ok" for r in results) else EXIT_SOME_FAILED
