"""What the pages for artists show."""

from __future__ import annotations

import math
import os

import bpy
from mathutils import Matrix, Quaternion, Vector
from stage import EDIT_TAB

from handfit_core.hand_model.files import OPEN_HAND, kept_model
from handfit_core.retarget.transfer import SourceHand, target_hand
from scenarios import adding, live, views
from scenarios.capturing import begin, capture, done, finish, hands, part
from scenarios.character import rigify_character
from scenarios.finding import HER_LEFT_HAND, begun, boxed_around, mode, tag_of
from scenarios.panels import opened_by_default
from scenarios.refine import INDEX_TIP, places, refitted, state, warmed


def tour(stage, folder, source, edited_frame=12):
    """The whole way, with a picture of every station. `source` lies in `folder`, as does the .blend."""
    bpy.ops.wm.save_as_mainfile(filepath=f"{folder}/scene.blend")
    yield from stage.open_sidebar()
    yield from stage.move_to(stage.region())
    yield 0.3
    yield from stage.screenshot("empty")

    source = f"//{source}"
    job = yield from begin(stage, source)
    yield from stage.until(
        lambda: job.progress.stage == "detect" and job.progress.done >= 8, 60.0, "eight frames"
    )
    yield from stage.screenshot("capturing")
    yield from finish(stage, job)
    done(job)
    yield 1.0
    bpy.context.scene.frame_set(edited_frame)
    yield from _shown(stage, "captured")
    yield from _drag_a_fingertip(stage)
    yield from stage.invoke("manient.touch")
    yield 0.5
    yield from stage.screenshot("touch")
    yield from stage.key("ESC")
    yield 0.3


def _shown(stage, name):
    """A picture of the screen once Blender's message in the status bar is gone."""
    yield from stage.leave_popups()
    yield 12.0
    yield from stage.screenshot(name)


def choosing(stage, folder, source):
    """The mouse is over the tag of one of the painting's hands; then a box is drawn around that hand."""
    bpy.ops.wm.save_as_mainfile(filepath=f"{folder}/painting.blend")
    yield from stage.open_sidebar()
    yield from begun(stage, f"//{source}")
    (left,) = [hand for hand in mode().choice.hands if hand.side == "left"]
    yield from stage.move_to(tag_of(left))
    yield from stage.screenshot("find")
    yield from stage.key("X")
    yield from boxed_around(stage, HER_LEFT_HAND, shot="box")
    yield from stage.key("ESC")


def several(stage, folder, sources):
    """Two captures in the list, the second in front."""
    bpy.ops.wm.save_as_mainfile(filepath=f"{folder}/several.blend")
    yield from stage.open_sidebar()
    for source in sources:
        yield from capture(stage, f"//{source}")
    bpy.context.scene.frame_set(12)
    yield from stage.look_through_camera()
    yield from stage.open_sidebar()
    yield from _shown(stage, "captures")


def posing(stage, folder, source):
    """A fist on a range of frames."""
    bpy.ops.wm.save_as_mainfile(filepath=f"{folder}/posing.blend")
    with opened_by_default("MANIENT_PT_poses"):
        yield from stage.open_sidebar()
        yield from capture(stage, f"//{source}")
        bpy.context.scene.frame_set(12)
        settings = bpy.context.scene.manient
        settings.pose, settings.pose_scope = "Fist", "RANGE"
        settings.pose_first, settings.pose_last = 8, 16
        yield from stage.press("bpy.ops.manient.apply_pose(")
        yield from stage.look_through_camera()
        yield from _shown(stage, "pose-range")


def gripping(stage, folder, source, frame=12):
    """A cup in a hand that is posed to hold a glass, from beside: Grip's dialog, and the fingers after it."""
    bpy.ops.wm.save_as_mainfile(filepath=f"{folder}/gripping.blend")
    yield from stage.open_sidebar(EDIT_TAB)
    yield from capture(stage, f"//{source}")
    (armature,) = hands()
    scene = bpy.context.scene
    scene.frame_set(frame)
    scene.use_preview_range, scene.frame_preview_start, scene.frame_preview_end = True, 8, 16
    scene.manient.pose = "Glass Grip"
    bpy.ops.manient.apply_pose(scope="RANGE", first=8, last=16)
    cup = _cup_in(armature)
    armature.select_set(True)
    bpy.context.view_layer.objects.active = armature
    view, space = stage.area().spaces[0].region_3d, stage.area().spaces[0]
    beside = Quaternion((0.0, 0.0, 1.0), math.radians(-60)) @ scene.camera.matrix_world.to_quaternion()
    view.view_perspective, view.view_rotation, view.view_distance = "PERSP", beside, 0.33
    view.view_location = cup.location + beside @ Vector((-0.03, -0.02, 0.0))  # right of the dialog
    space.overlay.show_bones = space.overlay.show_extras = space.overlay.show_cursor = False
    space.overlay.show_outline_selected = False
    yield from stage.invoke("manient.grip", rides=True)
    yield 0.5
    yield from stage.screenshot("grip")
    yield from stage.key("RET")
    yield from refitted(stage)
    yield from _shown(stage, "gripped")


def _cup_in(armature):
    """A cup where the hand would hold it."""
    bpy.ops.mesh.primitive_torus_add(
        major_radius=0.025, minor_radius=0.005, location=(0.025, 0.0, 0.0), rotation=(math.pi / 2, 0.0, 0.0)
    )
    bpy.ops.mesh.primitive_cylinder_add(vertices=64, radius=0.025, depth=0.1)
    cup = bpy.context.object
    bpy.data.objects["Torus"].select_set(True)
    bpy.ops.object.join()
    cup.name = "cup"
    wrist = armature.matrix_world @ armature.pose.bones[0].matrix
    across = Matrix.Rotation(math.pi / 2, 4, (-0.25, 0.97, 0.0))
    cup.matrix_world = wrist @ Matrix.Translation((0.0, 0.112, 0.044)) @ across
    return cup


def acting(stage, folder, source):
    """The open hand follows a clip and is recorded."""
    bpy.ops.wm.save_as_mainfile(filepath=f"{folder}/live.blend")
    with opened_by_default("MANIENT_PT_live"):
        yield from stage.open_sidebar()
        os.chdir(folder)  # so that no folder of this machine is in the picture
        yield from live.started(stage, source, "//live")
        yield from stage.leave_popups()
        yield from stage.key("SPACE")
        yield 5.0
        yield from stage.screenshot("live")
        yield from stage.key("ESC")
        yield 1.0


def two_cameras(stage, folder, source, second, other):
    """A capture of two views through both cameras; then with a clip of another hand as the second view."""
    bpy.ops.wm.save_as_mainfile(filepath=f"{folder}/two.blend")
    with opened_by_default("MANIENT_PT_result"):
        yield from stage.open_sidebar()
        yield from views.chosen(stage, f"//{source}", f"//{second}")
        yield from capture(stage, f"//{source}")
        bpy.context.scene.frame_set(45)
        yield from stage.look_through_camera()
        stage.area().spaces[0].overlay.show_extras = False  # lines of suns
        yield from _shown(stage, "views-first")
        yield from stage.invoke("manient.switch_view")
        yield from _shown(stage, "views-second")
        yield from capture(stage, f"//{source}", second_view=f"//{other}")
        yield from _shown(stage, "views-wrong")


def placing(stage, folder, source, points):
    """A drawn hand is laid into its picture and posed by some points, as `adding.posed` takes them."""
    bpy.ops.wm.save_as_mainfile(filepath=f"{folder}/drawing.blend")
    yield from stage.open_sidebar()
    yield from adding.begun(stage, f"//{source}", "right")
    yield from adding.posed(stage, points)


def onto_a_character(stage, folder, source, frame=8):
    """A Rigify character gets the motion of a captured hand, beside which its own right hand is held."""
    bpy.ops.wm.save_as_mainfile(filepath=f"{folder}/character.blend")
    with opened_by_default("MANIENT_PT_character"):
        yield from capture(stage, f"//{source}")
        (armature,) = hands()
        yield from rigify_character(stage)
        rig = bpy.context.active_object
        bpy.context.scene.frame_set(frame)
        _hold_beside(rig, armature)
        bpy.context.scene.manient.hand_table.side = "right"
        yield from stage.open_sidebar(EDIT_TAB)
        yield from stage.press("bpy.ops.manient.apply_to_character(")
        yield from stage.until(lambda: rig.animation_data.action is not None, 60.0, "keys on the character")
        yield 1.0
        with stage.override():
            bpy.ops.view3d.view_axis(type="FRONT")
        space = stage.area().spaces[0]
        space.overlay.show_extras = space.overlay.show_cursor = False
        space.region_3d.view_location = _wrist(armature) + Vector((-0.05, 0.0, 0.05))
        space.region_3d.view_distance = 0.55
        yield from _shown(stage, "character")


def onto_a_body(stage, folder, source, side, turns, places, frame=40):
    """A character whose hand moves as `turns` (T, 3, 3) and `places` (T, 3) of the filmed one say, by keys of
    its own, gets the fingers of the film of a part of that."""
    bpy.ops.wm.save_as_mainfile(filepath=f"{folder}/body.blend")
    with opened_by_default("MANIENT_PT_character"):
        yield from rigify_character(stage)
        rig, mark = bpy.context.active_object, side[0].upper()
        control = rig.pose.bones[f"hand_ik.{mark}"]
        middle = len(turns) // 2
        bones, table = part("rigs.character").bones_of(rig), part("scene.characters").table_of(rig, side)
        aligned = Matrix(
            target_hand(
                bones, table, SourceHand.of(kept_model(OPEN_HAND, side).shaped(), side)
            ).aligned.tolist()
        )
        space = aligned @ Matrix(turns[middle]).transposed()
        rest = control.bone.matrix_local.copy()
        for row, (turn, place) in enumerate(zip(turns, places, strict=True)):
            way = space @ (Vector(place) - Vector(places[middle]))
            turned = (space @ Matrix(turn) @ aligned.transposed() @ rest.to_3x3()).to_4x4()
            control.matrix = Matrix.Translation(rest.translation + 0.5 * way) @ turned
            for channel in ("location", "rotation_quaternion"):
                control.keyframe_insert(channel, frame=row + 1)
        yield from capture(stage, f"//{source}")
        part("operators.base").select_alone(bpy.context, rig)
        yield from stage.open_sidebar(EDIT_TAB)
        yield from stage.press("bpy.ops.manient.find_offset(")
        yield from stage.until(lambda: rig.manient.character.time_offset, 120.0, "the offset")
        yield from stage.press("bpy.ops.manient.apply_to_character(")
        yield from stage.until(lambda: rig.animation_data.nla_tracks, 60.0, "keys on the character")
        yield 1.0
        bpy.context.scene.frame_set(frame)
        for collection in rig.data.collections_all:
            collection.is_visible = collection.name == "DEF"
        with stage.override():
            bpy.ops.view3d.view_axis(type="FRONT")
        space = stage.area().spaces[0]
        space.overlay.show_extras = space.overlay.show_cursor = False
        space.region_3d.view_location = rig.matrix_world @ rig.pose.bones[table.bones[0]].head
        space.region_3d.view_distance = 0.9
        yield from _shown(stage, "body")


def _hold_beside(rig, armature):
    """Turn and scale the character so that its hand stands to the left of the captured one as that does now,
    and show the bones of that hand alone."""
    hand = part("scene.store").hand_of(armature)
    table = part("scene.characters").table_of(rig, hand.side)
    bones = part("rigs.character").bones_of(rig)
    target = target_hand(bones, table, SourceHand.of(hand.shaped(), hand.side))
    wrist = armature.pose.bones[hand.rig.bones[0]]
    turn = Matrix((wrist.matrix @ wrist.bone.matrix_local.inverted()).to_3x3() @ Matrix(target.aligned.T))
    there = _wrist(armature) + Vector((-0.2, 0.0, 0.0))
    size = Matrix.Scale(1.0 / target.scale, 4)
    own = rig.data.bones[table.bones[0]].head_local
    rig.matrix_world = Matrix.Translation(there) @ turn.to_4x4() @ size @ Matrix.Translation(-own)
    for collection in rig.data.collections_all:
        collection.is_visible = collection.name == "DEF"
    shown = {table.bones[0], *(f"DEF-{name}" for name in table.bones[1:])}
    for bone in rig.data.bones:
        bone.hide = bone.name not in shown
    rig.show_in_front, rig.display_type = True, "SOLID"
    rig.select_set(False)  # as the active object it is the character still


def _wrist(armature):
    return armature.matrix_world @ armature.pose.bones[0].head


def _drag_a_fingertip(stage):
    with stage.override():
        bpy.ops.manient.edit_keypoints("INVOKE_DEFAULT")
    yield from warmed(stage)
    x, y = places()[INDEX_TIP]
    path = [
        (x + 45 * math.sin(0.5 * math.pi * i / 20), y - 60 * (1 - math.cos(0.5 * math.pi * i / 20)))
        for i in range(21)
    ]
    yield from stage.drag(path, pause=0.1)
    yield from stage.until(lambda: state()["dragged"] is None, 20.0, "the last fit")
    yield 1.0
    yield from stage.screenshot("keypoints")
    yield from stage.key("RET")
    yield 0.5
