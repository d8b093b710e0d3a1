"""The panel Character: a generated Rigify character gets the motion of captured hands."""

from __future__ import annotations

import importlib

import addon_utils
import bpy

from scenarios import refine
from scenarios.capturing import capture, hands, keys_of, part, summary
from scenarios.panels import opened_by_default
from scenarios.words import texts

OTHER = "f_pinky.02.L"
"""A bone that is chosen for the last bone of the left ring finger"""


def applied(stage, take, blend):
    """What is recognised, a bone of the table changed by mouse, motion applied by the panel's button; both
    undone and redone; saved and opened again."""
    yield from stood_beside(stage, take)
    with opened_by_default("MANIENT_PT_character"):
        yield from stage.open_sidebar()
        yield 0.5
        yield from stage.screenshot("character")
        table = bpy.context.scene.manient.hand_table
        seen = {"recognised": [table.hand, table.ring_3], "kept": [_kept()]}
        yield from _choose(stage, "hand_table.ring_3", OTHER)
        seen["changed"] = table.ring_3
        seen["kept"].append(_kept())
        yield from stage.screenshot("character-bones")
        yield from press(stage, "bpy.ops.manient.apply_to_character(")
        yield from stage.until(lambda: _keys() > 0, 60.0, "keys on the character")
        yield 0.5
        seen["keys"] = [_keys()]
        seen["keyed"] = sorted({c.data_path.split('"')[1] for c in _rig().animation_data.action.fcurves})
        bpy.context.scene.frame_set(30)
        yield from stage.leave_popups()
        yield from stage.screenshot("character-applied")
        seen["pose"] = [_turns()]
        for step in (stage.undo, stage.undo, stage.redo, stage.redo):
            yield from step()
            yield 0.3
            seen["keys"].append(_keys())
            seen["kept"].append(_kept())
        bpy.context.scene.frame_set(30)
        bpy.ops.wm.save_as_mainfile(filepath=str(blend))
        bpy.ops.wm.open_mainfile(filepath=str(blend))
        yield 0.5
        bpy.context.scene.frame_set(30)
        seen["pose"].append(_turns())
        seen["keys"].append(_keys())
        seen["kept"].append(_kept())
    return seen


def of_another_program(stage, source, vrma, fbx):
    """Another program's hands as the source of a capture; put onto a Rigify character, and what that does
    exported for avatars and as FBX by mouse."""
    with opened_by_default("MANIENT_PT_export"):
        job = yield from capture(stage, source)
        captured = summary()
        yield from rigify_character(stage)
        yield from stage.open_sidebar()
        yield 0.5
        yield from stage.invoke("manient.apply_to_character")
        yield from stage.until(lambda: _keys() > 0, 60.0, "keys on the character")
        yield 0.5
        bpy.context.scene.frame_set(30)
        yield from stage.leave_popups()
        yield from stage.screenshot("interchange-applied")
        bpy.context.preferences.view.filebrowser_display_type = "SCREEN"
        bpy.context.scene.manient.export_format = "vrma"
        yield 0.5
        yield from stage.screenshot("character-export")
        yield from press(stage, "bpy.ops.manient.export_character(")
        yield from stage.choose_file(vrma, "interchange-export")
        yield 1.0
        bpy.context.scene.manient.export_format = "fbx"
        yield 0.5
        yield from press(stage, "bpy.ops.manient.export_character(")
        yield from stage.choose_file(fbx, "character-export-fbx")
        yield 2.0
    return {"captured": captured, "keys": _keys(), "warnings": list(job.warnings), "turns": _turns()}


def refused(stage, take, preset):
    """What the panel says in Edit Mode and with a negative scale, in which its button does nothing; then a
    preset saved by the file browser."""
    yield from stood_beside(stage, take)
    said = []
    with opened_by_default("MANIENT_PT_character"):
        yield from stage.open_sidebar()
        yield 0.5
        yield from stage.move_to(stage.region())
        yield from stage.key("TAB")
        yield 0.5
        yield from _told(stage, said, "character-edit-mode")
        yield from stage.leave_popups()
        yield from stage.key("TAB")
        yield 0.5
        _rig().scale.x = -1.0
        yield 0.3
        yield from _told(stage, said, "character-negative-scale")
        _rig().scale.x = 1.0
        yield 0.3
        bpy.context.preferences.view.filebrowser_display_type = "SCREEN"
        yield from press(stage, "bpy.ops.manient.save_hand_preset(")
        yield from stage.choose_file(preset, "character-preset")
        yield 0.5
    return said


def _told(stage, said, shot):
    """All that the panel says now, and how many keys there are once its button was pressed."""
    with texts() as shown:
        yield from stage.screenshot(shot)
    yield from press(stage, "bpy.ops.manient.apply_to_character(")
    yield 1.0
    said.append([" ".join(shown), _keys()])


def linked(stage, source, steps=12):
    """A fingertip of a captured hand dragged while another armature follows it by the live link."""
    yield from capture(stage, source)
    (armature,) = hands()
    follower = _copied(armature)
    with opened_by_default("MANIENT_PT_character"):
        yield from stage.open_sidebar()
        yield 0.5
        yield from press(stage, "manient.character.live")
        yield from stage.until(lambda: keys_of(follower) > 0, 30.0, "the follower's keys")
        yield from stage.screenshot("live-linked")
    before = _index_turns(follower)
    follower.select_set(False)
    armature.select_set(True)
    bpy.context.view_layer.objects.active = armature
    yield from stage.look_through_camera()
    yield from stage.invoke("manient.edit_keypoints")
    yield from stage.until(
        lambda: refine.places() and not refine.state()["warming"], refine.WARM, "a warm worker"
    )
    bpy.context.scene.frame_set(30)
    yield 0.5
    start = refine.places()[refine.INDEX_TIP]
    yield from stage.move_to(start)
    yield 0.1
    x, y = stage.mouse
    stage.window.event_simulate(type="LEFTMOUSE", value="PRESS", x=x, y=y)
    yield from stage.until(lambda: refine.state()["dragged"] is not None, 3.0, "the point to be taken")
    for number in range(1, steps + 1):
        yield from stage.move_to((start[0] + 160 * number / steps, start[1] + 10))
        yield 0.15
    yield from stage.until(lambda: _behind(armature, follower) < 0.02, 10.0, "the follower")
    behind = _behind(armature, follower)
    yield from stage.screenshot("live-dragged")
    x, y = stage.mouse
    stage.window.event_simulate(type="LEFTMOUSE", value="RELEASE", x=x, y=y)
    yield from stage.until(lambda: refine.state()["dragged"] is None, 10.0, "the last fit")
    yield from stage.key("RET")
    yield from stage.until(lambda: not refine.operator().running(), 5.0, "the mode to end")
    yield 1.0
    yield from stage.until(
        lambda: part("session.live_link").keying_progress(follower) is None, 20.0, "the follower's keys"
    )
    after, ours = _index_turns(follower), _index_turns(armature)
    return {
        "behind": behind,
        "moved": [frame for frame in before if abs(before[frame] - after[frame]) > 0.01],
        "off": max(abs(after[frame] - ours[frame]) for frame in ours),
        "trouble": part("session.live_link").trouble(follower),
    }


def _copied(armature):
    """The same hand beside it, that is no captured one."""
    follower = armature.copy()
    follower.data = armature.data.copy()
    follower.animation_data_clear()
    follower.name = "Follower"
    follower.manient.is_hand = False
    follower.location.x += 0.25
    bpy.context.scene.collection.objects.link(follower)
    armature.select_set(False)
    follower.select_set(True)
    bpy.context.view_layer.objects.active = follower
    return follower


def _index_turns(armature) -> dict[int, float]:
    """Frame -> how far the index finger's first bone is turned by the keys."""
    now, found = bpy.context.scene.frame_current, {}
    for frame in (10, 28, 30, 32, 50):
        bpy.context.scene.frame_set(frame)
        found[frame] = armature.pose.bones["index_proximal.R"].matrix_basis.to_quaternion().angle
    bpy.context.scene.frame_set(now)
    return found


def _behind(armature, follower) -> float:
    """Radians by which the follower's index finger is turned otherwise now."""
    first, second = (o.pose.bones["index_proximal.R"].rotation_quaternion for o in (armature, follower))
    return first.rotation_difference(second).angle


def stood_beside(stage, take):
    """A take's hands and a generated Rigify character, which is selected."""
    with stage.override():
        bpy.ops.manient.import_take(filepath=str(take), matching="KEEP")
    yield from rigify_character(stage)


def rigify_character(stage):
    """Rigify's human, generated and selected."""
    addon_utils.enable("rigify", default_set=True, persistent=True)
    with stage.override():
        bpy.ops.object.armature_human_metarig_add()
        metarig = bpy.context.active_object
        importlib.import_module("rigify.generate").generate_rig(bpy.context, metarig)
        bpy.data.objects.remove(metarig)
        _rig().select_set(True)
        bpy.context.view_layer.objects.active = _rig()
        bpy.ops.ed.undo_push(message="Character")
    yield 0.5


def _rig():
    return bpy.data.objects["rig"]


def _keys() -> int:
    return keys_of(_rig())


def _kept() -> str:
    return part("scene.characters").table_of(_rig(), "left").bones[12]


def _turns() -> list[float]:
    """How far the left hand's bones are turned in this frame, by MANO's joints."""
    shown = _rig().evaluated_get(bpy.context.evaluated_depsgraph_get())
    names = part("scene.characters").table_of(_rig(), "left").bones
    return [round(shown.pose.bones[name].matrix_basis.to_quaternion().angle, 4) for name in names]


def press(stage, button: str):
    place = yield from _scrolled_to(stage, button)
    yield from stage.click(place)


def _choose(stage, field: str, name: str):
    """Click the field of a bone in the table, type a name into its search, and take what is found."""
    place = yield from _scrolled_to(stage, field)
    yield from stage.click(place)
    yield 0.5
    yield from stage.write(name)
    yield 0.5
    yield from stage.screenshot("character-search")
    yield from stage.key("RET")
    yield 0.5


def _scrolled_to(stage, button: str):
    """The place of a button of the sidebar, the wheel turned until it shows."""
    region = stage.region("UI")
    middle = (region.x + region.width / 2, region.y + region.height / 2)
    yield from stage.move_to(middle)
    for _ in range(40):
        yield from stage.key("WHEELUPMOUSE")
    for _ in range(4):
        place = yield from stage.find_button(button, along=0.6)
        if place is not None:
            return place
        yield from stage.move_to(middle)
        for _ in range(12):
            yield from stage.key("WHEELDOWNMOUSE")
        yield 0.3
    raise AssertionError(f"the sidebar has no {button}")


def moved(stage, take):
    """A character's hand turned and moved; then its travel halved, and its offset dragged by keys; the drag
    undone and redone."""
    yield from stood_beside(stage, take)
    with opened_by_default("MANIENT_PT_character"):
        rig, scene = _rig(), bpy.context.scene
        rig.manient.character.wrist = "PLACED"
        rig.manient.character.right.use = False
        yield from stage.open_sidebar()
        scene.frame_set(30)
        yield 0.5
        with stage.override():
            bpy.ops.manient.mark_frame()
        yield from press(stage, "bpy.ops.manient.apply_to_character(")
        yield from stage.until(lambda: _keys() > 0, 60.0, "keys on the character")
        yield 0.5
        seen = {"marked": rig.manient.character.reference, "places": [_places()]}
        yield from stage.leave_popups()
        yield from stage.screenshot("character-moved")
        rig.manient.character.travel = 0.5
        with stage.override():
            bpy.ops.ed.undo_push(message="Travel")
        yield from stage.until(_is_adjusted, 120.0, "keys with half the travel")
        seen["places"].append(_places())
        scene.frame_set(60)
        yield from press(stage, "bpy.ops.manient.add_hand_offset(")
        yield 0.5
        seen["active"] = bpy.context.active_object.name
        yield from stage.screenshot("character-offset")
        yield from stage.move_to(stage.region())
        for key in ("G", "X"):
            yield from stage.key(key)
        yield from stage.write("0.3")
        yield from stage.key("RET")
        yield from stage.until(_is_adjusted, 120.0, "keys with the offset")
        seen["places"].append(_places())
        scene.frame_set(60)
        yield 0.5
        yield from stage.screenshot("character-offset-dragged")
        for step in (stage.undo, stage.redo):
            yield from step()
            yield from stage.until(_is_adjusted, 120.0, "the keys to follow")
            seen["places"].append(_places())
    return seen


def _is_adjusted() -> bool:
    """Whether the keys are as the settings are, and nothing is being written."""
    idle = not bpy.app.timers.is_registered(part("session.hand_adjusting").step)
    return idle and part("scene.onto_character").is_adjusted(_rig())


def _places() -> list[list[float]]:
    """Where the left hand is in some frames, in the armature's space."""
    scene, name = bpy.context.scene, part("scene.characters").table_of(_rig(), "left").bones[0]
    now, found = scene.frame_current, []
    for frame in (30, 60, 90):
        scene.frame_set(frame)
        shown = _rig().evaluated_get(bpy.context.evaluated_depsgraph_get())
        found.append([round(value, 4) for value in shown.pose.bones[name].head])
    scene.frame_set(now)
    return found
