"""The pictures of docs/artists.md: from the empty panel to a corrected hand, with tidy names."""

from __future__ import annotations

from pathlib import Path

import bpy

from scenarios import panels, refine
from scenarios.capturing import begin, done, finish, hands


def pictures(stage, source):
    """Take them, of a clip that lies in a folder of its own; what it returns names them in order."""
    opened = panels.opened_by_default()
    try:
        taken = yield from _pictures(stage, source)
    finally:
        panels.closed_again(opened)
    yield from panels.preferences(stage)
    return [*taken, "preferences"]


def _pictures(stage, source):
    taken = []

    def picture(name):
        taken.append(name)
        return stage.screenshot(name)

    folder = Path(source).parent
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "hands.blend"))
    yield from stage.open_sidebar()
    panel = bpy.context.scene.manient
    panel.source = f"//{Path(source).name}"
    yield 3.0  # the worker looks into the file
    yield from picture("tour-source")
    job = yield from begin(stage, panel.source)
    yield from stage.until(
        lambda: job.done > job.total / 3 > 0 and job.rate > 0, 60.0, "a third of the frames"
    )
    yield from picture("tour-capturing")
    yield from finish(stage, job)
    done(job)
    yield 8.0  # Blender's report in the status bar fades
    yield from stage.look_through_camera()
    bpy.context.scene.frame_set(30)
    yield from picture("tour-captured")
    (armature,) = hands()
    armature.manient.show_confidence = True
    yield from picture("tour-confidence")
    armature.manient.show_confidence = False

    yield from stage.invoke("manient.edit_keypoints")
    yield from stage.until(lambda: refine.places() and not refine.state()["warming"], 60.0, "a warm worker")
    yield from picture("tour-keypoints")
    start = refine.places()[refine.INDEX_TIP]
    path = [(start[0] + 4 * i, start[1] - i) for i in range(12)]
    yield from refine.dragged(stage, path)
    yield 0.5
    yield from picture("tour-dragged")
    yield from stage.key("RET")
    yield from stage.until(lambda: not refine.operator().running(), 5.0, "the mode to end")

    region = stage.region("UI")
    yield from stage.move_to((region.x + region.width / 2, region.y + region.height / 2))
    for _ in range(40):
        yield from stage.key("WHEELDOWNMOUSE")
    yield from stage.move_to(stage.region())
    yield 0.5
    yield from picture("tour-shape-and-export")
    return taken
