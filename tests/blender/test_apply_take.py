"""Motion and poses put on a hand that is there already."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import pytest

from blender_manient.rigs import rig_of
from blender_manient.scene.apply import apply_track
from blender_manient.scene.build import build_take
from blender_manient.scene.corrections import corrections_of, keep_field
from blender_manient.scene.keys import PoseKeys, pose_at, read_pose_keys, remove_pose_keys, write_pose_keys
from handfit_core.edit.corrections import Correction, CorrectionField
from handfit_core.errors import OptionError
from handfit_core.media.source import Source

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
    armature = active(target)
    outside = pose_at(rig_of(armature), np.array([3.0]))
    made = make_take(sides=(side,), model=model, seed=9)
    frames = np.arange(8, 15)
    track = made.take.hands[0]
    rows = slice(5, 12)
    cut = replace(
        track,
        **{
            name: np.asarray(getattr(track, name))[rows]
            for name in (
                "global_orient hand_pose transl joints_3d keypoints_2d reprojection_error detected score"
            ).split()
        },
    )
    source = replace(made.take, frame_numbers=frames, hands=(cut,))
    path = source.save(tmp_path / "motion.npz")
    assert bpy.ops.manient.apply_take(filepath=str(path), mode="ANIMATION") == {"FINISHED"}
    betas = np.array(armature.manient.betas)
    expected = expected_vertices(source, cut, betas, mirrored=side == "left")
    for row, frame in enumerate(frames):
        bpy.context.scene.frame_set(int(frame))
        error = np.abs(evaluated_vertices(target.mesh) - expected[row]).max()
        assert error < 1e-4, frame
    keys = read_pose_keys(rig_of(armature))
    np.testing.assert_array_equal(keys.frames, [3, 4, 5, 6, *frames, 16, 17, 18])
    np.testing.assert_allclose(np.abs(pose_at(rig_of(armature), np.array([3.0]))[0]), np.abs(outside[0]))
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


def test_a_captured_pose_of_another_photo_leaves_the_wrist(make_take):
    """What a capture does that was asked for the active hand's pose."""
    target = build_take(make_take(sides=("right",)).take).hands[0]
    made = make_take(sides=("right",), seed=4, frame_numbers=np.array([1]))
    here = pose_at(rig_of(target.armature), np.array([10.0]))
    take = other_source(made, "photo.png")
    apply_track(target.armature, take, take.hands[0], "POSE", 10.0)
    np.testing.assert_allclose(pose_at(rig_of(target.armature), np.array([10.0]))[1], here[1], atol=1e-6)
    # Captured again from its own pictures, it does go where it was seen.
    apply_track(target.armature, made.take, made.take.hands[0], "POSE", 10.0)
    assert np.abs(pose_at(rig_of(target.armature), np.array([10.0]))[1] - here[1]).max() > 1e-3


@pytest.mark.parametrize("side", ["right", "left"])
def test_another_hand_of_the_scene_as_the_artist_left_it(make_take, side):
    source = build_take(make_take(sides=(side,), seed=5).take).hands[0]
    keys = read_pose_keys(rig_of(source.armature))
    quats = keys.quats.copy()
    quats[:, 6] = (0.8, 0.6, 0.0, 0.0)
    write_pose_keys(rig_of(source.armature), PoseKeys.everywhere(keys.frames, quats, keys.locations + 0.01))
    remove_pose_keys(rig_of(source.armature), 5, 8, joints=[2], location=False)
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
        # Other lengths, same directions.
        for joint in range(1, 16):
            if joint % 3 == 1:
                continue
            one, other = mine[joint] - mine[joint - 1], (theirs[joint] - theirs[joint - 1]) * mirror
            cosine = one @ other / np.linalg.norm(one) / np.linalg.norm(other)
            assert cosine > np.cos(np.radians(6.0)), joint


def test_a_pose_of_another_hand(make_take):
    source = build_take(make_take(sides=("right",), seed=5).take).hands[0]
    target = build_take(make_take(sides=("right",), seed=5).take).hands[0]
    armature = active(target)
    bpy.context.scene.frame_set(7)
    bpy.ops.manient.apply_take(source=source.armature.name, mode="POSE")
    np.testing.assert_allclose(
        joint_heads(armature, "right"), joint_heads(source.armature, "right"), atol=1e-5
    )
    assert len(read_pose_keys(rig_of(armature)).frames) == 12  # nothing was detected in frame 7


def test_corrections_of_replaced_frames_go(make_take):
    made = make_take(sides=("right",))
    armature = build_take(made.take).hands[0].armature
    field = {g: Correction({}, np.zeros((16, 3)), np.array([0.01, 0, 0])) for g in (4, 12, 30)}
    keep_field(armature, CorrectionField(field))
    apply_track(armature, made.take, made.take.hands[0], "POSE", 12.0, source_frame=5)
    assert sorted(corrections_of(armature).corrections) == [4, 30]
    apply_track(armature, made.take, made.take.hands[0], "ANIMATION", 1.0)
    assert sorted(corrections_of(armature).corrections) == [30]


def test_what_cannot_be_applied_is_one_sentence(make_take, tmp_path):
    made = make_take(sides=("right",))
    target = build_take(made.take).hands[0]
    active(target)
    with pytest.raises(RuntimeError, match="no such take file"):
        bpy.ops.manient.apply_take(filepath=str(tmp_path / "nothing.npz"))
    with pytest.raises(RuntimeError, match="not in this scene"):
        bpy.ops.manient.apply_take(source="Nobody")
    with pytest.raises(RuntimeError, match="gets the motion"):
        bpy.ops.manient.apply_take(source=target.armature.name)
    empty = replace(made.take, hands=()).save(tmp_path / "empty.npz")
    with pytest.raises(RuntimeError, match="has no hand in it"):
        bpy.ops.manient.apply_take(filepath=str(empty))
    bpy.ops.mesh.primitive_cube_add()
    with pytest.raises(OptionError, match="no captured hand"):
        apply_track(bpy.context.object, made.take, made.take.hands[0], "POSE", 1.0)
