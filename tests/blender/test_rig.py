"""The rig in Blender is the model: vertices, joints, bones, names."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from mathutils import Quaternion

from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene.build import build_take
from handfit_core.hand_model import load_model
from handfit_core.hand_model.axes import points_to_rest
from handfit_core.skeleton import FINGER_JOINTS, JOINT_NAMES, NUM_JOINTS, PARENTS, other_side

from .conftest import built_model, evaluated_vertices, world


def test_evaluated_mesh_is_the_posed_model(make_take, model):
    """Without its correctives it is not."""
    made = make_take(model=model)
    worst = {}
    for correctives in (True, False):
        built = build_take(made.take, pose_correctives=correctives)
        worst[correctives] = 0.0
        for row, frame in made.seen:
            bpy.context.scene.frame_set(frame)
            for hand in built.hands:
                error = np.abs(evaluated_vertices(hand.mesh) - world(made.vertices[hand.side][row]))
                worst[correctives] = max(worst[correctives], error.max())
    assert worst[True] < 1e-4
    assert worst[False] > 1e-3
    assert built.hands[0].mesh.data.shape_keys is None


def test_correctives_are_few_and_simple(make_take, model):
    """The open hand has two for a hinge, five for a knuckle, nine for the thumb's saddle."""
    for hand in build_take(make_take(model=model).take).hands:
        keys = hand.mesh.data.shape_keys
        drivers = keys.animation_data.drivers
        assert 0 < len(drivers) == len(keys.key_blocks) - 1 <= 135
        assert all(curve.driver.is_simple_expression and curve.driver.is_valid for curve in drivers)
        if model == "open-hand":
            names = [key.name for key in keys.key_blocks[1:]]
            hinges = [n for n in names if "middle." in n or "distal." in n or "thumb_proximal." in n]
            assert {name.split()[1] for name in hinges} == {"wx", "xx"}
            assert len(names) == 10 * 2 + 4 * 5 + 9


def test_bones_have_manos_parents_heads_and_tails(make_take):
    made = make_take()
    built = build_take(made.take)
    assert [hand.side for hand in built.hands] == ["left", "right"]
    for hand, track in zip(built.hands, made.take.hands, strict=True):
        bones, names = hand.armature.data.bones, bone_names(hand.side)
        assert names == [f"{name}.{hand.side[0].upper()}" for name in JOINT_NAMES]
        assert [bpy.utils.flip_name(name) for name in names] == bone_names(other_side(hand.side))
        shaped = load_model(made.take.model, hand.side).shaped(track.betas)
        rest, tips = points_to_rest(shaped.joints), points_to_rest(shaped.tips)
        parents = [bones[name].parent for name in names]
        assert [bone and bone.name for bone in parents] == [None, *(names[p] for p in PARENTS[1:])]
        np.testing.assert_allclose([bones[name].head_local for name in names], rest, atol=1e-6)
        tails = np.array([rest[FINGER_JOINTS["middle"][0]]] * NUM_JOINTS)
        for tip, (a, b, c) in zip(tips, FINGER_JOINTS.values(), strict=True):
            tails[[a, b, c]] = rest[b], rest[c], tip
        np.testing.assert_allclose([bones[name].tail_local for name in names], tails, atol=1e-6)
        assert hand.mesh.parent == hand.mesh.modifiers[0].object == hand.armature
        assert [group.name for group in hand.mesh.vertex_groups] == names
        assert np.allclose(hand.armature.matrix_world, np.eye(4))


@pytest.mark.parametrize("side", ["right", "left"])
def test_positive_turn_about_x_bends_to_the_palm(make_take, side):
    """The thumb across it."""
    armature, names = build_take(make_take(sides=(side,)).take).hands[0].armature, bone_names(side)
    armature.animation_data.action = None
    little = np.array(armature.data.bones[names[FINGER_JOINTS["little"][0]]].head_local)

    def tail(joint: int, angle: float) -> np.ndarray:
        for bone in armature.pose.bones:
            bone.location = (0, 0, 0)
            bone.rotation_quaternion = Quaternion((1, 0, 0), angle if bone.name == names[joint] else 0.0)
        bpy.context.view_layer.update()
        return np.array(armature.pose.bones[names[joint]].tail)

    for joint in range(1, NUM_JOINTS):
        flat = tail(joint, 0.0)
        move = tail(joint, 0.7) - flat
        if joint in FINGER_JOINTS["thumb"]:
            assert move @ (little - [0.0, 0.0, 0.03] - flat) > 0, JOINT_NAMES[joint]
        else:  # the palm faces -Z in rest space
            assert move[2] < 0, JOINT_NAMES[joint]
            assert abs(move[1]) < 0.35 * np.linalg.norm(move), JOINT_NAMES[joint]


def test_mesh_has_uvs_smooth_faces_and_skin(make_take, model):
    mesh = build_take(make_take(model=model, sides=("right",)).take).hands[0].mesh.data
    assert len(mesh.polygons) == len(built_model(model, "right").polygons)
    assert all(p.use_smooth for p in mesh.polygons)
    uv = np.empty((len(mesh.loops), 2), dtype=np.float32)
    mesh.uv_layers[0].data.foreach_get("uv", uv.ravel())
    assert 0.0 <= uv.min() <= uv.max() <= 1.0
    assert np.ptp(uv, axis=0).min() > 0.1
    slots = [polygon.material_index for polygon in mesh.polygons]
    names = [material.name.partition(".")[0] for material in mesh.materials]
    nails = 46 if model == "open-hand" else 0
    assert names == ["Hand Skin", "Hand Nails"][: 1 + bool(nails)]
    assert sum(slots) == nails
    assert mesh.materials[0].node_tree.nodes.get("Principled BSDF") is not None
    assert mesh.validate() is False, "Blender found nothing to repair"
