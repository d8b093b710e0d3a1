"""Shape and Pose > Keys: what Simplify would leave, done, undone, and taken back; a layer on top."""

from __future__ import annotations

import math

import bpy

from scenarios.capturing import hands, keys_of, part
from scenarios.panels import opened_by_default


def simplified(stage, take):
    """The preview follows a slider; each button is pressed, undone and redone."""
    with stage.override():
        bpy.ops.manient.import_take(filepath=str(take))
    with opened_by_default("MANIENT_PT_shape", "MANIENT_PT_keys"):
        yield from stage.open_sidebar()
        armature = hands()[0]
        armature.select_set(True)
        bpy.context.view_layer.objects.active = armature
        bpy.ops.ed.undo_push(message="Selected")
        seen = {"keys": [keys_of(armature)], "left": []}
        for degrees in (1.0, 4.0):
            bpy.context.scene.manient.keys_degrees = degrees
            yield 0.2
            found = yield from stage.until(_found, 60.0, "the preview")
            seen["left"].append(found)
        bpy.ops.ed.undo_push(message="Degrees")
        yield from stage.screenshot("keys")
        yield from _press(stage, "manient.simplify_keys")
        yield from stage.screenshot("keys-simplified")
        seen["keys"].append(_keys())
        for step in (stage.undo, stage.redo):
            yield from step()
            seen["keys"].append(_keys())
        yield from _press(stage, "manient.restore_keys")
        seen["keys"].append(_keys())
        yield from stage.undo()
        seen["keys"].append(_keys())
        yield from _press(stage, "manient.add_key_layer")
        yield from stage.screenshot("keys-layer")
        seen["layer"] = [_tracks()]
        yield from stage.undo()
        seen["layer"].append(_tracks())
        yield from stage.redo()
        yield from _press(stage, "manient.end_key_layer")
        seen["layer"].append(_tracks())
        seen["keys"].append(_keys())
    return seen


def merged(stage, take, folder, frame=24):
    """A saved file is opened, and what a layer changes in a frame is merged and simplified at once. Returns
    the changed bone's turn as captured, after Merge, and after Simplify."""
    with stage.override():
        bpy.ops.manient.import_take(filepath=str(take))
    path = f"{folder}/merged.blend"
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    yield 0.5
    with opened_by_default("MANIENT_PT_shape", "MANIENT_PT_keys"):
        yield from stage.open_sidebar()
        armature = hands()[0]
        armature.select_set(True)
        bpy.context.view_layer.objects.active = armature
        yield from stage.until(_found, 60.0, "the preview")
        turns = [_turn(frame)]
        yield from _press(stage, "manient.add_key_layer")
        bone = _bone()
        for at, turned in ((frame - 4, 0.0), (frame, 0.5), (frame + 4, 0.0)):
            bone.rotation_quaternion = (math.cos(turned / 2), math.sin(turned / 2), 0.0, 0.0)
            bone.keyframe_insert("rotation_quaternion", frame=at)
        bpy.ops.ed.undo_push(message="By hand")
        yield from _press(stage, "manient.end_key_layer")
        turns.append(_turn(frame))
        yield from stage.screenshot("keys-merged")
        yield from _press(stage, "manient.simplify_keys")
        turns.append(_turn(frame))
        yield from stage.screenshot("keys-merged-simplified")
    return turns


def _bone():
    return next(bone for bone in hands()[0].pose.bones if bone.name.startswith("middle_proximal"))


def _turn(frame):
    bpy.context.scene.frame_set(frame)
    return list(_bone().matrix_basis.to_quaternion())


def _press(stage, operator):
    yield from stage.leave_popups()
    place = yield from stage.find_button(f"bpy.ops.{operator}(")
    assert place is not None, f"no button {operator}"
    yield from stage.click(place)
    yield 0.5


def _found():
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[0]):
        found = part("session.key_preview").preview(bpy.context)
    return sum(one.after for one in found) if isinstance(found, list) else None


def _keys():
    return keys_of(hands()[0])


def _tracks():
    return len(hands()[0].animation_data.nla_tracks)
