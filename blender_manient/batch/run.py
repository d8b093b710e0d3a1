"""The commands of a batch: inputs become takes, and takes become files.

Both steps are `python -m handfit_core batch`, a child in the Python that captures. In the second one it has
Blenders turn takes into files (`exports.py`). The process that runs here stays light.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from dataclasses import dataclass, replace

from handfit_core.capturing.options import CaptureOptions, options_of
from handfit_core.common.errors import HandfitError, OptionError
from handfit_core.tasks.arguments import EXPORTS, WITH_PARENT, BatchOptions
from handfit_core.tasks.inputs import expand
from handfit_core.worker import interpreter

from ..session import shared_worker
from .commands import EXIT_INTERRUPTED, EXIT_OK, EXIT_SOME_FAILED, EXIT_USAGE, EXPORT
from .console import blender_silenced, print_error, show_all_names, stopped_by_signals
from .exports import Exports, export, start_empty


@dataclass(frozen=True)
class Host:
    """The command line that is running: the differences between the script and the installed add-on."""

    command: tuple[str, ...]
    """The command that starts another such command line, without the name of the command"""
    python: str | None = None
    """The Python that captures where --python names none; None: as `find_python` chooses"""
    threads: int | None = None
    """How many threads a capture may use; None: its own choice"""
    python_is_chosen: str = f"with --python or in ${interpreter.PYTHON_VARIABLE}"
    """Part of a sentence: where the user names the Python that captures"""
    keep_addons: bool = False
    """True if add-ons and preferences stay as they are; else the run is under Blender's factory settings"""


def run(args: argparse.Namespace, host: Host) -> int:
    """Run the command that parsed arguments (arguments.py) ask for. Returns the exit code; raises nothing."""
    show_all_names()
    with stopped_by_signals():
        try:
            if args.command == EXPORT:
                export(keep_addons=host.keep_addons)
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
    """Have the core do both steps of the batch. Raises HandfitError where nothing can be tried."""
    exports = Exports.of_arguments(args)
    if exports.character is not None:  # before hours of work for nothing
        with blender_silenced(args.debug):
            start_empty(keep_addons=host.keep_addons)
            used = exports.character.check()
        exports = replace(exports, given={**exports.given, "bones": exports.given["bones"] or used})
    for options in (CaptureOptions, BatchOptions):  # what is wrong with them is told before a process starts
        options.of_arguments(args)
    code = _do(args, host, exports, interpreter.find_python(args.python or host.python))
    if code == interpreter.EXIT_UNFIT:
        raise OptionError(f"choose another Python {host.python_is_chosen}: this one cannot capture")
    if code not in (EXIT_OK, EXIT_SOME_FAILED, EXIT_USAGE, EXIT_INTERRUPTED):
        print_error(f"the process that captures ended with code {code}")
        return EXIT_SOME_FAILED
    return code


def _do(args: argparse.Namespace, host: Host, exports: Exports, python: str) -> int:
    """Have the core make takes, and Blenders files of them. Returns the core's exit code. Raises OptionError
    where it cannot be started."""
    is_own = interpreter.is_current_interpreter(python)
    declared = [*options_of(CaptureOptions).values(), *options_of(BatchOptions).values()]
    given = {option.flag: getattr(args, option.dest) for option in declared}
    given |= {"--output": args.output, "--progress": args.progress, "--debug": args.debug}
    given["--processes"] = args.processes or host.threads
    given[EXPORTS] = json.dumps(
        {
            "command": [*host.command, EXPORT],
            "environment": {name: text for name, text in os.environ.items() if name.startswith("PYTHON")},
            "given": exports.given,
            "formats": exports.formats,
            "key": exports.key,
        }
    )
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
        inputs = [each for text in args.inputs for each in expand(text, args.grouping)]
        if all(each.take for each in inputs) and not is_own:  # they need nothing but NumPy
            return _do(args, host, exports, sys.executable)
        raise OptionError(
            f"cannot start the Python '{python}' ({error.strerror or error}); choose another one "
            f"{host.python_is_chosen}"
        ) from error
    try:
        return child.wait()
    finally:  # it ends once its stdin does
        child.communicate()
