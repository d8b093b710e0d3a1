"""VMC as its receivers see it: datagrams that arrive at a socket of this machine, taken apart as OSC says."""

from __future__ import annotations

import contextlib
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest

from handfit_core.__main__ import main
from handfit_core.errors import OptionError, OutputError
from handfit_core.geometry.rotations import quat_to_rotmat, rotvec_to_rotmat
from handfit_core.interchange import send
from handfit_core.interchange.humanoid import BODY, hands_of
from handfit_core.interchange.send import VmcMotion, host_and_port, osc_message
from handfit_core.skeleton import FINGER_JOINTS, FINGERS, PARENTS
from tests.conftest import ROOT
from tests.core.interchange.humanoids import UNSEEN, apart, clip, directions, wanted

MIRROR = np.diag([-1.0, 1.0, 1.0])


@dataclass
class Inbox:
    """A socket that waits for datagrams; a frame goes from one /VMC/Ext/T to the next."""

    socket: socket.socket
    frames: list[dict[str, list[float]]] = field(default_factory=list)
    moments: list[float] = field(default_factory=list)

    @property
    def target(self) -> list[str]:
        return ["--vmc", f"127.0.0.1:{self.port}"]

    @property
    def port(self) -> int:
        return self.socket.getsockname()[1]

    def take_in(self, seconds: float = 0.5) -> int:
        """Take what has arrived, or arrives within some time; how many frames there are then."""
        self.socket.settimeout(seconds)
        with contextlib.suppress(TimeoutError):
            while True:
                data = self.socket.recv(65536)
                assert len(data) <= 1400
                for address, values in taken_apart(data):
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


def taken_apart(data: bytes) -> list[tuple[str, list]]:
    """Messages of an OSC packet: address and values."""
    if data[:8] == b"#bundle\0":
        found, place = [], 16
        while place < len(data):
            (size,) = struct.unpack_from(">i", data, place)
            found += taken_apart(data[place + 4 : place + 4 + size])
            place += 4 + size
        assert place == len(data)
        return found
    assert len(data) % 4 == 0
    values, place = [], 0

    def text() -> str:
        nonlocal place
        end = data.index(b"\0", place)
        word, place = data[place:end].decode("ascii"), end // 4 * 4 + 4
        return word

    address, tags = text(), text()
    assert tags[0] == ","
    for tag in tags[1:]:
        values.append(text() if tag == "s" else struct.unpack_from(f">{tag}", data, place)[0])
        place += 0 if tag == "s" else 4
    assert place == len(data)
    return [(address, values)]


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


def test_moments_that_are_late_are_left_out(inbox, monkeypatch):
    now = iter([0.0, 0.0, 0.05, 9.0, 9.0, 9.0])
    clock = SimpleNamespace(perf_counter=lambda: next(now), sleep=lambda _: None)
    monkeypatch.setattr(send, "time", clock)
    motion = VmcMotion.of(hands_of(clip(("right",))))
    assert send.play(motion, "127.0.0.1", inbox.port, 0.05) == (2, 3)
    assert inbox.take_in() == 2


@pytest.mark.parametrize(
    ("said", "found"),
    [
        ("127.0.0.1:39540", ("127.0.0.1", 39540)),
        ("studio-pc", ("studio-pc", 39539)),
        ("[::1]:39540", ("::1", 39540)),
        ("[::1]", ("::1", 39539)),
        *((wrong, None) for wrong in ("", ":39539", "here:", "here:port", "here:0", "here:65536", "[]:1")),
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


def test_messages_are_oscs():
    assert osc_message("/a", "xyz", 1, 0.5) == b"/a\0\0,sif\0\0\0\0xyz\0\0\0\0\x01\x3f\0\0\0"
