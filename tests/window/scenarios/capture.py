"""Captures through the window: progress, cancelling, queues, undo, files, and what goes wrong."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from pathlib import Path

import bpy
from stage import ADDON

from scenarios.capturing import begin, capture, done, finish, hands, jobs, part, press_capture, summary
from scenarios.panels import opened_by_default
from scenarios.traces import workers


def photo(stage, source):
    """From the empty panel to a hand; undo, redo, save, and open again."""
    yield from stage.open_sidebar()
    yield from stage.screenshot("panel-empty")
    bpy.context.scene.manient.source = source
    yield 1.0
    yield from stage.screenshot("panel-source")
    job = yield from begin(stage, source)
    yield from stage.screenshot("capturing-photo")
    yield from finish(stage, job)
    done(job)
    yield from stage.look_through_camera()
    yield from stage.screenshot("captured-photo")
    before = summary()

    yield from stage.undo()
    undone = len(hands())
    yield from stage.redo()
    yield 0.3
    redone = summary()

    path = str(Path(source).with_name("photo.blend"))
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    yield 0.3
    assert not hands(), "hands in an empty file"
    bpy.ops.wm.open_mainfile(filepath=path)
    yield 0.5
    yield from stage.open_sidebar()
    yield from stage.screenshot("reloaded-photo")
    return {"first": before, "undone": undone, "redone": redone, "reloaded": summary()}


def of_another_program(stage, source, size):
    """Keypoints whose pictures' size is not told: the panel asks for it, and knows no error of the hand."""
    yield from stage.open_sidebar()
    settings = bpy.context.scene.manient
    settings.source = source
    info = part("session.source_info")
    yield from stage.until(lambda: info.of(settings).unsized, 60.0, "the worker to miss a size")
    yield 0.5
    yield from stage.screenshot("size-asked")
    if place := (yield from stage.find_button("bpy.ops.manient.capture(")):
        yield from stage.click(place)
        yield 0.5
    assert not jobs(), "it is captured without a size"
    for index, along in enumerate((0.25, 0.75)):
        place = yield from stage.find_button(f"manient.picture_size[{index}]", along=along)
        assert place is not None, "the panel has no field for the size"
        yield from stage.move_to(place)
        yield from stage.key("RET")
        yield from stage.write(str(size[index]))
        yield from stage.key("RET")
    assert tuple(settings.picture_size) == tuple(size)
    yield 0.5
    yield from stage.screenshot("size-told")
    job = yield from press_capture(stage, source)
    yield from finish(stage, job)
    done(job)
    (armature,) = hands()
    armature.manient.show_confidence = True
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="POSE")
    yield from stage.look_through_camera()
    yield 0.5
    yield from stage.screenshot("error-not-known")
    colors = {tuple(round(c, 2) for c in bone.color.custom.normal) for bone in armature.pose.bones}
    return {"size": part("scene.store").hand_of(armature).take.width, "colors": sorted(colors)}


def by_the_button(stage, source):
    """The mouse on the panel's own buttons: Capture, then the X beside the progress bar."""
    yield from stage.open_sidebar()
    job = yield from press_capture(stage, source)
    yield from stage.until(lambda: job.stage == "detect" and job.done >= 5, 60.0, "five frames")
    place = yield from stage.find_button("bpy.ops.manient.cancel_capture(", along=0.83)
    assert place is not None, "there is no button to cancel"
    yield from stage.click(place)
    yield from finish(stage, job)
    return {"state": job.state, "message": job.message, "frames": [h["frames"] for h in summary()]}


def in_place(stage, source):
    """A double click on Capture; then a click on the button that stands there. Where both are."""
    yield from stage.open_sidebar()
    bpy.context.scene.manient.source = source
    yield from stage.until(
        lambda: part("session.source_info").of(bpy.context.scene.manient).width, 30.0, "its size"
    )
    yield from stage.screenshot("place-before")
    start = yield from stage.find_button("bpy.ops.manient.capture(")
    yield from stage.click(start)
    yield from stage.key("LEFTMOUSE")
    job = yield from stage.until(lambda: next(iter(jobs()), None), 5.0, "the capture to begin")
    yield from stage.key("LEFTMOUSE")
    yield from stage.until(lambda: job.stage == "detect" and job.done >= 5, 60.0, "five frames")
    begun = [len(jobs()), job.stop_button]
    yield from stage.move_to(stage.region())
    yield from stage.screenshot("place-during")
    stop = yield from stage.find_button("bpy.ops.manient.cancel_capture(")
    yield from stage.click(start)
    yield from finish(stage, job)
    return {"start": start, "stop": stop, "begun": begun, "state": job.state, "message": job.message}


def clip(stage, source, shot="video"):
    """A clip: what the progress bar says meanwhile, and what comes of it."""
    yield from stage.open_sidebar()
    job = yield from begin(stage, source)
    seen: list[tuple[str, str, float]] = []
    shots, taking = set(), iter(())
    while not job.finished:
        entry = (job.state, job.stage, round(job.fraction, 3))
        if not seen or seen[-1][:3] != entry:
            seen.append((*entry, job.status()))
        if job.state == "capturing" and job.stage and job.done > 5 and job.stage not in shots:
            shots.add(job.stage)
            taking = stage.screenshot(f"capturing-{shot}-{job.stage}")
        next(taking, None)  # nothing is missed meanwhile
        yield 0.0
    yield from taking
    done(job)
    yield 0.3
    yield from stage.look_through_camera()
    yield from stage.screenshot(f"captured-{shot}")
    return {"seen": seen, "hands": summary(), "message": job.message, "warnings": job.warnings}


def cancelled(stage, source):
    """Esc in the middle: how long until the last frame is looked at and until the finished ones are fitted
    and built, and what was kept."""
    yield from stage.open_sidebar()
    job = yield from begin(stage, source)
    yield from stage.until(lambda: job.stage == "detect" and job.done >= 20, 60.0, "twenty frames")
    frames = job.done
    pressed = time.perf_counter()
    yield from stage.key("ESC")
    stopped, looked_at = 0.0, frames
    while job.state == "capturing":
        if job.stage == "detect" and job.done > looked_at:
            looked_at, stopped = job.done, time.perf_counter() - pressed
        yield 0.0
    fitted = time.perf_counter() - pressed
    yield from finish(stage, job)
    built = time.perf_counter() - pressed
    yield from stage.screenshot("cancelled")
    return {
        "state": job.state,
        "message": job.message,
        "last_frame_s": stopped,
        "fitted_s": fitted,
        "built_s": built,
        "done_then": frames,
        "looked_at": looked_at,
        "total": job.total,
        "hands": summary(),
    }


def queued(stage, sources):
    """Several captures, one after the other. All are asked for in one turn of the main loop, so that the
    first cannot be over before the last is there."""
    yield from stage.open_sidebar()
    for source in sources:
        bpy.context.scene.manient.source = source
        with stage.override():
            bpy.ops.manient.capture("INVOKE_DEFAULT")
    waited, seen = jobs(), set()
    while not all(job.finished for job in waited):
        seen.add(tuple(job.state for job in waited))
        if len(seen) == 2:
            yield from stage.screenshot("queued")
        yield 0.0
    yield 0.3
    for job in waited:
        done(job)
    yield from stage.screenshot("queue-done")
    return {"seen": sorted(seen), "hands": [hand["name"] for hand in summary()]}


def several(stage, sources):
    """A queue into one scene; in the list of captures one is clicked, all are shown, one is removed."""
    with opened_by_default("MANIENT_PT_result"):
        yield from stage.open_sidebar()
        for source in sources:
            bpy.context.scene.manient.source = source
            with stage.override():
                bpy.ops.manient.capture("INVOKE_DEFAULT")
        yield from finish(stage, *jobs(), timeout=150.0)
        yield 0.3
        yield from stage.look_through_camera()
        yield from stage.screenshot("captures-queued")
        seen = [_shown()]
        row = yield from stage.find_button(".manient_capture", along=0.6)
        assert row is not None, "there is no list of captures"
        yield from stage.click(row)
        yield 0.5
        yield from stage.screenshot("captures-first")
        seen.append(_shown())
        yield from stage.undo()
        yield 0.5
        seen.append(_shown())
        yield from stage.redo()
        yield 0.5
        button = yield from stage.find_button("bpy.ops.manient.hide_captures(")
        yield from stage.click(button)
        yield 0.5
        yield from stage.screenshot("captures-all")
        seen.append(_shown())
        yield from stage.click(button)
        yield 0.5
        seen.append(_shown())
        cross = yield from stage.find_button("bpy.ops.manient.remove_capture(", along=0.8)
        assert cross is not None, "no row has an X"
        yield from stage.click(cross)
        yield 0.5
        yield from stage.screenshot("captures-removed")
        assert stage.area().spaces[0].region_3d.view_perspective == "CAMERA"
        seen.append(_shown())
        yield from stage.undo()
        yield 0.5
        seen.append(_shown())
    return seen


def _shown():
    """The captures by name: whether the scene looks through its camera, viewports and renders show it."""
    scene, found = bpy.context.scene, part("scene.captures").captures(bpy.context.scene)
    return {c.name: [scene.camera == c.manient.camera, not c.hide_viewport, not c.hide_render] for c in found}


def worker_killed(stage, source):
    """The worker dies in the middle; the next capture has a new one."""
    yield from stage.open_sidebar()
    job = yield from begin(stage, source)
    yield from stage.until(lambda: job.stage == "detect" and job.done >= 10, 60.0, "ten frames")
    ((worker, _),) = workers()
    os.kill(worker, signal.SIGKILL)
    yield from finish(stage, job, timeout=10.0)
    yield from stage.screenshot("failed")
    reports = yield from stage.reports()
    again = yield from capture(stage, source)
    ((other, _),) = workers()
    return {
        "state": job.state,
        "message": job.message,
        "reports": reports,
        "details": [text.as_string() for text in bpy.data.texts],
        "same_worker": worker == other,
        "again": again.state,
        "frames": summary()[0]["frames"],
    }


def undo_in_the_middle(stage, source):
    """The artist works on and undoes while a capture runs."""
    job = yield from begin(stage, source)
    yield from stage.until(lambda: job.stage == "detect" and job.done >= 5, 60.0, "five frames")
    while not job.finished:
        if job.running:
            yield from stage.invoke("mesh.primitive_cube_add")
            yield from stage.undo()
        yield 0.05
    yield 0.2
    done(job)
    if not hands():
        # The capture ended between the last cube and its undo, which therefore took back the capture.
        yield from stage.redo()
    first = summary()
    yield from stage.undo()
    return {"hands": first, "undone": len(hands())}


def another_file_in_the_middle(stage, source):
    """Opening a file ends the capture; the next one works."""
    job = yield from begin(stage, source)
    yield from stage.until(lambda: job.stage == "detect" and job.done >= 5, 60.0, "five frames")
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    yield 1.0
    left = [j.state for j in jobs() if not j.finished]
    yield from stage.move_to(stage.region())
    again = yield from capture(stage, source)
    return {"left": left, "again": again.state, "hands": len(hands())}


def left_running(stage, source):
    """A capture that runs when Blender is quit."""
    job = yield from begin(stage, source)
    yield from stage.until(lambda: job.stage == "detect" and job.done >= 5, 60.0, "five frames")
    return len(workers())


def dropped(stage, source):
    """A file dropped onto the viewport."""
    job = yield from _drop(stage, source, "dropped")
    yield from stage.open_sidebar()
    yield from finish(stage, job)
    done(job)
    captured = summary()
    said = [said_of(job)]
    for step in (stage.undo, stage.undo, stage.redo, stage.redo):
        yield from step()
        shown = part("session.source_info").of(bpy.context.scene.manient)
        if shown.path:
            yield from stage.until(lambda: shown.width, 10.0, "the size of the source")  # noqa: B023
        said.append(said_of(job))
        if step == stage.undo:
            yield from stage.screenshot(f"dropped-undone-{len(said) - 1}")
    return {"hands": captured, "said": said}


def _drop(stage, source, shot):
    """Drop a file and press Capture in the dialog. Returns the job."""
    folder, _, name = source.rpartition("/")
    with stage.override():
        bpy.ops.wm.drop_import_file("INVOKE_DEFAULT", directory=folder, files=[{"name": name}])
    # Blender asks first where it has a use for pictures as well; C is for Capture Hands.
    yield from stage.screenshot(shot)
    yield from stage.key("C")
    yield from stage.screenshot(f"{shot}-dialog")
    assert all(job.finished for job in jobs()), "it began without asking"
    yield from stage.key("RET")
    return (
        yield from stage.until(
            lambda: next((j for j in jobs() if j.name == name), None), 5.0, "the dropped file's capture"
        )
    )


def said_of(job) -> dict:
    """What the panel says of a capture, and what is true."""
    settings = bpy.context.scene.manient
    return {
        "hands": len(hands()),
        "undone": job.undone,
        "source": Path(settings.source).name,
        "shown": Path(part("session.source_info").of(settings).path).name,
    }


def into_the_start_up_scene(stage, source):
    """A clip in the scene that Blender starts with: what the panel says before, and what is true after."""
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    yield 0.5
    yield from stage.move_to(stage.region())
    yield from stage.open_sidebar()
    scene = bpy.context.scene
    scene.manient.source = source
    yield from stage.until(
        lambda: part("session.source_info").of(scene.manient).width, 30.0, "the clip's size"
    )
    yield from stage.screenshot("start-up-scene-before")
    settings, info = scene.manient, part("session.source_info").of(scene.manient)
    footage = part("session.source_info").footage(settings, info)
    told = part("scene.matching").scene_sentence(scene, "AUTO", footage, scene.frame_current)
    job = yield from capture(stage, source)
    yield from stage.screenshot("start-up-scene-after")
    render = scene.render
    size = render.resolution_x, render.resolution_y
    return {
        "told": told,
        "said": job.scene_message,
        "scene": [render.fps, scene.frame_start, scene.frame_end, *size],
        "camera": hands()[0].manient.capture.manient.camera == scene.camera,
    }


def fails(stage, source, shot="", **settings):
    """A capture that must fail: what the artist reads."""
    yield from stage.open_sidebar()
    panel = bpy.context.scene.manient
    panel.source = source
    for name, value in settings.items():
        setattr(panel, name, value)
    yield 0.3
    before = jobs()
    yield from stage.invoke("manient.capture")
    yield 0.3
    new = [job for job in jobs() if job not in before]
    if new:
        yield from finish(stage, new[0])
        assert new[0].state == "failed", f"it is {new[0].state}: {new[0].message}"
    yield from stage.screenshot(f"failed-{shot}")
    reports = yield from stage.reports()
    return {
        "message": new[0].message if new else "",
        "reports": reports,
        "details": [text.as_string() for text in bpy.data.texts],
        "hands": len(hands()),
    }


def full_disk(stage, source):
    """The cache folder's disk is full."""
    addon = bpy.context.preferences.addons[ADDON].preferences
    before = addon.cache_folder
    addon.cache_folder = "/tmp/small_disk"
    with open("/tmp/small_disk/filler", "wb") as filler, contextlib.suppress(OSError):
        while True:
            filler.write(b"\0" * 4096)
            filler.flush()
    try:
        answer = yield from fails(stage, source, "full-disk")
    finally:
        Path("/tmp/small_disk/filler").unlink()
        addon.cache_folder = before
    again = yield from capture(stage, source)
    return {**answer, "again": again.state}


def moved_file(stage, source):
    """A .blend that is opened elsewhere, without its picture."""
    job = yield from capture(stage, source)
    home = Path(source).parent
    path = home / "scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), relative_remap=True)
    before = summary()
    elsewhere = home / "elsewhere"
    elsewhere.mkdir()
    moved = path.rename(elsewhere / path.name)
    Path(source).rename(home / "hidden")
    bpy.ops.wm.open_mainfile(filepath=str(moved))
    yield 0.5
    yield from stage.open_sidebar()
    yield from stage.look_through_camera()
    yield from stage.screenshot("moved")
    answer = yield from fails(stage, bpy.context.scene.manient.source, "moved")
    return {**answer, "before": before, "after": summary(), "name": job.name}


def quality(stage, source):
    """Best is chosen from the list, by its letter, and a clip is captured with it."""
    yield from stage.open_sidebar()
    settings = bpy.context.scene.manient
    settings.source = source
    yield 0.5
    first = settings.preset
    place = yield from stage.find_button("manient.preset", along=0.7)
    assert place is not None, "the sidebar has no field Quality"
    yield from stage.click(place)
    yield 0.3
    yield from stage.screenshot("quality-choices")
    yield from stage.key("B")
    yield 0.3
    job = yield from capture(stage, source)
    yield from stage.screenshot("quality-best")
    return {"first": first, "chosen": settings.preset, "asked": job.options.quality}
