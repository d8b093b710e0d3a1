"""The commands of a batch: inputs become takes, and takes become files.

The first step is `python -m handfit_core batch`, a child in the Python that captures. In the second one some
processes that hold Blender turn takes into files, each its share. The process that runs here stays light.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from handfit_core.capturing.options import OPTIONS, CaptureOptions
from handfit_core.common.errors import HandfitError, OptionError
from handfit_core.common.files import check_writable
from handfit_core.common.machine import usable_jobs
from handfit_core.tasks.arguments import WITH_PARENT
from handfit_core.tasks.progress import Progress
from handfit_core.tasks.record import Result
from handfit_core.tasks.report import REPORT, read_results
from handfit_core.tasks.task import Task, make_tasks
from handfit_core.worker import interpreter

from ..session import shared_worker
from .commands import EXIT_INTERRUPTED, EXIT_OK, EXIT_SOME_FAILED, EXIT_USAGE, EXPORT
from .console import blender_silenced, print_error, show_all_names, stopped_by_signals
from .exported import Exported
from .exports import Exports, export, start_empty, tell

_OF_CORE = (
    *("output", "jobs", "scheduler", "timeout", "progress"),
    *("again", "retry_failed", "overwrite", "flat", "no_sheet", "debug"),
)
"""Arguments of the first step, beside those of a capture"""


@dataclass(frozen=True)
class Host:
    """The command line that is running: what differs between the script and the installed add-on."""

    command: tuple[str, ...]
    """What starts another one like it, but for the name of the command"""
    python: str | None = None
    """Captures where --python names none; None: as `find_python` chooses"""
    threads: int | None = None
    """How many a capture may use; None: its own choice"""
    python_is_chosen: str = f"with --python or in ${interpreter.PYTHON_VARIABLE}"
    """Part of a sentence: where the user names the Python that captures"""
    keep_addons: bool = False
    """Whether add-ons and preferences stay as they are; else the run is under Blender's factory settings"""


def run(args: argparse.Namespace, host: Host) -> int:
    """Run the command that parsed arguments (arguments.py) ask for. Returns the exit code; raises nothing."""
    show_all_names()
    with stopped_by_signals():
        try:
            if args.command == EXPORT:
                export(args.job, keep_addons=host.keep_addons)
                return EXIT_OK
            return _run(args, host)
        except HandfitError as error:
            print_error(str(error), args.debug)
            return EXIT_USAGE
        except KeyboardInterrupt:
            print("stopped; what was finished is kept", file=sys.stderr)
            return EXIT_INTERRUPTED
        except Exception as error:  # a defect of ours: still one line, and never exit code 0
            print_error(f"unexpected {type(error).__name__}: {error}", args.debug)
            return EXIT_SOME_FAILED


def _run(args: argparse.Namespace, host: Host) -> int:
    """Do both steps of the batch. Raises HandfitError where nothing can be tried."""
    exports, output = Exports.of_arguments(args), args.output.absolute()
    options = CaptureOptions.of_arguments(args)
    if exports.character is not None:  # before hours of work for nothing
        with blender_silenced(args.debug):
            start_empty(keep_addons=host.keep_addons)
            used = exports.character.check()
        given = exports.given["bones"] or used
        exports = replace(exports, given={**exports.given, "bones": given})
    sheet, flat, overwrite = not args.no_sheet, args.flat, args.overwrite
    tasks = make_tasks(
        args.inputs, options, output, grouping=args.grouping, sheet=sheet, flat=flat, overwrite=overwrite
    )
    batch = _Batch(args, host, exports, output, tasks)
    if args.dry_run:
        return batch.tell()
    check_writable(output / REPORT)
    code = batch.capture(args.python or host.python)
    if code in (EXIT_USAGE, EXIT_INTERRUPTED):  # it has said why
        return code
    if code == interpreter.EXIT_UNFIT:
        raise OptionError(f"choose another Python {host.python_is_chosen}: this one cannot capture")
    if code not in (EXIT_OK, EXIT_SOME_FAILED):
        hint = "; with --jobs 2 an input that ends it fails alone" if code < 0 else ""
        print_error(f"the process that captures ended with code {code}{hint}")
    return EXIT_OK if batch.export() and code == EXIT_OK else EXIT_SOME_FAILED


@dataclass(frozen=True)
class _Batch:
    """The tasks of a command line, and their two steps."""

    args: argparse.Namespace
    host: Host
    exports: Exports
    output: Path
    tasks: Sequence[Task]

    def capture(self, python: str | None) -> int:
        """Have a take made of each input. Returns the exit code of the process that does it. Raises
        OptionError where it cannot be started."""
        args, python = self.args, interpreter.find_python(python)
        only_takes = all(task.take for task in self.tasks)
        is_own = interpreter.is_current_interpreter(python)
        given = {option.flag: getattr(args, name) for name, option in OPTIONS.items()}
        given |= {f"--{name.replace('_', '-')}": getattr(args, name) for name in _OF_CORE}
        given["--processes"] = args.processes or self.host.threads
        words = [f"--{args.grouping}"] if args.grouping else []
        for flag, value in given.items():
            if value is True:
                words.append(flag)
            elif value is not None and value is not False:
                words += [f"{flag}={each}" for each in (value if isinstance(value, list) else [value])]
        command = interpreter.worker_command(python, "batch", *words, WITH_PARENT, "--", *args.inputs)
        bytecode = shared_worker.bytecode_folder() if is_own else None
        try:
            environment = interpreter.worker_environment(python, bytecode)
            child = subprocess.Popen(command, env=environment, stdin=subprocess.PIPE)
        except OSError as error:
            if only_takes and not is_own:  # they need nothing but NumPy
                return self.capture(sys.executable)
            raise OptionError(
                f"cannot start the Python '{python}' ({error.strerror or error}); choose another one "
                f"{self.host.python_is_chosen}"
            ) from error
        try:
            return child.wait()
        finally:  # it ends once its stdin does
            child.communicate()

    def look(self, *, again: bool = False) -> Iterator[tuple[Task, Result, bool]]:
        """Each task, its entry of the report as it is now, and whether files have to be made of its take, as
        they all have with `again`."""
        key, formats, overwrite = self.exports.key, self.exports.formats, self.args.overwrite
        for task, result in zip(self.tasks, read_results(self.output, self.tasks), strict=True):
            left = False
            if result.status == "ok":
                exported = Exported(task, self.output, key)
                exported.fill_in(result)
                try:
                    left = bool(exported.left(formats, again=again, overwrite=overwrite))
                    result.status = "pending" if left else "ok"
                except HandfitError as error:  # which the process that is to make them tells
                    left, result.status, result.error = True, "failed", str(error)
            yield task, result, left

    def tell(self) -> int:
        count, again, retried = 0, self.args.again, self.args.again or self.args.retry_failed
        for task, result, left in self.look(again=again):
            status, said = "done" if result.status == "ok" else "to do", task.error
            if result.status == "failed" and left:
                status, said = "failed", result.error
            elif result.is_final and not retried:
                status, said = "failed", f"{result.error}; --retry-failed tries it again"
            count += status == "to do"
            print(f"{status:8} {task.shown} -> {task.folder(self.output)}{said and f': {said}'}")
        print(f"{count} of {len(self.tasks)} to do")
        return EXIT_OK

    def export(self) -> bool:
        """Have files made of all takes, and write the report anew. Returns whether all of it succeeded."""
        progress, errors = Progress(self.output, self.tasks, "none"), dict[str, str]()
        tasks = [task for task, _, left in self.look(again=self.args.again) if left]
        try:
            self._make_files(tasks, errors)
        finally:
            for task, result, _ in self.look():
                if error := errors.get(task.name):
                    result.status, result.error = "failed", error
                    tell(task, error, self.args.progress)
                progress.results[task.key] = result
            progress.close()
        return not progress.trouble and all(result.status == "ok" for result in progress.results.values())

    def _make_files(self, tasks: Sequence[Task], errors: dict[str, str]) -> None:
        """Have processes make files of takes, each of its share; `errors` gets why takes failed, by their
        names. A take at which a process dies is tried once more at the end, alone."""
        jobs = min(self.args.jobs or usable_jobs(), len(tasks))
        shares, crashed = [tasks[i::jobs] for i in range(jobs)], list[Task]()
        while shares:
            logs = self._logs_of_processes(shares)
            errors |= {name: error for log in logs for name, error in log.items() if error}
            rest = []
            for share, log in zip(shares, logs, strict=True):
                crashed += [task for task in share if log.get(task.name, "") is None]
                rest.append([task for task in share if task.name not in log])
            if rest == shares:
                why = "the Blender that is to make files ends at once; try --debug"
                errors |= {task.name: why for share in rest for task in share}
                break
            shares = [share for share in rest if share]
        for task in crashed:
            (log,) = self._logs_of_processes([[task]])
            crash = "Blender crashed twice while it made files of it; try again with --debug"
            errors[task.name] = crash if (error := log.get(task.name)) is None else error

    def _logs_of_processes(self, shares: Sequence[Sequence[Task]]) -> list[dict[str, str | None]]:
        """Have a process make files of each share. What they have logged: by the names of the takes that were
        begun, what was wrong, empty where nothing was, or None where the process has died of it."""
        common = {"given": self.exports.given, "output": str(self.output)}
        said = None if self.args.debug else subprocess.DEVNULL
        with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
            jobs = [Path(folder, f"{number}.json") for number in range(len(shares))]
            children = []
            for job, share in zip(jobs, shares, strict=True):
                job.write_text(json.dumps({**common, "tasks": [asdict(task) for task in share]}))
                children.append(subprocess.Popen([*self.host.command, EXPORT, str(job)], stderr=said))
                stack.callback(children[-1].wait)
                stack.callback(children[-1].kill)
            codes = [child.wait() for child in children]
            return [self._log_of(job, code) for job, code in zip(jobs, codes, strict=True)]

    def _log_of(self, job: Path, code: int) -> dict[str, str | None]:
        lines = job.with_suffix(".log").read_text() if job.with_suffix(".log").exists() else ""
        log = {entry["name"]: entry.get("error") for entry in map(json.loads, lines.splitlines())}
        if code == EXIT_SOME_FAILED and (limit := self.args.timeout):
            late = f"to make files of it took longer than {limit:g} seconds (--timeout)"
            log = {name: late if error is None else error for name, error in log.items()}
        return log
