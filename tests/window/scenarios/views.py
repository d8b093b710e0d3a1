"""Two cameras: both clips in the panel, the verdict, two plates, and the view switched."""

from __future__ import annotations

import bpy

from scenarios import views_edit
from scenarios.capturing import assert_sentence, begin, done, finish, hands, part
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
    lies on its picture, too, and back; undone and redone, saved and opened again, and edited."""
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
        yield from stage.screenshot("views-reopened")
        yield from views_edit.dragged_in_the_second(stage, hands()[0])


def told(stage, source, second, rig):
    """A frame of each view, typed beside its picture, tells the offset; a calibration of other cameras is
    refused in a sentence that names it."""
    settings = bpy.context.scene.manient
    with opened_by_default("MANIENT_PT_source", "MANIENT_PT_second_view", "MANIENT_PT_capture"):
        yield from stage.open_sidebar()
        yield from chosen(stage, source, second)
        yield from stage.screenshot("views-advanced")
        settings.use_offset = settings.use_pair = True
        settings.pair = 31, 24
        yield 0.5
        info = part("session.source_info")
        pictured = lambda: [info.of(settings, field).picture for field in info.VIEWS]  # noqa: E731
        yield from stage.until(lambda: all(pictured()), 20.0, "a picture of each frame")
        yield 1.0
        yield from stage.screenshot("views-paired")
        before = pictured()
        settings.pair = 31, 40
        yield from stage.until(lambda: pictured()[1] != before[1], 20.0, "another picture")
        assert abs(info.told_offset(settings) - (30 - 39) / info.of(settings).fps) < 1e-4
        job = yield from begin(stage, source, second_view=str(second), cameras=str(rig))
        yield from finish(stage, job)
        assert job.state == "failed"
        assert_sentence(job.message)
        assert "rig.toml" in job.message
        yield from stage.screenshot("views-refused")
