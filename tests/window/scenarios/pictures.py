"""What docs/artists.md shows."""

from __future__ import annotations

import math

import addon_utils
import bpy
from stage import ADDON

from scenarios.adding import posed
from scenarios.capturing import begin, done, finish, hands
from scenarios.finding import HER_LEFT_HAND, begun, boxed_around, mode, tag_of
from scenarios.panels import sections
from scenarios.refine import INDEX_TIP, places, state


def tour(stage, folder, source, edited_frame=12):
    """The whole way, with a picture of every station. `source` lies in `folder`, as does the .blend."""
    bpy.ops.wm.save_as_mainfile(filepath=f"{folder}/scene.blend")
    _open_all_sections()
    yield from stage.open_sidebar()
    yield from stage.move_to(stage.region())
    yield 0.3
    yield from stage.screenshot("empty")

    source = f"//{source}"
    bpy.context.scene.manient.source = source
    yield 1.5
    job = yield from begin(stage, source)
    yield from stage.until(lambda: job.stage == "detect" and job.done >= 8, 60.0, "eight frames")
    yield from stage.screenshot("capturing")
    yield from finish(stage, job)
    done(job)
    yield 1.0
    bpy.context.scene.frame_set(edited_frame)
    yield from stage.leave_popups()
    yield 12.0  # until Blender's message in the status bar is gone
    yield from stage.screenshot("captured")

    (armature,) = hands()
    armature.manient.show_confidence = True
    bpy.context.scene.frame_set(edited_frame)
    yield 0.5
    yield from stage.screenshot("confidence")
    armature.manient.show_confidence = False
    yield 0.3
    yield from _drag_a_fingertip(stage)
    yield from stage.invoke("manient.touch")
    yield 0.5
    yield from stage.screenshot("touch")
    yield from stage.key("ESC")
    yield 0.3
    return {"hands": len(hands())}


def choosing(stage, folder, source):
    """The mouse is over the tag of one of the painting's hands; then a box is drawn around that hand."""
    bpy.ops.wm.save_as_mainfile(filepath=f"{folder}/painting.blend")
    yield from stage.open_sidebar()
    yield from begun(stage, f"//{source}")
    (left,) = [hand for hand in mode().choice.hands if hand.side == "left"]
    yield from stage.move_to(tag_of(left))
    yield from stage.screenshot("find")
    yield from stage.key("X")
    yield from boxed_around(stage, HER_LEFT_HAND, shot="box")
    yield from stage.key("ESC")


def placing(stage, folder, source, points):
    """A drawn hand is laid into its picture and posed by some points, as `adding.posed` takes them."""
    bpy.ops.wm.save_as_mainfile(filepath=f"{folder}/drawing.blend")
    return (yield from posed(stage, f"//{source}", "right", points))


def _drag_a_fingertip(stage):
    with stage.override():
        bpy.ops.manient.edit_keypoints("INVOKE_DEFAULT")
    yield 1.0
    yield from stage.until(lambda: not state()["warming"], 60.0, "the worker to be warm")
    x, y = places()[INDEX_TIP]
    path = [
        (x + 45 * math.sin(0.5 * math.pi * i / 20), y - 60 * (1 - math.cos(0.5 * math.pi * i / 20)))
        for i in range(21)
    ]
    yield from stage.drag(path, pause=0.1)
    yield from stage.until(lambda: state()["dragged"] is None, 20.0, "the last fit")
    yield 1.0
    yield from stage.screenshot("keypoints")
    yield from stage.key("RET")
    yield 0.5


def _open_all_sections():
    """The tab as it looks when the artist has opened every section once; their subsections stay closed."""
    shown = sections()
    for cls in reversed(shown):
        bpy.utils.unregister_class(cls)
    for cls in shown:
        if not hasattr(cls, "bl_parent_id"):
            cls.bl_options = set()
        bpy.utils.register_class(cls)
    assert addon_utils.check(ADDON)[1]
