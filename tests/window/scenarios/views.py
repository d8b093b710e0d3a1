"""Two cameras: both clips in the panel, the verdict, two plates, and the view switched."""

from __future__ import annotations

import bpy
import numpy as np

from scenarios.capturing import assert_sentence, begin, changed, done, finish, hands, part, pose_at
from scenarios.panels import opened_by_default
from scenarios.refine import INDEX_TIP, dragged, edited, ended, operator, places, warmed


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
    lies on its picture, too, and back; undone and redone, saved and opened again. Edit Keypoints shows its
    points over both pictures."""
    with opened_by_default("MANIENT_PT_advanced", "MANIENT_PT_result"):
        yield from stage.open_sidebar()
        yield from chosen(stage, source, second)
        yield from stage.screenshot("views-chosen")
        job = yield from begin(stage, source, second_view=str(second))
        yield from stage.until(
            lambda: job.progress.stage == "detect" and job.progress.done >= 20, 60.0, "twenty frames"
        )
        yield from stage.screenshot("views-capturing")
        yield from finish(stage, job, timeout=300.0)
        done(job)
        first, other = (camera.name for camera in _cameras())
        assert job.result.views_message.endswith("good"), job.result.views_message
        bpy.context.scene.frame_set(40)
        for name, shot in ((first, "first"), (other, "second"), (first, "")):
            assert _seen_through() == name
            if shot:
                yield from stage.screenshot(f"views-{shot}")
                yield from stage.press("bpy.ops.manient.switch_view(", along=0.4)
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
        yield from _points_shown(stage, hands()[0])


def _points_shown(stage, armature):
    """V shows the points over the other picture, in the second clip's own frame, where a drag takes none of
    them; one in the first picture moves the hand in both."""
    mode = lambda: operator().current  # noqa: E731
    bpy.context.scene.camera = part("scene.store").hand_of(armature).camera
    bpy.ops.ed.undo_push(message="Camera")
    before = {frame: pose_at(armature, frame) for frame in (5, 20)}
    yield from edited(stage, armature, frame=20)
    first, fitted = places(), mode().refiner.shown_landmarks(1)
    yield from stage.key("V")
    yield from stage.until(lambda: mode().looking == 1, 3.0, "the second view")
    yield from warmed(stage)
    second = places()
    assert np.linalg.norm(np.array(second[INDEX_TIP]) - first[INDEX_TIP]) > 20.0
    row, seen = mode().shown_row(1), mode().refiner.track.seen_by[0]
    np.testing.assert_array_equal(mode().picture_places(), seen.keypoints_2d[row])
    yield from stage.screenshot("second_view")
    yield from stage.move_to(second[INDEX_TIP])
    yield 0.2
    assert mode().hovered is None
    yield from stage.undo()  # back to the first view
    yield from stage.until(lambda: mode().looking == 0, 3.0, "the first view")
    x, y = places()[INDEX_TIP]
    yield from dragged(stage, [(x - 2 * i, y - 3 * i) for i in range(1, 16)])
    assert changed(bpy.context.object, before) == [20]
    assert np.linalg.norm(mode().refiner.shown_landmarks(1) - fitted, axis=1)[INDEX_TIP] > 2.0
    yield from stage.key("V")
    yield from stage.until(lambda: mode().looking == 1, 3.0, "the second view again")
    yield 0.3
    yield from stage.screenshot("second_view_after")
    yield from ended(stage)
    assert bpy.context.scene.camera.name == "camera of clip1_b"


def told(stage, source, second, rig):
    """A frame of each view, typed beside its picture, tells the offset; a calibration of other cameras is
    refused in a sentence that names it."""
    settings = bpy.context.scene.manient
    with opened_by_default("MANIENT_PT_advanced"):
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
        assert abs(info.chosen_offset(settings) - (30 - 39) / info.of(settings).fps) < 1e-4
        job = yield from begin(stage, source, second_view=str(second), cameras=str(rig))
        yield from finish(stage, job)
        assert job.state == "failed"
        assert_sentence(job.result.message)
        assert "rig.toml" in job.result.message
        yield from stage.screenshot("views-refused")
