"""Clear: the temporary files of the add-on go."""

from __future__ import annotations

import bpy

from .. import cache, screen, shared_worker
from .mixins import PollMixin


class MANIENT_OT_clear_cache(PollMixin, bpy.types.Operator):
    bl_idname = "manient.clear_cache"
    bl_label = "Clear"
    bl_description = (
        "Remove the add-on's temporary files. Pictures that the open file shows stay; other files that "
        "show pictures from there lose them"
    )
    bl_options = {"INTERNAL"}  # noqa: RUF012

    @classmethod
    def lacks(cls, _context):
        worker = shared_worker.current()
        busy = worker is not None and worker.busy
        return "A capture uses these files: wait for it or cancel it" if busy else None

    def execute(self, context):
        freed, left = cache.clear()
        kept = f", {left} files in use were kept" if left else ""
        self.report({"INFO"}, f"{freed / 1e6:.1f} MB were freed{kept}")
        screen.redraw("PREFERENCES")
        return {"FINISHED"}
