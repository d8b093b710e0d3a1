"""What the sidebar says: long names, failures that are over, a missing Python."""

from __future__ import annotations

from contextlib import contextmanager

import bpy

from scenarios.capturing import begin, capture, finish, hands, jobs, part
from scenarios.panels import opened_by_default, sections


def long_names(stage, source, broken):
    """A capture that fails, and one with a long name that succeeds; every line of text in the sidebar after
    each."""
    yield from stage.open_sidebar()
    failed = yield from begin(stage, broken)
    yield from finish(stage, failed)
    yield from stage.leave_popups()
    yield from stage.screenshot("words-failed")
    first = [(job.name, job.state, job.message) for job in jobs()]
    yield from capture(stage, source)
    yield from stage.leave_popups()
    with texts() as shown:
        yield from stage.screenshot("words-long-names")
    (armature,) = hands()
    return {
        "first": first,
        "then": [(job.name, job.state) for job in jobs()],
        "shown": shown,
        "hand": armature.name,
        "mesh": part("scene.store").hand_of(armature).mesh.name,
        "camera": bpy.context.scene.camera.name,
    }


@contextmanager
def texts():
    """A list that gets all texts and properties which the sections draw, each once, in their order."""
    shown: list[str] = []

    def collect(parts) -> None:
        for item in parts:
            for text in (item.get("draw_string"), item.get("rna")):
                if text and text not in shown:
                    shown.append(text)
            collect(item.get("items", ()))

    def listening(draw):
        def drawn(panel, context):
            draw(panel, context)
            collect(panel.layout.introspect())

        return drawn

    originals = {cls: cls.__dict__["draw"] for cls in sections()}
    try:
        for cls, draw in originals.items():
            cls.draw = listening(draw)
        yield shown
    finally:
        for cls, draw in originals.items():
            cls.draw = draw


def shapes(stage, source):
    """The sliders of a captured hand's shape, with all sections open."""
    with opened_by_default():
        yield from capture(stage, source)
        bpy.context.view_layer.objects.active = hands()[0]
        yield from stage.open_sidebar()
        region = stage.region("UI")
        yield from stage.move_to((region.x + region.width / 2, region.y + region.height / 2))
        for _ in range(40):
            yield from stage.key("WHEELDOWNMOUSE")
        with texts() as shown:
            yield from stage.screenshot("words-shapes")
    return shown
