"""The rig in Blender is the model: vertices, joints, bones, names."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from mathutils import Quaternion

from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene.build import build_take
from handfit_core.hand_model import load_model
from handfit_core.skeleton import FINGER_JOINTS, FINGERS, JOINT_NAMES, NUM_JOINTS, PARENTS

from .conftest import built_model, evaluated_vertices, world


def test_evaluated_mesh_is_the_posed_model(make_take, model, record_property):
    made = make_take(model=model)
    built = build_take(made.take)
    worst = 0.0
    for row, frame in made.seen:
        bpy.context.scene.frame_set(frame)
        for hand in built.hands:
            error = np.abs(evaluated_vertices(hand.mesh) - world(made.vertices[hand.side][row]))
            worst = max(worst, error.max())
    print(f"worst vertex error {worst * 1000:.5f} mm")
    assert worst < 1e-4


def test_correctives_matter_and_can_be_left_out(make_take, imitation_mano):
    made = make_take(model=str(imitation_mano), sides=("right",))
    built = build_take(made.take, pose_correctives=False)
    assert built.hands[0].mesh.data.shape_keys is None
    row, frame = made.seen[3]
    bpy.context.scene.frame_set(frame)
    error = np.abs(evaluated_vertices(built.hands[0].mesh) - world(made.vertices["right"][row]))
    assert error.max() > 1e-3


@pytest.mark.parametrize("side", ["right", "left"])
def test_open_hand_needs_few_correctives(make_take, side):
    """Two for a hinge, five for a knuckle, nine for the thumb's saddle, whatever the shape."""
    built = build_take(make_take(sides=(side,)).take)
    names = [key.name for key in built.hands[0].mesh.data.shape_keys.key_blocks[1:]]
    hinges = [n for n in names if "middle." in n or "distal." in n or "thumb_proximal." in n]
    assert {name.split()[1] for name in hinges} == {"wx", "xx"}
    assert len(names) == 10 * 2 + 4 * 5 + 9


def test_drivers_are_simple_expressions(make_take, imitation_mano):
    built = build_take(make_take(model=str(imitation_mano), sides=("left",)).take)
    keys = built.hands[0].mesh.data.shape_keys
    drivers = keys.animation_data.drivers
    assert 0 < len(drivers) == len(keys.key_blocks) - 1 <= 135
    assert all(curve.driver.is_simple_expression and curve.driver.is_valid for curve in drivers)


def test_bones_have_manos_parents_heads_and_tails(make_take):
    made = make_take()
    for hand in build_take(made.take).hands:
        bones = hand.armature.data.bones
        names = bone_names(hand.side)
        suffix = {"right": ".R", "left": ".L"}[hand.side]
        assert {b.name for b in bones} == {n + suffix for n in JOINT_NAMES}
        track = next(t for t in made.take.hands if t.side == hand.side)
        shaped = load_model(made.take.model, hand.side).shaped(track.betas)
        rest = np.stack([shaped.joints[:, 0], -shaped.joints[:, 2], shaped.joints[:, 1]], -1)
        tips = np.stack([shaped.tips[:, 0], -shaped.tips[:, 2], shaped.tips[:, 1]], -1)
        for i, name in enumerate(names):
            parent = bones[name].parent
            assert (parent.name if parent else None) == (names[PARENTS[i]] if PARENTS[i] >= 0 else None)
            np.testing.assert_allclose(bones[name].head_local, rest[i], atol=1e-6)
        for f, finger in enumerate(FINGERS):
            a, b, c = FINGER_JOINTS[finger]
            np.testing.assert_allclose(bones[names[a]].tail_local, rest[b], atol=1e-6)
            np.testing.assert_allclose(bones[names[b]].tail_local, rest[c], atol=1e-6)
            np.testing.assert_allclose(bones[names[c]].tail_local, tips[f], atol=1e-6)
        knuckle = rest[FINGER_JOINTS["middle"][0]]
        np.testing.assert_allclose(bones[names[0]].tail_local, knuckle, atol=1e-6)


def test_names_flip():
    for right, left in zip(bone_names("right"), bone_names("left"), strict=True):
        assert bpy.utils.flip_name(right) == left
        assert bpy.utils.flip_name(left) == right


@pytest.mark.parametrize("side", ["right", "left"])
def test_positive_turn_about_x_bends_to_the_palm(make_take, side):
    built = build_take(make_take(sides=(side,)).take)
    armature = built.hands[0].armature
    armature.animation_data.action = None
    flat = _posed_tails(armature, side, None)
    for finger, chain in FINGER_JOINTS.items():
        if finger == "thumb":
            continue
        for joint in chain:
            bent = _posed_tails(armature, side, joint)
            move = bent[joint] - flat[joint]
            # The palm faces -Z in rest space.
            assert move[2] < 0, JOINT_NAMES[joint]
            assert abs(move[1]) < 0.35 * np.linalg.norm(move), JOINT_NAMES[joint]


@pytest.mark.parametrize("side", ["right", "left"])
def test_thumb_bends_across_the_palm(make_take, side):
    built = build_take(make_take(sides=(side,)).take)
    armature = built.hands[0].armature
    armature.animation_data.action = None
    flat = _posed_tails(armature, side, None)
    little = FINGER_JOINTS["little"][0]
    target = np.array(armature.data.bones[bone_names(side)[little]].head_local)
    for joint in FINGER_JOINTS["thumb"]:
        bent = _posed_tails(armature, side, joint)
        move = bent[joint] - flat[joint]
        towards = target - np.array([0.0, 0.0, 0.03]) - flat[joint]
        assert move @ towards > 0, JOINT_NAMES[joint]


def _posed_tails(armature, side, joint) -> np.ndarray:
    """(16, 3) bone tails in rest space with one bone bent by 40 degrees about its X."""
    names = bone_names(side)
    for i, name in enumerate(names):
        bone = armature.pose.bones[name]
        bone.location = (0, 0, 0)
        bone.rotation_quaternion = Quaternion((1, 0, 0), 0.7 if i == joint else 0.0)
    bpy.context.view_layer.update()
    return np.array([armature.pose.bones[name].tail for name in names])


def test_the_left_hands_bones_are_the_right_hands_mirrored(make_take):
    """So that Paste Pose Flipped works: Blender mirrors rest matrices as B -> S B S, S = diag(-1, 1, 1)."""
    made = make_take()
    right, left = (load_model(made.take.model, side).shaped() for side in ("right", "left"))
    from handfit_core.hand_model.axes import bone_frames

    if not np.allclose(right.joints * [-1, 1, 1], left.joints, atol=1e-4):
        pytest.skip("this model's hands are no mirror images")
    mirror = np.diag([-1.0, 1.0, 1.0])
    np.testing.assert_allclose(
        bone_frames(left, "left"), mirror @ bone_frames(right, "right") @ mirror, atol=1e-3
    )


def test_two_hands_are_two_rigs(make_take):
    built = build_take(make_take().take)
    assert [h.side for h in built.hands] == ["left", "right"]
    assert built.hands[0].armature is not built.hands[1].armature
    for hand in built.hands:
        assert hand.mesh.parent == hand.armature
        assert [g.name for g in hand.mesh.vertex_groups] == bone_names(hand.side)
        assert hand.mesh.modifiers[0].object == hand.armature
        assert len(hand.armature.pose.bones) == NUM_JOINTS
        assert np.allclose(hand.armature.matrix_world, np.eye(4))


def test_mesh_has_uvs_smooth_faces_and_skin(make_take, model):
    made = make_take(model=model, sides=("right",))
    mesh = build_take(made.take).hands[0].mesh.data
    polygons = built_model(model, "right").polygons
    assert len(mesh.polygons) == len(polygons)
    assert all(p.use_smooth for p in mesh.polygons)
    uv = np.empty((len(mesh.loops), 2), dtype=np.float32)
    mesh.uv_layers[0].data.foreach_get("uv", uv.ravel())
    assert uv.min() >= 0.0
    assert uv.max() <= 1.0
    assert np.ptp(uv, axis=0).min() > 0.1
    assert mesh.materials[0].node_tree.nodes.get("Principled BSDF") is not None
    assert mesh.validate() is False, "Blender found nothing to repair"
