"""The panel Live: hands follow a clip that plays as a camera would, Space records, Esc ends."""

from __future__ import annotations

import json
import statistics
import time
from itertools import pairwise
from pathlib import Path

import bpy

from scenarios.capturing import done, finish, hands, jobs, part
from scenarios.character import press, rigify_character
from scenarios.panels import opened_by_default
from scenarios.traces import workers

START = "bpy.ops.manient.live("


def started(stage, source, folder, character=None, *, button=False):
    """Press Start and wait for the right hand, which the `character` follows. Returns the session."""
    settings = bpy.context.scene.manient.live
    settings.source, settings.folder, settings.countdown = f"file:{source}", str(folder), 1
    settings.left.use, settings.right.character = False, character
    yield from press(stage, START) if button else stage.invoke("manient.live")
    live = part("session.live")
    session = yield from stage.until(live.running, 5.0, "Live to start")
    yield from stage.until(
        lambda: session.hand_states().get("right") == "seen",
        40.0,
        lambda: f"a hand: {session.message} {session.error}",
    )
    return session


def _recorded(session) -> float:
    """Seconds of the recording that goes on."""
    return session._recording.seconds if session._recording is not None else 0.0


def recorded(stage, source):
    """The open hand follows; Space records; the take is there at once, then in full; Esc ends, and the view
    and the scene are as before but for the take; undone and redone, saved and opened again."""
    with opened_by_default("MANIENT_PT_live"):
        yield from stage.open_sidebar()
        view = stage.area().spaces[0].region_3d
        distance = view.view_distance
        session = yield from started(stage, source, Path(source).parent / "takes", button=True)
        bpy.ops.ed.undo_push(message="Before")
        yield from stage.leave_popups()
        yield from stage.key("SPACE")
        yield from stage.until(lambda: _recorded(session) > 1.0, 30.0, "a second of recording")
        yield from stage.screenshot("live_recording")
        yield from stage.leave_popups()
        yield from stage.key("SPACE")
        (job,) = yield from stage.until(jobs, 60.0, "the take")
        yield from finish(stage, job)
        done(job)
        yield from stage.screenshot("live_taken")
        yield from stage.leave_popups()
        yield from stage.key("ESC")
        yield from stage.until(lambda: session.over, 10.0, "the end")
    yield 0.5
    assert session.error is None
    assert len(workers()) == 1  # which captured the take
    assert abs(view.view_distance - distance) < 1e-3
    assert len(hands()) == 1
    assert [c for c in bpy.data.collections if c.manient.is_live] == []
    yield from stage.undo()
    assert not hands()
    yield from stage.redo()
    yield from stage.reopen(f"{source}.blend")
    assert len(hands()) == 1


def on_rigify(stage, source):
    """A Rigify character follows while the scene plays; an undo ends it, and the character is as before."""
    yield from rigify_character(stage)
    captured_before = workers()

    def angle():
        return bpy.data.objects["rig"].pose.bones["f_index.02.R"].rotation_quaternion.angle

    bpy.data.objects["rig"].select_set(False)
    bpy.ops.ed.undo_push(message="Rig")
    session = yield from started(stage, source, Path(source).parent / "takes", bpy.data.objects["rig"])
    assert angle() > 0.01
    with stage.override():
        bpy.ops.screen.animation_play()
    yield from stage.until(lambda: bpy.context.scene.frame_current > 3, 20.0, "the scene to play")
    assert angle() > 0.01
    with stage.override():
        bpy.ops.screen.animation_play()
    yield from stage.undo()
    yield from stage.until(lambda: session.over, 10.0, "the end")
    yield 0.5
    assert angle() == 0.0
    assert workers() == captured_before


def measured(stage, source, figures, rounds, seconds):
    """For scripts/measure_window.py: redraws while a Rigify character follows, and while a timer asks for as
    many; milliseconds that the add-on keeps the main thread."""
    stage.draw_smoothly(on=True)
    yield from rigify_character(stage)
    area, found = stage.area(), {"timer that redraws": [], "live": []}

    def drawn(name):
        times = []
        handle = bpy.types.SpaceView3D.draw_handler_add(
            lambda: times.append(time.perf_counter()), (), "WINDOW", "POST_PIXEL"
        )
        stage.meter.reset()
        end = time.perf_counter() + seconds
        while time.perf_counter() < end:
            if name != "live":
                area.tag_redraw()
            yield 1 / 30
        bpy.types.SpaceView3D.draw_handler_remove(handle, "WINDOW")
        gaps = [1000.0 * (after - before) for before, after in pairwise(times)]
        ticks = sorted(ms for calls in stage.meter.calls.values() for ms in calls) or [0.0]
        row = {"redraws/s": len(gaps) / (times[-1] - times[0]), "longest gap ms": max(gaps)}
        row |= {"ours, median ms": statistics.median(ticks), "ours, 99 % ms": ticks[len(ticks) * 99 // 100]}
        found[name].append(row | {"ours, longest ms": ticks[-1]})

    for _ in range(rounds):
        yield from drawn("timer that redraws")
        folder = Path(source).parent / "takes"
        session = yield from started(stage, source, folder, bpy.data.objects["rig"])
        yield from drawn("live")
        session.stop()
        yield from stage.until(lambda session=session: session.over, 10.0, "the end")
        yield 0.5
    Path(figures).write_text(json.dumps(found), encoding="utf-8")


def left_running(stage, source):
    """Live runs; whoever plays this quits Blender then."""
    yield from started(stage, source, Path(source).parent / "takes")
