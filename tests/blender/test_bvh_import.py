"""BVH files of the core in Blender's own importer: joints stand where the take has them."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_manient.exporters.export_hands import export_take
from blender_manient.scene.build import build_take
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.interchange.formats.bvh import WRITER
from handfit_core.interchange.opening import read_recording
from handfit_core.options import CaptureOptions
from handfit_core.skeleton import FINGER_JOINTS, FINGERS, SIDES, Side
from tests.takes import take_of, track_of

from .conftest import world

CAMERA = Intrinsics(1000.0, 1000.0, 640.0, 360.0)
FRAMES = 4


def test_blender_reads_the_hands_where_they_are(tmp_path: Path) -> None:
    rng, tracks = np.random.default_rng(0), []
    for side in SIDES:
        place = np.array([0.1 if side == "left" else -0.1, 0.0, 0.8]) + rng.uniform(-0.05, 0.05, (FRAMES, 3))
        orient, pose = rng.uniform(-1.5, 1.5, (FRAMES, 3)), rng.uniform(-0.5, 0.5, (FRAMES, 45))
        tracks.append(track_of(side, orient, pose, place, CAMERA))
    WRITER.write(
        take_of(tracks, CAMERA, 1280, 720, fps=30.0, frame_numbers=np.arange(1, FRAMES + 1)),
        tmp_path / "hands.bvh",
    )
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_anim.bvh(filepath=str(tmp_path / "hands.bvh"), global_scale=0.01, update_scene_fps=True)
    (armature,) = bpy.data.objects
    assert bpy.context.scene.render.fps == 30
    middles = []
    for row in range(FRAMES):
        bpy.context.scene.frame_set(1 + row)
        for track in tracks:
            name = f"{track.side.title()}Hand"

            def head(bone: str) -> np.ndarray:
                return np.array(armature.matrix_world @ armature.pose.bones[bone].head)

            model = load_model(None, track.side)
            true = model.posed(None, track.global_orient[row], track.hand_pose[row], track.transl[row])
            bones = {
                f: [f"{name}{'Pinky' if f == 'little' else f.title()}{n}" for n in (1, 2, 3)] for f in FINGERS
            }
            found = np.array([head(name), *(head(bones[f][0]) for f in FINGERS)])
            joints = world(true.joints)
            wanted = joints[[0, *(FINGER_JOINTS[f][0] for f in FINGERS)]]
            middles.append(found[0] - wanted[0])
            np.testing.assert_allclose(found - found[0], wanted - wanted[0], atol=2e-5)
            for finger in FINGERS:
                first, second, third = FINGER_JOINTS[finger]
                a, b, c = (head(bone) for bone in bones[finger])
                np.testing.assert_allclose(b - a, joints[second] - joints[first], atol=2e-5)
                np.testing.assert_allclose(c - b, joints[third] - joints[second], atol=2e-5)
    assert np.abs(middles).max() < 2e-5, "the hands stand before the camera at the origin"


@pytest.mark.parametrize("side", SIDES)
def test_the_core_reads_what_blender_exports(make_take, tmp_path: Path, side: Side) -> None:
    """The same angles, in the frames that the take has seen; places, too, and the hand's own shape."""
    made = make_take(sides=(side,))
    (path,) = export_take(build_take(made.take), made.take, tmp_path, "x", "bvh")
    recording = read_recording(path, CaptureOptions())
    (hand,), track = recording.posed, made.take.hands[0]
    for row, frame in made.seen:
        at = frame - int(made.take.frame_numbers[0])
        for found, true in (
            (hand.global_orient[at], track.global_orient[row]),
            (hand.hand_pose[at], track.hand_pose[row]),
        ):
            ours, theirs = (rotvec_to_rotmat(np.reshape(x, (-1, 3))) for x in (found, true))
            np.testing.assert_allclose(ours, theirs, atol=2e-3)
        model = load_model(made.take.model, side)
        joints = model.posed(hand.betas, hand.global_orient[at], hand.hand_pose[at], hand.transl[at]).joints
        np.testing.assert_allclose(joints, made.joints[side][row], atol=3e-4)
