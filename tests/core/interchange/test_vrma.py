"""VRM animations: what the file says by itself, and what three-vrm shows on a model when it plays it."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from handfit_core.__main__ import main
from handfit_core.errors import OptionError
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.hand_model.axes import REST_FROM_MODEL, bone_frames
from handfit_core.interchange.formats.vrma import vrm_animation
from handfit_core.interchange.humanoid import HumanoidHand, hands_of
from handfit_core.interchange.writers import writer_for
from handfit_core.skeleton import FINGER_JOINTS, SIDES
from handfit_core.take import Take
from tests.core.interchange.humanoids import NUMBERS, Played, apart, clip, directions, named, wanted
from tests.core.interchange.vrm.model import vrm_model

REQUIRED = {
    *("hips", "spine", "head", "leftUpperLeg", "leftLowerLeg", "leftFoot", "rightUpperLeg", "rightLowerLeg"),
    *("rightFoot", "leftUpperArm", "leftLowerArm", "leftHand", "rightUpperArm", "rightLowerArm", "rightHand"),
}
"""Bones without which there is no humanoid in VRM 1.0"""


def written(take: Take, folder: Path, wrist: bool = False) -> Path:
    path = folder / "clip.vrma"
    writer = writer_for(path)
    write = writer.write_wrist if wrist else writer.write
    assert write is not None
    write(take, path)
    return path


def rows_and_times(take: Take, number: int):
    """A hand's rows that it is seen in, and when that is."""
    track = take.hands[number]
    return [(r, (int(NUMBERS[r]) - int(NUMBERS[0])) / take.fps) for r in np.flatnonzero(track.present)]


def test_fingers_point_as_captured_and_in_time(tmp_path):
    take = clip()
    played = Played(written(take, tmp_path).read_bytes())
    for number, track in enumerate(take.hands):
        times = [time for _, time in rows_and_times(take, number)]
        keyed = played.tracks[played.bones[f"{track.side}IndexProximal"]][0]
        np.testing.assert_allclose(keyed, times, atol=1e-7)
        for row, time in rows_and_times(take, number):
            shown = directions(named(played.places(time), track.side))
            assert apart(shown, wanted(track, row)) < 1e-3, (track.side, row)
    (one,) = hands_of(clip(("right",)))
    one = HumanoidHand("right", one.times[:1], {n: q[:1] for n, q in one.quats.items()}, one.heads)
    shown = directions(named(Played(vrm_animation([one])).places(0.0), "right"))
    assert apart(shown, wanted(clip(("right",)).hands[0], 0)) < 1e-3


def test_the_humanoid_is_whole_and_rests_in_vrms_t_pose(tmp_path):
    played = Played(written(clip(), tmp_path).read_bytes())
    assert set(played.bones) >= REQUIRED
    assert len(set(played.bones.values())) == len(played.bones)
    rest = played.places(None)
    for side, sideways in (("left", 1.0), ("right", -1.0)):
        shown = directions(named(rest, side)).reshape(5, 3, 3)
        np.testing.assert_allclose(shown[1:], np.broadcast_to([sideways, 0.0, 0.0], (4, 3, 3)), atol=1e-6)
        thumb = np.array([sideways, 0.0, 1.0]) / np.sqrt(2.0)
        np.testing.assert_allclose(shown[0], np.tile(thumb, (3, 1)), atol=1e-6)
        arm = rest[f"{side}Hand"] - rest[f"{side}UpperArm"]
        np.testing.assert_allclose(arm / np.linalg.norm(arm), [sideways, 0.0, 0.0], atol=1e-6)
    assert rest["head"][1] > rest["hips"][1] > rest["leftFoot"][1] > 0.0


@pytest.mark.parametrize("side", SIDES)
def test_the_thumbs_nail_faces_as_captured(side, tmp_path):
    """VRM's nail is square to the thumb in the palm's plane, between the other hand and the front."""
    played = Played(written(clip((side,)), tmp_path).read_bytes())
    shaped = load_model(None, side).shaped()
    _, turn = played.place(played.bones[f"{side}ThumbDistal"], 0.0)
    theirs = np.array([-1.0 if side == "left" else 1.0, 0.0, 1.0]) / np.sqrt(2.0)
    ours = -REST_FROM_MODEL.T @ bone_frames(shaped, side)[FINGER_JOINTS["thumb"][2]][:, 2]
    flat = rotvec_to_rotmat(clip((side,)).hands[0].hand_pose[0].reshape(15, 3))
    for joint in reversed(FINGER_JOINTS["thumb"]):
        ours = flat[joint - 1] @ ours
    assert apart((turn @ theirs)[None], ours[None]) < 9.0


def test_wrists_turn_only_where_that_is_asked_for(tmp_path):
    take = clip(("right",))
    plain = Played(written(take, tmp_path).read_bytes())
    assert plain.bones["rightHand"] not in plain.tracks
    turned = Played(written(take, tmp_path, wrist=True).read_bytes())
    root = rotvec_to_rotmat(take.hands[0].global_orient)
    for row, time in rows_and_times(take, 0):
        _, shown = turned.place(turned.bones["rightHand"], time)
        np.testing.assert_allclose(shown, root[0].T @ root[row], atol=1e-6)


def test_takes_that_no_humanoid_can_hold_are_refused(tmp_path):
    with pytest.raises(OptionError, match="2 left hands"):
        written(clip(("left", "left")), tmp_path)
    with pytest.raises(OptionError, match="no hand"):
        written(replace(clip(), hands=()), tmp_path)
    assert not (tmp_path / "clip.vrma").exists()


def test_convert_writes_it(tmp_path, capsys):
    clip().save(tmp_path / "clip.take.npz")
    command = ["convert", str(tmp_path / "clip.take.npz"), "-o"]
    assert main([*command, str(tmp_path / "out.vrma")]) == 0
    assert Played((tmp_path / "out.vrma").read_bytes()).bones["leftRingDistal"]
    assert main([*command, str(tmp_path / "out.points.json"), "--wrist"]) == 1
    assert "--wrist is no question where Points is written" in capsys.readouterr().err


@pytest.fixture(scope="session")
def clients() -> Path:
    """The folder with three-vrm and Khronos' validator, which nox installs."""
    folder = Path(os.environ.get("HANDFIT_VRM_CLIENTS", ""))
    if not os.environ.get("HANDFIT_VRM_CLIENTS") or shutil.which("node") is None:
        pytest.skip("three-vrm and the glTF validator are not here; nox installs them where there is npm")
    assert (folder / "node_modules").is_dir()
    return folder


@pytest.mark.parametrize("wrist", [False, True])
def test_three_vrm_plays_it_and_khronos_accepts_it(clients, tmp_path, wrist):
    """On a model of other proportions whose bones are turned anyhow at rest."""
    take = clip()
    (tmp_path / "model.vrm").write_bytes(vrm_model())
    path = written(take, tmp_path, wrist=wrist)
    times = [time for _, time in rows_and_times(take, 1)]
    script = Path(__file__).with_name("vrm") / "play.mjs"
    command = ["node", script, clients, tmp_path / "model.vrm", path, *map(str, times)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert (told["issues"]["numErrors"], told["issues"]["numWarnings"]) == (0, 0), told["issues"]
    assert told["duration"] == pytest.approx(0.25)
    for number, track in enumerate(take.hands):
        for row, time in rows_and_times(take, number):
            shown = directions(named(told["shown"][times.index(time)], track.side))
            root = rotvec_to_rotmat(track.global_orient[[0, row]])
            turn = root[0].T @ root[1] if wrist else np.eye(3)
            assert apart(shown, wanted(track, row) @ turn.T) < 1e-3, (track.side, row)
