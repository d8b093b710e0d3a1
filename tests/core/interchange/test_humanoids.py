"""Humanoids: what a .vrma shows, also in three-vrm, and what receivers of VMC are sent, by python-osc."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from pythonosc.osc_packet import OscPacket

from handfit_core.__main__ import main
from handfit_core.capturing.live import send
from handfit_core.capturing.live.send import VmcMotion, host_and_port
from handfit_core.common.errors import OptionError, OutputError
from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, PARENTS, SIDES
from handfit_core.geometry.rotations import quat_to_rotmat, rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.hand_model.axes import REST_FROM_MODEL, bone_frames
from handfit_core.interchange.formats.vrma import vrm_animation
from handfit_core.interchange.humanoid import BODY, HumanoidHand, hands_of
from handfit_core.interchange.writers import writer_for
from handfit_core.take import Take
from tests.conftest import ROOT
from tests.core.interchange.humanoids import NUMBERS, UNSEEN, Played, apart, clip, directions, named, wanted
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
        times = [moment for _, moment in rows_and_times(take, number)]
        keyed = played.tracks[played.bones[f"{track.side}IndexProximal"]][0]
        np.testing.assert_allclose(keyed, times, atol=1e-7)
        for row, moment in rows_and_times(take, number):
            shown = directions(named(played.places(moment), track.side))
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
    for row, moment in rows_and_times(take, 0):
        _, shown = turned.place(turned.bones["rightHand"], moment)
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
    times = [moment for _, moment in rows_and_times(take, 1)]
    script = Path(__file__).with_name("vrm") / "play.mjs"
    command = ["node", script, clients, tmp_path / "model.vrm", path, *map(str, times)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert (told["issues"]["numErrors"], told["issues"]["numWarnings"]) == (0, 0), told["issues"]
    assert told["duration"] == pytest.approx(0.25)
    for number, track in enumerate(take.hands):
        for row, moment in rows_and_times(take, number):
            shown = directions(named(told["shown"][times.index(moment)], track.side))
            root = rotvec_to_rotmat(track.global_orient[[0, row]])
            turn = root[0].T @ root[1] if wrist else np.eye(3)
            assert apart(shown, wanted(track, row) @ turn.T) < 1e-3, (track.side, row)


# VMC

MIRROR = np.diag([-1.0, 1.0, 1.0])


@dataclass
class Inbox:
    """A socket that waits for datagrams; a frame goes from one /VMC/Ext/T to the next."""

    socket: socket.socket
    frames: list[dict[str, list[float]]] = field(default_factory=list)
    moments: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.port = self.socket.getsockname()[1]
        self.target = ["--vmc", f"127.0.0.1:{self.port}"]

    def take_in(self, seconds: float = 0.5) -> int:
        """Take what has arrived, or arrives within some time; how many frames there are then."""
        self.socket.settimeout(seconds)
        with contextlib.suppress(TimeoutError):
            while True:
                data = self.socket.recv(65536)
                assert len(data) <= 1400
                for message in (each.message for each in OscPacket(data).messages):
                    address, values = message.address, [*message.params]
                    if address == "/VMC/Ext/T":
                        self.moments += values
                        self.frames.append({})
                    elif address == "/VMC/Ext/OK":
                        assert values == [1]
                    else:
                        assert address == "/VMC/Ext/Bone/Pos"
                        self.frames[-1][values[0]] = values[1:]
                self.socket.settimeout(0.05)
        return len(self.moments)


@pytest.fixture
def inbox() -> Iterator[Inbox]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as waiting:
        waiting.bind(("127.0.0.1", 0))
        yield Inbox(waiting)


def shown(bones: dict[str, list[float]], side: str) -> np.ndarray:
    """(15, 3) where a Unity humanoid's fingers point, whose hand lies as in the T-pose: its axes are
    left-handed, and so is its left hand at -x."""
    places, turns = np.zeros((21, 3)), np.broadcast_to(np.eye(3), (16, 3, 3)).copy()
    for finger, joints in FINGER_JOINTS.items():
        for joint, part in zip(joints, ("Proximal", "Intermediate", "Distal"), strict=True):
            *place, x, y, z, w = bones[f"{side.title()}{finger.title()}{part}"]
            above = PARENTS[joint]
            places[joint] = places[above] + turns[above] @ np.array(place)
            turns[joint] = turns[above] @ quat_to_rotmat(np.array([w, x, y, z]))
        along = np.array([-1.0 if side == "left" else 1.0, 0.0, float(finger == "thumb")])
        places[16 + FINGERS.index(finger)] = places[joints[2]] + turns[joints[2]] @ along
    return directions(places)


def test_a_humanoid_moves_as_captured_and_in_time(inbox, tmp_path, capsys):
    take = clip(fps=20.0)
    path, began = take.save(tmp_path / "clip.take.npz"), time.perf_counter()
    assert main(["send", str(path), *inbox.target]) == 0
    assert time.perf_counter() - began > 0.2
    assert inbox.take_in() == 5
    np.testing.assert_allclose(inbox.moments, [0.0, 0.05, 0.1, 0.2, 0.25], atol=1e-6)
    for track in take.hands:
        for row in np.flatnonzero(track.present):
            mirrored = wanted(track, row) @ MIRROR
            assert apart(shown(inbox.frames[row], track.side), mirrored) < 1e-3, (track.side, row)
    assert not [name for name in inbox.frames[UNSEEN] if name.startswith("Left")]
    assert not [name for frame in inbox.frames for name in frame if name.endswith("Hand")]
    assert f"127.0.0.1:{inbox.port}: left hand in 4 of 5 frames" in capsys.readouterr().err


def test_wrists_turn_at_the_end_of_the_forearm(inbox, tmp_path):
    take = clip(("right",), fps=20.0)
    assert main(["send", str(take.save(tmp_path / "clip.take.npz")), *inbox.target, "--wrist"]) == 0
    assert inbox.take_in() == 5
    root = rotvec_to_rotmat(take.hands[0].global_orient)
    for row, frame in enumerate(inbox.frames):
        *place, x, y, z, w = frame["RightHand"]
        turned = MIRROR @ quat_to_rotmat(np.array([w, x, y, z])) @ MIRROR
        np.testing.assert_allclose(turned, root[0].T @ root[row], atol=1e-6)
        forearm = np.subtract(BODY["rightHand"][1], BODY["rightLowerArm"][1])
        np.testing.assert_allclose(place, MIRROR @ forearm, atol=1e-6)


def test_it_plays_in_a_loop_until_it_is_stopped(inbox, tmp_path):
    path = clip().save(tmp_path / "clip.take.npz")
    command = [sys.executable, "-m", "handfit_core", "send", path, "--loop", *inbox.target]
    with subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True) as child:
        while inbox.take_in(60.0) < 12 and child.poll() is None:
            pass
        child.send_signal(2)
        assert child.stderr is not None
        assert "stopped" in child.stderr.read()
    assert child.returncode == 130
    assert len(inbox.moments) >= 12
    assert inbox.moments == sorted(inbox.moments)


@pytest.mark.parametrize(
    ("said", "found"),
    [
        ("127.0.0.1:39540", ("127.0.0.1", 39540)),
        ("studio-pc", ("studio-pc", 39539)),
        ("[::1]:39540", ("::1", 39540)),
        ("[::1]", ("::1", 39539)),
        *((wrong, None) for wrong in ("", "here:", "here:65536")),
    ],
)
def test_where_to(said, found):
    if found is not None:
        assert host_and_port(said) == found
        return
    with pytest.raises(OptionError, match=r"127\.0\.0\.1:39539; got"):
        host_and_port(said)


def test_hosts_and_networks_that_are_not_there(inbox, monkeypatch):
    motion = VmcMotion.of(hands_of(clip(("right",))))
    with pytest.raises(OptionError, match="--vmc: there is no host"):
        send.play(motion, "x" * 300, 39539, 0.05)
    monkeypatch.setattr(VmcMotion, "datagrams", lambda *_: [b"\0" * 70_000])  # more than a datagram holds
    with pytest.raises(OutputError, match="nothing can be sent to 127"):
        send.play(motion, "127.0.0.1", inbox.port, 0.05)
