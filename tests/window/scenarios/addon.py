"""The add-on comes and goes."""

from __future__ import annotations

import addon_utils
import bpy
from stage import ADDON

from scenarios.traces import traces


def disabled_leaves_nothing(stage, take):
    """Enabled, used, disabled, three times over; then what is left."""
    left = []
    for _ in range(3):
        if not addon_utils.check(ADDON)[1]:
            addon_utils.enable(ADDON, default_set=True)
        assert "classes" in traces(), "the add-on registered nothing"
        assert bpy.ops.manient.import_take(filepath=take) == {"FINISHED"}
        yield from stage.open_sidebar()
        addon_utils.disable(ADDON, default_set=True)
        yield 0.5
        stage.meter.reset()
        for area in stage.window.screen.areas:
            area.tag_redraw()
        yield 0.5
        left.append({**traces(), **{name: ["still called"] for name in stage.meter.calls}})
    return left


def survives_reloading_scripts(stage, take):
    """Blender's own Reload Scripts: everything once again, nothing twice."""
    yield from stage.open_sidebar()
    before = traces()
    bpy.ops.script.reload()
    yield 1.0
    after = traces()
    yield from stage.open_sidebar()
    assert bpy.ops.manient.import_take(filepath=take) == {"FINISHED"}
    yield 0.2
    return before, after
