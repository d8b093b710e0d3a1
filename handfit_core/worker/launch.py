"""Starts handfit_core in a Python of the user's own: `PYTHON launch.py ARGUMENT...`.

handfit_core may lie among packages for Blender's Python. It is imported from its folder by name, so that
nothing beside it comes into reach: NumPy, SciPy and the others are that Python's own.

An older Python must be able to read this file, to be told that it is too old.
"""

import os
import platform
import runpy
import sys

LOWEST = (3, 11)
EXIT_UNFIT = 77
"""Exit code of a Python that cannot capture, as in interpreter.py, which cannot be imported yet"""


def main():
    """Run handfit_core's command line, which ends the process, or return the exit code of an unfit Python."""
    here = os.path.dirname(os.path.abspath(__file__))  # noqa: PTH100, PTH120
    # Python puts a script's folder first; the modules in this one have names that anybody may use.
    sys.path[:] = [path for path in sys.path if os.path.abspath(path) != here]  # noqa: PTH100
    if sys.version_info < LOWEST:
        message = "is version {}, and capturing needs {} or newer\n"
        sys.stderr.write(message.format(platform.python_version(), "{}.{}".format(*LOWEST)))
        return EXIT_UNFIT
    try:
        import_package("handfit_core", os.path.dirname(here))  # noqa: PTH120
        setattr(sys.modules["handfit_core"], "brought_by_launcher", True)  # noqa: B010
        runpy.run_module("handfit_core", run_name="__main__", alter_sys=True)
    except ImportError as error:  # while it loads; the command line catches its own
        sys.stderr.write(f"cannot capture ({error})\n")
        return EXIT_UNFIT


def import_package(name, folder):
    """Import the package `name` from its folder, without what lies beside it."""
    # Python 2, which has to read this file, lacks it.
    from importlib import util

    file = os.path.join(folder, "__init__.py")  # noqa: PTH118
    spec = util.spec_from_file_location(name, file, submodule_search_locations=[folder])
    if spec is None or spec.loader is None:
        raise ImportError("there is no package in " + folder)
    module = util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)


if __name__ == "__main__":
    sys.exit(main())
