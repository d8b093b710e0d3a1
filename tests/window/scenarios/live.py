"""The panel Live: hands follow a clip that plays as a camera would, Space records, Esc ends."""

from __future__ import annotations

from pathlib import Path

import bpy
from mathutils import Vector

from scenarios.capturing import done, finish, hands, import_take, jobs, keys_of, part
from scenarios.character import rigify_character, vroid_character
from scenarios.panels import opened_by_default
from scenarios.traces import workers

START = "bpy.ops.manient.live("


def started(stage, source, folder, character=None, *, button=False, left=None):
    """Press Start and wait for the right hand, which the `character` follows; `left`: who follows the left
    one, if anybody does. Returns the session."""
    settings = bpy.context.scene.manient.live
    settings.source, settings.folder, settings.countdown = f"file:{source}", str(folder), 1
    settings.left.use, settings.left.character, settings.right.character = left is not None, left, character
    yield from stage.press(START) if button else stage.invoke("manient.live")
    live = part("session.live")
    session = yield from stage.until(live.running, 5.0, "Live to start")
    yield from stage.until(
        lambda: session.hand_states.get("right") == "seen",
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


def acted(stage, source, take):
    """The left hand moves and turns a VRoid character's, the right one an open hand. Both are calibrated and
    recorded to the playing scene, snapped onto the character and onto a captured hand, and the take is thrown
    away; another file ends it."""
    takes = part("session.live_takes").takes
    captured = yield from import_take(stage, take)
    character = yield from vroid_character(stage)
    character.manient.character.wrist = "PLACED"
    hand = character.pose.bones["J_Bip_L_Hand"]
    character.location = Vector((0.2, 0.6, 0.0)) - hand.head  # beside the open hand
    bpy.context.view_layer.objects.active = captured
    bpy.ops.ed.undo_push(message="Before")

    def place():
        return (hand.matrix @ hand.bone.matrix_local.inverted()).to_quaternion()

    before, keyed, name = place(), keys_of(captured), character.name
    session = yield from started(stage, source, Path(source).parent / "takes", left=character)
    yield from stage.until(lambda: session.hand_states.get("left") == "seen", 20.0, "the left hand")
    yield from stage.invoke("manient.live_calibrate")
    # A machine that shows fewer than ten frames a second sees none.
    words = "cm long", "No open hand"
    yield from stage.until(lambda: any(word in session.message for word in words), 30.0, "a length")
    yield from stage.screenshot("live_calibrated")
    yield from stage.until(lambda: before.rotation_difference(place()).angle > 0.1, 60.0, "a turn")
    bpy.context.scene.manient.live.play = True
    yield from stage.leave_popups()
    yield from stage.key("SPACE")
    yield from stage.until(lambda: bpy.context.screen.is_animation_playing, 10.0, "the scene to play")
    yield from stage.until(lambda: _recorded(session) > 2.0, 60.0, "two seconds of recording")
    yield from stage.screenshot("live_acted")
    yield from stage.leave_popups()
    yield from stage.key("SPACE")
    (job,) = yield from stage.until(jobs, 60.0, "the take")
    assert not bpy.context.screen.is_animation_playing
    yield from finish(stage, job)
    done(job)
    yield from stage.until(lambda: takes[0].collections[0].hide_viewport, 5.0, "the take to be hidden")
    yield from stage.screenshot("live_take_hidden")
    preview = keys_of(character)
    assert preview
    bpy.context.view_layer.objects.active = captured
    bpy.context.scene.frame_set(400)
    yield from stage.invoke("manient.live_snapshot")
    yield from stage.until(lambda: keys_of(captured) > keyed, 10.0, "the snapshot")
    assert keys_of(character) > preview
    yield from stage.screenshot("live_snapped")
    bpy.ops.manient.live_throw_away("EXEC_DEFAULT", index=0)
    assert not takes
    assert not list((Path(source).parent / "takes").iterdir())
    assert [hand for hand in hands() if "Live" not in hand.name] == [captured]
    assert keys_of(character) == 0
    yield from stage.reopen(f"{source}.blend")
    yield from stage.until(lambda: session.over, 10.0, "the end")
    yield 0.5
    assert len(workers()) <= 1
    assert [c for c in bpy.data.collections if c.manient.is_live or c.hide_viewport] == []
    hand = bpy.data.objects[name].pose.bones["J_Bip_L_Hand"]
    assert before.rotation_difference(place()).angle < 1e-3


def left_running(stage, source):
    """Live runs; whoever plays this quits Blender then."""
    yield from started(stage, source, Path(source).parent / "takes")
