"""Open Plug-in Folder: where files of the user's own add formats and rigs."""

from __future__ import annotations

import bpy

from handfit_core.errors import OutputError
from handfit_core.files import shown, why

from .. import plugins
from .mixins import errors_reported


class MANIENT_OT_open_plugins(bpy.types.Operator):
    bl_idname = "manient.open_plugins"
    bl_label = "Open Plug-in Folder"
    bl_description = (
        "Open the folder for export formats and rigs of your own, one file each. Updates and removal of the "
        "add-on leave it alone; what is put there is found when the add-on is enabled or Blender starts"
    )
    bl_options = {"INTERNAL"}  # noqa: RUF012

    @errors_reported
    def execute(self, _context):
        """Make it where it is not there yet."""
        folder = plugins.folder()
        try:
            for kind in plugins.KINDS:
                (folder / kind).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{shown(folder)}: the folder cannot be made ({why(error)})") from error
        if not bpy.app.background:
            bpy.ops.wm.path_open(filepath=str(folder))
        self.report({"INFO"}, f"Plug-ins are in {shown(folder)}")
        return {"FINISHED"}
