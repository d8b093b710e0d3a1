"""Where a batch runs: what differs between the script and the installed add-on."""

from __future__ import annotations

from dataclasses import dataclass

from handfit_core.worker.interpreter import PYTHON_VARIABLE


@dataclass(frozen=True)
class Host:
    """The command line that is running."""

    command: tuple[str, ...]
    """What starts another one like it, but for the name of the command"""
    python: str | None = None
    """Captures where --python names none; None: as `find_python` chooses"""
    threads: int | None = None
    """How many a capture may use; None: its own choice"""
    python_is_chosen: str = f"with --python or in ${PYTHON_VARIABLE}"
    """Part of a sentence: where the user names the Python that captures"""
    keep_addons: bool = False
    """Whether add-ons and preferences stay as they are; else the run is under Blender's factory settings"""
