"""Check Installation: the Python that captures is used once; versions go into a text for bug reports."""

from __future__ import annotations

from collections.abc import Generator

import bpy

from handfit_core.common.errors import HandfitError
from handfit_core.worker.interpreter import is_current_interpreter

from ..common import installation, screen
from ..common.wording import capitalised
from ..session import details, shared_worker
from .base import InternalOperator, StepsOperator

TEXT_NAME = "Hand Capture Check"
WHOLE = "Everything works"
_OTHER_REMEDIES = "try again", "restart Blender"
"""Advice in errors of a process that was killed or slow, and of an update; a new installation does not mend
these"""


class MANIENT_OT_check_installation(StepsOperator, bpy.types.Operator):
    """Try the Python that captures, and write the result and versions into a text that can be copied into a
    bug report."""

    bl_label = "Check Installation"
    bl_options = InternalOperator.bl_options
    title = "The check"
    undone = "An undo stopped the check: begin it again"

    @classmethod
    def poll_reason(cls, context):
        return "The check is running: Esc stops it" if cls.bl_idname in cls.running else None

    def steps(self, context):
        return checking()

    def finished(self, context, result):
        sentence, text = result
        details.write_text(TEXT_NAME, text)
        screen.redraw("PREFERENCES")
        return self._done(f"{sentence} (text {TEXT_NAME})", kind="INFO" if sentence == WHOLE else "WARNING")


def checking(python: str | None = None) -> Generator[shared_worker.Progress, None, tuple[str, str]]:
    """Try the Python that the preferences choose, or `python`, in a process of its own: the shared one may be
    busy for minutes. Returns `WHOLE` or what is wrong, and the text for a bug report."""
    worker = shared_worker.new_worker(python)
    sentence, said = WHOLE, ""
    try:
        text = "Checking the installation, which takes up to half a minute"
        said = (yield from shared_worker.ask("check", text, worker))["versions"]
    except HandfitError as error:
        sentence = capitalised(str(error))
        said = "\n".join([sentence, *getattr(error, "__notes__", ())])
        remedied = any(remedy in sentence for remedy in _OTHER_REMEDIES)
        if installation.is_installed() and is_current_interpreter(worker.python) and not remedied:
            sentence = installation.NOT_WHOLE
    finally:
        worker.stop()
    parts = [sentence, installation.versions(), f"The Python that captures, {worker.python}:", said]
    return sentence, installation.without_home("\n\n".join(parts) + "\n")
