"""`blender --command manient`: the installed add-on without a window; docs/batch.md describes it.

Neither NumPy nor handfit_core is imported before a command runs, so that a damaged installation can say what
is wrong with it.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import bpy

from .batch.commands import COMMANDS, EXIT_INTERRUPTED, EXIT_OK, EXIT_SOME_FAILED, EXIT_USAGE
from .batch.console import print_error, show_all_names, stopped_by_signals
from .common import installation

NAME = "manient"

_DEFAULT_PYTHON = "the preferences', else $HANDFIT_PYTHON, else Blender's own"
_handle: Any = None
"""The handle that Blender gave for the registered command; None while there is none"""


def main(argv: Sequence[str]) -> int:
    """Run `manient ARGV`; returns the exit code, raises nothing."""
    show_all_names()
    debug = "--debug" in argv
    if installation.why_not and argv[:1] and argv[0] in COMMANDS:  # their very options are the core's
        print_error(installation.why_not)
        return EXIT_SOME_FAILED
    try:
        args = _parser(argv).parse_args(argv)
        return _check(args) if args.command == "check" else _run_batch(args)
    except SystemExit as ended:  # --help, or wrong options; both have printed what there is to say
        return ended.code if isinstance(ended.code, int) else EXIT_USAGE
    except (ImportError, SyntaxError):  # files that are needed first here are gone or damaged
        print_error(installation.NOT_WHOLE, debug)
    except Exception as error:  # a defect of ours: still one line
        print_error(f"unexpected {type(error).__name__}: {error}", debug)
    return EXIT_SOME_FAILED


def _parser(argv: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser of the command line; it has the options of a batch, which the core knows, only where
    one is asked for."""
    parser = argparse.ArgumentParser(
        prog=f"blender --command {NAME}", description="Manient Hand Capture without a window."
    )
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    if argv[:1] and argv[0] in COMMANDS:
        # Needs handfit_core, whose absence another command has to explain.
        from .batch.arguments import add_commands

        add_commands(commands, argv[:1], default_python=_DEFAULT_PYTHON)
    else:
        for name, said in COMMANDS.items():
            commands.add_parser(name, help=said)
    check = commands.add_parser(
        "check",
        help="check the installation",
        description="Try the Python that captures, and print versions. Ends with 0 if all is well.",
    )
    check.add_argument("--python", metavar="PATH", help=f"Python that captures (default: {_DEFAULT_PYTHON})")
    check.add_argument("--debug", action="store_true", help="show tracebacks")
    check.set_defaults(command="check")
    return parser


def _run_batch(args: argparse.Namespace) -> int:
    # All of these need handfit_core or NumPy.
    from handfit_core.worker.interpreter import PYTHON_VARIABLE

    from .batch.run import Host, run
    from .common import preferences

    chosen = preferences.get()
    host = Host(
        command=_own_command(),
        python=preferences.full_path(chosen.python) or None,
        threads=chosen.threads or None,
        python_is_chosen=f"with --python, in ${PYTHON_VARIABLE} or in the add-on's preferences",
        keep_addons=True,
    )
    return run(args, host)


def _own_command() -> tuple[str, ...]:
    """Return the words that start Blender with this command once more.

    Where Blender is a Python module, they start that module, which may hang while the interpreter shuts down
    after an export: the process ends without that."""
    if bpy.app.binary_path:
        told = sys.argv[1 : sys.argv.index("--command")] if "--command" in sys.argv else []
        return (bpy.app.binary_path, *told, "--command", NAME)
    addon = __name__.rpartition(".")[0]
    where = "" if "." in addon else f"sys.path.insert(0, {str(Path(__file__).resolve().parents[1])!r}); "
    code = (
        f"import bpy, os, shutil, sys, addon_utils; {where}addon_utils.enable({addon!r}); "
        f"from importlib import import_module; code = import_module({__name__!r}).main(sys.argv[1:]); "
        "shutil.rmtree(bpy.app.tempdir, ignore_errors=True); "
        "sys.stdout.flush(); sys.stderr.flush(); os._exit(code)"
    )
    return (sys.executable, "-c", code)


def _check(args: argparse.Namespace) -> int:
    if installation.why_not:
        print_error(installation.why_not)
        print(installation.without_home(f"{installation.versions()}\n{installation.details}"))
        return EXIT_SOME_FAILED
    # Needs handfit_core.
    from .operators.base import finish
    from .operators.check_installation import WHOLE, checking

    with stopped_by_signals():
        try:
            sentence, text = finish(checking(args.python))
            print(text, end="")
            return EXIT_OK if sentence == WHOLE else EXIT_SOME_FAILED
        except KeyboardInterrupt:
            print("stopped", file=sys.stderr)
            return EXIT_INTERRUPTED


def register() -> None:
    """Add the command `manient` to Blender's command line."""
    global _handle
    _handle = bpy.utils.register_cli_command(NAME, main)


def unregister() -> None:
    """Take the command `manient` away again."""
    global _handle
    if _handle is not None:
        bpy.utils.unregister_cli_command(_handle)
    _handle = None
