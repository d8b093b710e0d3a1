"""Hands to programs that speak the VMC protocol, as they move: of a take (`send`), or live (`live --vmc`).

Nothing else of the core opens a socket, and the add-on's zip does not have this file (SECURITY.md).

VMC is OSC 1.0 over UDP with the local rotations of Unity's bones. Unity's axes are left-handed, a mirror at
x = 0 of the humanoid frame: positions are (-x, y, z), rotations (x, -y, -z, w), and the left hand stays the
left one.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import socket
import struct
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np

from handfit_core.capturing.convert import add_input, take_of_input
from handfit_core.capturing.live.streaming import LiveHand, LivePose
from handfit_core.capturing.options import CaptureOptions
from handfit_core.capturing.pipeline import hand_summaries
from handfit_core.common.errors import OptionError, OutputError
from handfit_core.common.files import why
from handfit_core.common.skeleton import NUM_JOINTS, PARENTS, SIDES, Side
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.hand_model.axes import REST_FROM_MODEL
from handfit_core.hand_model.data import HandModel
from handfit_core.interchange.humanoid import BODY, HumanoidHand, bone_names, hands_of, unity_names
from handfit_core.retarget.transfer import SourceHand

_PORT: Final = 39539
"""where VMC's receivers listen"""
_BUNDLE: Final = b"#bundle\0" + struct.pack(">Q", 1)
"""What a bundle begins with, to be acted on at once"""


def add_send_command(commands: Any) -> None:
    """Add `send`, which sets `handler`, called as handler(args) -> exit code. It raises HandfitError for what
    the user can mend."""
    send = commands.add_parser(
        "send", help="play the hands of a take to a program that listens to the VMC protocol"
    )
    add_input(send)
    send.add_argument(
        "--vmc",
        default=f"127.0.0.1:{_PORT}",
        metavar="HOST:PORT",
        help=f"where that program listens (default: 127.0.0.1:{_PORT}, this machine)",
    )
    send.add_argument("--loop", action="store_true", help="begin anew at the end, until Ctrl+C")
    _add_wrist(send)
    send.set_defaults(handler=_send)


def add_vmc_option(live: argparse.ArgumentParser) -> None:
    """Let the command `live` send the hands that it follows."""
    live.add_argument("--vmc", metavar="HOST:PORT", help="send the fingers to a program that speaks VMC")
    _add_wrist(live)
    live.set_defaults(sender=_sender)


def _add_wrist(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--wrist",
        action="store_true",
        help="turn the hands too: straight in their first frame, with forearms that keep still",
    )


@contextlib.contextmanager
def _sender(args: argparse.Namespace, options: CaptureOptions) -> Iterator[Callable[[LivePose], None]]:
    """What sends a pose to where `--vmc` says."""
    models: dict[Side, HandModel] = {side: load_model(options.model, side) for side in SIDES}
    with LiveSender(*host_and_port(args.vmc), models, wrist=args.wrist) as sender:
        yield sender.send


def _send(args: argparse.Namespace) -> int:
    host, port = host_and_port(args.vmc)
    take = take_of_input(args)
    motion = VmcMotion.of(hands_of(take, wrist=args.wrist))
    started = time.perf_counter()
    sent, left_out = play(motion, host, port, 1.0 / take.fps, loop=args.loop)
    args.reporter.done(
        {
            "output": f"{host}:{port}",
            "frames": len(take.frame_numbers),
            "sent": sent,
            "left_out": left_out,
            "seconds": round(time.perf_counter() - started, 3),
            "hands": hand_summaries(take),
        }
    )
    return 0


def host_and_port(text: str) -> tuple[str, int]:
    """HOST, HOST:PORT or [IPV6]:PORT. Raises OptionError."""
    host, colon, port = text.rpartition(":")
    if not colon or text.endswith("]"):
        host, port = text, str(_PORT)
    host = host.removeprefix("[").removesuffix("]")
    if not host or not port.isdecimal() or not 0 < int(port) < 1 << 16:
        raise OptionError(f"--vmc names where to send to, as in 127.0.0.1:{_PORT}; got {text[:100]!r}")
    return host, int(port)


def osc_message(address: str, *values: str | float) -> bytes:
    """One OSC 1.0 message; numbers have 32 bits."""
    tags = {str: "s", int: "i", float: "f"}
    content = [_padded(v) if isinstance(v, str) else struct.pack(f">{tags[type(v)]}", v) for v in values]
    return _padded(address) + _padded("," + "".join(tags[type(v)] for v in values)) + b"".join(content)


def _padded(text: str) -> bytes:
    """ASCII, ended by one to four zeros so that the length is a multiple of four."""
    data = text.encode("ascii")
    return data + b"\0" * (4 - len(data) % 4)


@dataclass(frozen=True, eq=False)
class VmcMotion:
    """What is sent of hands: datagrams of each moment."""

    times: np.ndarray
    """(N,) seconds, increasing"""
    messages: list[list[bytes]]
    """N times, the messages of the bones"""

    @classmethod
    def of(cls, hands: Sequence[HumanoidHand]) -> VmcMotion:
        """Of hands over each moment that one of them is seen in; while a hand is not, nothing is said of
        it."""
        times = np.unique(np.concatenate([hand.times for hand in hands]))
        messages: list[list[bytes]] = [[] for _ in times]
        for hand in hands:
            names, rows = bone_names(hand.side), np.searchsorted(times, hand.times).tolist()
            forearm = np.array(BODY[BODY[names[0]][0]][1])
            for name, quats in hand.quats.items():
                joint = names.index(name)
                above = hand.heads[PARENTS[joint]] if joint else forearm
                place = (hand.heads[joint] - above) * [-1.0, 1.0, 1.0]
                told = np.column_stack([quats[:, 1:] * [1.0, -1.0, -1.0], quats[:, 0]])
                for row, turned in zip(rows, told.tolist(), strict=True):
                    values = (unity_names(hand.side)[joint], *place.tolist(), *turned)
                    messages[row].append(osc_message("/VMC/Ext/Bone/Pos", *values))
        return cls(times, messages)

    def datagrams(self, row: int, now: float) -> list[bytes]:
        """What is sent in one of the N moments, `now` seconds after the first was sent."""
        told = [osc_message("/VMC/Ext/OK", 1), osc_message("/VMC/Ext/T", float(now)), *self.messages[row]]
        found = [_BUNDLE]
        for message in told:
            element = struct.pack(">i", len(message)) + message
            # Of a datagram, so that no network cuts it in two
            if len(found[-1]) + len(element) > 1400:
                found.append(_BUNDLE)
            found[-1] += element
        return found


class LiveSender:
    """Sends the hands of a live run as they come. Use it as a context manager."""

    def __init__(
        self, host: str, port: int, models: Mapping[Side, HandModel], *, wrist: bool = False
    ) -> None:
        """`models`: those that the hands are posed with. `wrist`: take a hand as straight in the first frame
        that shows it, and the forearm as still. Raises OptionError for a host that there is not."""
        self._address, self._out = _socket_to(host, port)
        self._models, self._wrist = models, wrist
        self._straight: dict[Side, np.ndarray] = {}
        """(3, 3) rotation of each side's hand where it is straight, in the camera frame"""
        self._hands: dict[Side, tuple[bytes, SourceHand]] = {}
        """The shape for which each side's hand at rest was made, and that hand"""
        self._began: float | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._out.close()

    def send(self, pose: LivePose) -> None:
        """Send the bones of the hands of a frame, and its number and age as `/handfit/frame`. Raises
        OutputError."""
        self._began = pose.time if self._began is None else self._began
        hands = [self._humanoid(hand) for hand in pose.hands]
        messages = VmcMotion.of(hands).messages[0] if hands else []
        age = 1000.0 * (time.perf_counter() - pose.time)
        messages = [osc_message("/handfit/frame", pose.sequence, age), *messages]
        try:
            for datagram in VmcMotion(np.zeros(1), [messages]).datagrams(0, pose.time - self._began):
                self._out.sendto(datagram, self._address)
        except OSError as error:
            raise OutputError(f"--vmc: nothing can be sent to {self._address[0]} ({why(error)})") from error

    def _humanoid(self, hand: LiveHand) -> HumanoidHand:
        shape = hand.betas.tobytes()
        if self._hands.get(hand.side, (b"",))[0] != shape:
            shaped = self._models[hand.side].shaped(hand.betas)
            self._hands[hand.side] = shape, SourceHand.of(shaped, hand.side)
        pose = np.concatenate([hand.global_orient, hand.hand_pose]).reshape(1, NUM_JOINTS, 3)
        turns = rotvec_to_rotmat(pose)
        turns[0, 0] = self._straight.setdefault(hand.side, turns[0, 0].copy()).T @ turns[0, 0]
        turns = REST_FROM_MODEL @ turns @ REST_FROM_MODEL.T
        return HumanoidHand.of(self._hands[hand.side][1], np.zeros(1), turns, wrist=self._wrist)


def _socket_to(host: str, port: int) -> tuple[Any, socket.socket]:
    """An address and a socket that can send to it. Raises OptionError for a host that there is not."""
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    except (OSError, ValueError) as error:  # UnicodeError is a ValueError
        raise OptionError(f"--vmc: there is no host {host[:100]!r} ({why(error)})") from error
    return address, socket.socket(family, kind)


def play(motion: VmcMotion, host: str, port: int, frame: float, *, loop: bool = False) -> tuple[int, int]:
    """Send a motion in real time; `frame` is a frame's length in seconds. Moments that are late are left out.

    Returns how many were sent and left out. Raises OptionError for a host that there is not, and OutputError.
    """
    address, out = _socket_to(host, port)
    length = float(motion.times[-1]) + frame
    sent, left_out, began = 0, 0, time.perf_counter()
    try:
        with out:
            for turn in itertools.count() if loop else (0,):
                for row, moment in enumerate(motion.times.tolist()):
                    due = turn * length + moment
                    wait = due - (time.perf_counter() - began)
                    if wait < -frame:
                        left_out += 1
                        continue
                    time.sleep(max(wait, 0.0))
                    for datagram in motion.datagrams(row, due):
                        out.sendto(datagram, address)
                    sent += 1
    except OSError as error:
        raise OutputError(f"--vmc: nothing can be sent to {host}:{port} ({why(error)})") from error
    return sent, left_out
