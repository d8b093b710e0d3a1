"""Two cameras: both clips in the panel, the verdict, two plates, and the view switched."""

from __future__ import annotations

import bpy

from scenarios.capturing import begin, done, finish, hands, part
from scenarios.panels import opened_by_default


def chosen(stage, source, second):
    """Choose both clips; the panel tells of both."""
    settings, info = bpy.context.scene.manient, part("session.source_info")
    settings.source, settings.second_view = str(source), str(second)
    described = lambda: all(info.of(settings, field).fps for field in info.VIEWS)  # noqa: E731
    yield from stage.until(described, 60.0, "the rates of both clips")
    yield from stage.leave_popups()


def _cameras():
    captures = part("scene.captures")
    capture = captures.active_capture(bpy.context.scene)
    return captures.cameras_of(capture) if capture is not None else []


def _seen_through():
    """The name of the scene's camera, which has its own picture behind it."""
    camera = bpy.context.scene.camera
    assert camera in _cameras()
    (plate,) = camera.data.background_images
    assert plate.image is not None
    assert plate.show_background_image
    return camera.name


def captured(stage, source, second):
    """Chosen, captured and called good; the button leads to the second view's camera, through which the hand
    lies on its picture, too, and back; undone and redone, saved and opened again."""
    with opened_by_default("MANIENT_PT_source", "MANIENT_PT_result"):
        yield from stage.open_sidebar()
        yield from chosen(stage, source, second)
        yield from stage.screenshot("views-chosen")
        job = yield from begin(stage, source, second_view=str(second))
        yield from stage.until(lambda: job.stage == "detect" and job.done >= 20, 60.0, "twenty frames")
        yield from stage.screenshot("views-capturing")
        yield from finish(stage, job, timeout=300.0)
        done(job)
        first, other = (camera.name for camera in _cameras())
        assert job.views_message.endswith("good"), job.views_message
        bpy.context.scene.frame_set(40)
        for name, shot in ((first, "first"), (other, "second"), (first, "")):
            assert _seen_through() == name
            if shot:
                yield from stage.screenshot(f"views-{shot}")
                yield from stage.press_button("bpy.ops.manient.switch_view(")
        yield from stage.undo()
        assert _seen_through() == other
        yield from stage.redo()
        assert _seen_through() == first
        yield from stage.reopen(f"{source}.blend")
        assert len(hands()) == 1
        yield from stage.open_sidebar()
        yield from stage.invoke("manient.switch_view")
        assert _seen_through() == other
