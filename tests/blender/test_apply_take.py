"""Motion and poses put on a hand that is there already."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import pytest

from blender_manient.rigs import rig_of
from blender_manient.scene.apply import apply_track
from blender_manient.scene.build import build_take
from blender_manient.scene.keys import PoseKeys, pose_at, read_pose_keys, remove_pose_keys, write_pose_keys
from handfit_core.common.errors import OptionError
from handfit_core.media.source import Source
from tests.takes import seen_as

from .conftest import built_model, evaluated_vertices, joint_heads, world

pytestmark = pytest.mark.usefixtures("registered")

MIRROR = np.array([-1.0, 1.0, 1.0])


def other_source(made, name="another.mp4", **fields):
    return replace(made.take, source=Source("video", (f"/nowhere/{name}",)), **fields)


def active(hand):
    bpy.context.view_layer.objects.active = hand.armature
    hand.armature.select_set(True)
    return hand.armature


def expected_vertices(take, track, betas, mirrored: bool) -> np.ndarray:
    """(T, V, 3) the target's shape with the track's pose, its wrist where the source's is."""
    side = track.side
    model = built_model(take.model, side)
    moved = model.shaped(track.betas).joints[0] - model.shaped(betas).joints[0]
    if not mirrored:
        posed = model.posed(betas, track.global_orient, track.hand_pose, track.transl + moved)
        return world(posed.vertices)
    other = built_model(take.model, "left" if side == "right" else "right")
    turn = np.array([1.0, -1.0, -1.0])
    place = (model.shaped(track.betas).joints[0] + track.transl) * MIRROR
    posed = other.posed(
        betas,
        track.global_orient * turn,
        track.hand_pose * np.tile(turn, 15),
        place - other.shaped(betas).joints[0],
    )
    return world(posed.vertices)


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_motion_of_a_file(make_take, tmp_path, model, side):
    """Same side and other side, another shape, keys outside the range kept."""
    target = build_take(make_take(sides=("right",), model=model).take).hands[0]
    armature, rig = active(target), rig_of(target.armature)
    outside = pose_at(rig, np.array([3.0]))
    made = make_take(sides=(side,), model=model, seed=9, frame_numbers=np.arange(3, 15))
    gone = np.arange(12) < 5
    fields = "global_orient hand_pose transl joints_3d reprojection_error".split()
    track = made.take.hands[0]
    for name in fields:
        getattr(track, name)[gone] = np.nan
    track = seen_as(track, detected=track.detected & ~gone)
    path = replace(made.take, hands=(track,)).save(tmp_path / "motion.npz")
    assert bpy.ops.manient.apply_take(filepath=str(path), mode="ANIMATION") == {"FINISHED"}
    expected = expected_vertices(made.take, track, np.array(armature.manient.betas), mirrored=side == "left")
    for frame in range(8, 15):
        bpy.context.scene.frame_set(frame)
        assert np.abs(evaluated_vertices(target.mesh) - expected[frame - 3]).max() < 1e-4, frame
    keys = read_pose_keys(rig)
    np.testing.assert_array_equal(keys.frames, [3, 4, 5, 6, *range(8, 15), 16, 17, 18])
    np.testing.assert_allclose(np.abs(pose_at(rig, np.array([3.0]))[0]), np.abs(outside[0]))
    # No bone takes the long way round at the seams.
    assert (np.sum(keys.quats[1:] * keys.quats[:-1], axis=-1) >= -1e-6).all()


def test_another_source_starts_at_the_current_frame(make_take):
    target = build_take(make_take(sides=("right",)).take).hands[0]
    made = make_take(sides=("right",), seed=4, frame_numbers=np.arange(50, 60), fps=15.0)
    take = other_source(made)
    count = apply_track(target.armature, take, take.hands[0], "ANIMATION", 100.0)
    keys = read_pose_keys(rig_of(target.armature))
    new = keys.frames[keys.frames > 50]
    # 15 frames a second in a scene of 30; the picture of two scene frames has no hand
    assert count == len(new) == 17
    np.testing.assert_array_equal(new, np.setdiff1d(np.arange(100, 119), [107, 108]))


@pytest.mark.parametrize("wrist", [True, False])
def test_a_pose_of_a_file_at_the_current_frame(make_take, tmp_path, wrist):
    target = build_take(make_take(sides=("right",)).take).hands[0]
    armature = active(target)
    made = make_take(sides=("right",), seed=4)
    path = made.take.save(tmp_path / "pose.npz")
    before = read_pose_keys(rig_of(armature))
    bpy.context.scene.frame_set(10)
    here = pose_at(rig_of(armature), np.array([10.0]))
    bpy.ops.manient.apply_take(filepath=str(path), mode="POSE", source_frame=14, wrist=wrist)
    keys = read_pose_keys(rig_of(armature))
    added = np.isin(keys.frames, [10.0])
    np.testing.assert_allclose(keys.quats[~added], before.quats, atol=1e-6)
    assert keys.rotation_keyed[added][0].tolist() == [wrist] + [True] * 15
    track = made.take.hands[0]
    row = list(made.take.frame_numbers).index(14)
    if wrist:
        expected = expected_vertices(made.take, track, np.array(armature.manient.betas), False)[row]
        assert np.abs(evaluated_vertices(target.mesh) - expected).max() < 1e-4
    else:
        quats, place = pose_at(rig_of(armature), np.array([10.0]))
        np.testing.assert_allclose(place, here[1], atol=1e-6)
        np.testing.assert_allclose(np.abs(quats[0, 0] @ here[0][0, 0]), 1.0, atol=1e-6)


@pytest.mark.parametrize("side", ["right", "left"])
def test_another_hand_of_the_scene_as_the_artist_left_it(make_take, side):
    source = build_take(make_take(sides=(side,), seed=5).take).hands[0]
    rig = rig_of(source.armature)
    keys = read_pose_keys(rig)
    keys.quats[:, 6] = (0.8, 0.6, 0.0, 0.0)
    write_pose_keys(rig, PoseKeys.everywhere(keys.frames, keys.quats, keys.locations + 0.01))
    remove_pose_keys(rig, 5, 8, joints=[2], location=False)
    target = build_take(make_take(sides=("right",), seed=6).take).hands[0]
    armature = active(target)
    assert bpy.ops.manient.apply_take(source=source.armature.name) == {"FINISHED"}
    found = read_pose_keys(rig_of(armature))
    np.testing.assert_array_equal(found.frames, keys.frames)
    assert not found.rotation_keyed[(found.frames >= 5) & (found.frames <= 8), 2].any()
    mirror = MIRROR if side == "left" else np.ones(3)
    for frame in (4, 13):
        bpy.context.scene.frame_set(frame)
        mine, theirs = joint_heads(armature, "right"), joint_heads(source.armature, side)
        np.testing.assert_allclose(mine[0], theirs[0] * mirror, atol=1e-5)
        for joint in range(1, 16):  # other lengths, same directions
            if joint % 3 == 1:
                continue
            one, other = mine[joint] - mine[joint - 1], (theirs[joint] - theirs[joint - 1]) * mirror
            cosine = one @ other / np.linalg.norm(one) / np.linalg.norm(other)
            assert cosine > np.cos(np.radians(6.0)), joint
    bpy.context.scene.frame_set(7)  # in which nothing was detected
    bpy.ops.manient.apply_take(source=source.armature.name, mode="POSE")
    assert len(read_pose_keys(rig_of(armature)).frames) == 12
    if side == "right":
        wrists = [joint_heads(o, "right")[0] for o in (armature, source.armature)]
        np.testing.assert_allclose(*wrists, atol=1e-5)


def test_what_cannot_be_applied_is_one_sentence(make_take, tmp_path):
    made = make_take(sides=("right",))
    target = build_take(made.take).hands[0]
    active(target)
    empty = replace(made.take, hands=()).save(tmp_path / "empty.npz")
    for options, said in (
        ({"filepath": str(tmp_path / "nothing.npz")}, "no such take file"),
        ({"source": "Nobody"}, "not in this scene"),
        ({"source": target.armature.name}, "gets the motion"),
        ({"filepath": str(empty)}, "has no hand in it"),
    ):
        with pytest.raises(RuntimeError, match=said):
            bpy.ops.manient.apply_take(**options)
    (tmp_path / "bad.npz").write_text("no take")
    with pytest.raises(RuntimeError, match="not a take file"):
        bpy.ops.manient.import_take(filepath=str(tmp_path / "bad.npz"))
    bpy.ops.mesh.primitive_cube_add()
    with pytest.raises(OptionError, match="no captured hand"):
        apply_track(bpy.context.object, made.take, made.take.hands[0], "POSE", 1.0)
