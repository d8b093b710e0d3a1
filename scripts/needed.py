"""A sentence in place of a traceback where a script runs in a Python without the packages that it needs."""

from __future__ import annotations

import importlib.util
import sys


def need(package: str, command: str) -> None:
    """End the script where the package cannot be imported. `command` is what sets it up."""
    if importlib.util.find_spec(package) is None:
        sys.exit(f"error: {sys.executable} has no {package}; run `{command}`, which sets up what is needed")
