"""BVH files of the core in Blender's own importer: joints stand where the take has them."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model import load_model
from handfit_core.interchange.formats.bvh import WRITER
from handfit_core.skeleton import FINGER_JOINTS, FINGERS, SIDES
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
