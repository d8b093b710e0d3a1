"""The hand's curves and its error in Blender's time editors."""

from __future__ import annotations

import bpy
import numpy as np

from scenarios.capturing import capture, hands, pixels_of


def curves_and_error(stage, source):
    """In Pose mode, all curves of the hand in view; then the error's graph is switched on.

    Returns the share of the editor's height that the curves fill, and how many pixels of the screen the
    graph changed.
    """
    yield from stage.open_sidebar()
    yield from capture(stage, source)
    (armature,) = hands()
    with stage.override():
        bpy.ops.object.mode_set(mode="POSE")
        bpy.ops.pose.select_all(action="SELECT")
    yield 0.3
    area = stage.area()
    area.type = "GRAPH_EDITOR"
    yield 0.5
    region = stage.region("WINDOW", "GRAPH_EDITOR")
    with bpy.context.temp_override(window=stage.window, area=area, region=region):
        bpy.ops.graph.view_all()
    yield 0.8
    low, high = (region.view2d.region_to_view(0, y)[1] for y in (0, region.height))
    curves = [c for c in armature.animation_data.action.fcurves if "rotation" in c.data_path]
    values = np.array([k.co.y for c in curves for k in c.keyframe_points])
    yield from stage.screenshot("curves")
    before = pixels_of(stage.screenshots / "curves.png")
    armature.manient.show_error = True
    yield 0.3
    yield from stage.screenshot("curves-and-error")
    changed = np.abs(pixels_of(stage.screenshots / "curves-and-error.png") - before).max(axis=-1) > 0.05
    rows, columns = slice(region.y, region.y + region.height), slice(region.x, region.x + region.width)
    area.type = "VIEW_3D"
    return {
        "filled": float((values.max() - values.min()) / (high - low)),
        "inside": bool(low < values.min() and values.max() < high),
        "changed_in_graph": int(changed[rows, columns].sum()),
        "changed_in_timeline": int(changed[: stage.area("DOPESHEET_EDITOR").height].sum()),
    }
