"""The panel Character: an armature gets the motion of captured hands."""

from __future__ import annotations

import importlib

import addon_utils
import bpy
from stage import EDIT_TAB

from scenarios import refine
from scenarios.capturing import capture, hands, import_take, keys_of, part
from scenarios.panels import opened_by_default

OTHER = "f_pinky.02.L"
"""A bone that is chosen for the last bone of the left ring finger"""
FINGERS = ("thumb", "f_index", "f_middle", "f_ring", "f_pinky")


def applied(stage, take):
    """A Rigify character is recognised, a bone of its table chosen by mouse, and the motion applied by the
    panel's button; both are undone and redone, saved and opened again."""
    yield from import_take(stage, take)
    yield from rigify_character(stage)
    with opened_by_default("MANIENT_PT_character"):
        yield from stage.open_sidebar(EDIT_TAB)
        yield 0.5
        table, own = bpy.context.scene.manient.hand_table, "f_ring.03.L"
        assert (table.hand, table.ring_3, _kept()) == ("DEF-hand.L", own, own)
        yield from _choose(stage, "hand_table.ring_3", OTHER)
        assert table.ring_3 == _kept() == OTHER
        yield from stage.press("bpy.ops.manient.apply_to_character(")
        yield from stage.until(_keys, 60.0, "keys on the character")
        yield 0.5
        keyed = {c.data_path.split('"')[1] for c in _rig().animation_data.action.fcurves}
        assert keyed == {f"{name}.0{i}.{s}" for s in "LR" for name in FINGERS for i in (1, 2, 3)} - {own}
        # The clip of 100 frames at 25 per second is retimed to the scene's 24.
        keys = 4 * (1 + 99 * 24 // 25) * len(keyed)
        turns = _turns(30)
        assert min(turns[1:]) > 0.1
        # Two undos, of the motion and of the table; two redos; saved and opened again.
        seen = [(_keys(), _kept())]
        for step in (stage.undo, stage.undo, stage.redo, stage.redo):
            yield from step()
            seen.append((_keys(), _kept()))
        assert seen == [(keys, OTHER), (0, OTHER), (0, own), (0, OTHER), (keys, OTHER)]
        yield from stage.reopen(f"{take}.blend")
        assert (_keys(), _kept(), _turns(30)) == (keys, OTHER, turns)


def armed(stage, take):
    """A Rigify character gets the arms of a take by the panel's tick and button, and undo takes them back."""
    yield from import_take(stage, take)
    yield from rigify_character(stage)
    before = _wrist(30)
    with opened_by_default("MANIENT_PT_character"):
        yield from stage.open_sidebar(EDIT_TAB)
        yield 0.5
        yield from stage.press("manient.character.arms")
        yield from stage.until(lambda: _rig().manient.character.arms, 5.0, "the tick")
        yield from stage.press("bpy.ops.manient.apply_to_character(")
        yield from stage.until(_keys, 60.0, "keys on the character")
        yield 0.5
        keyed = {c.data_path.split('"')[1] for c in _rig().animation_data.action.fcurves}
        assert {f"{name}.{s}" for s in "LR" for name in ("hand_ik", "upper_arm_ik")} <= keyed
        after = _wrist(30)
        assert (after - before).length > 0.1
        yield from stage.screenshot("character_armed")
        yield from stage.undo()
        assert _keys() == 0


def _wrist(frame: int):
    """Where the left hand is shown in a frame."""
    bpy.context.scene.frame_set(frame)
    shown = _rig().evaluated_get(bpy.context.evaluated_depsgraph_get())
    return shown.pose.bones["ORG-hand.L"].head.copy()


def linked(stage, source, steps=12):
    """A fingertip of a captured hand is dragged while another armature follows it by the live link."""
    yield from capture(stage, source)
    (armature,) = hands()
    follower = _copied(armature)
    with opened_by_default("MANIENT_PT_character"):
        yield from stage.open_sidebar(EDIT_TAB)
        yield 0.5
        yield from stage.press("manient.character.live")
        yield from stage.until(lambda: keys_of(follower) > 0, 30.0, "the follower's keys")
    before = _index_turns(follower)
    follower.select_set(False)
    armature.select_set(True)
    yield from refine.edited(stage, armature, frame=30)
    x, y = refine.places()[refine.INDEX_TIP]
    yield from stage.move_to((x, y))
    yield 0.1
    yield from stage.hold()
    yield from stage.until(lambda: refine.state()["dragged"] is not None, 3.0, "the point to be taken")
    for number in range(1, steps + 1):
        yield from stage.move_to((x + 160 * number / steps, y + 10))
        yield 0.15
    yield from stage.until(lambda: _behind(armature, follower) < 0.02, 10.0, "the follower")
    yield from stage.hold("RELEASE")
    yield from stage.until(lambda: refine.state()["dragged"] is None, 10.0, "the last fit")
    yield from refine.ended(stage, "RET")
    link = part("session.live_link")

    def keyed():
        return _index_turns(follower)[30] != before[30] and link.keying_progress(follower) is None

    yield from stage.until(keyed, 30.0, "the follower's keys")
    assert link.trouble(follower) is None
    after, ours = _index_turns(follower), _index_turns(armature)
    assert [frame for frame in before if abs(before[frame] - after[frame]) > 0.01] == [28, 30, 32]
    assert max(abs(after[frame] - ours[frame]) for frame in ours) < 1e-3


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


def vroid_character(stage):
    """Rigify's human at rest, its hands' and arms' bones called as VRoid calls those of its VRMs. Returns the
    armature."""
    addon_utils.enable("rigify", default_set=True, persistent=True)
    called = {"hand": "Hand", "forearm": "LowerArm", "upper_arm": "UpperArm", "shoulder": "Shoulder"}
    fingers = zip(FINGERS, ("Thumb", "Index", "Middle", "Ring", "Little"), strict=True)
    called |= {f"{old}.0{i}": f"{new}{i}" for old, new in fingers for i in (1, 2, 3)}
    with stage.override():
        bpy.ops.object.armature_human_metarig_add()
        armature = bpy.context.active_object
        for side in "LR":
            for old, new in called.items():
                armature.data.bones[f"{old}.{side}"].name = f"J_Bip_{side}_{new}"
    yield 0.5
    return armature


def _rig():
    return bpy.data.objects["rig"]


def _keys() -> int:
    return keys_of(_rig())


def _kept() -> str:
    return part("scene.characters").table_of(_rig(), "left").bones[12]


def _turns(frame: int) -> list[float]:
    """How far the left hand's bones are turned in a frame, by MANO's joints."""
    bpy.context.scene.frame_set(frame)
    shown = _rig().evaluated_get(bpy.context.evaluated_depsgraph_get())
    names = part("scene.characters").table_of(_rig(), "left").bones
    return [round(shown.pose.bones[name].matrix_basis.to_quaternion().angle, 4) for name in names]


def _choose(stage, field: str, name: str):
    """Click the field of a bone in the table, type a name into its search, and take what is found."""
    yield from stage.press(field)
    yield from stage.write(name)
    yield 0.5
    yield from stage.key("RET")
    yield 0.5
