"""The command `send`: the hands of a take to programs that speak the VMC protocol, as they move."""

from __future__ import annotations

import argparse
import itertools
import socket
import time
from typing import Any, Final

from handfit_core.errors import OptionError, OutputError
from handfit_core.files import why
from handfit_core.interchange.commands import add_input, take_of_input
from handfit_core.interchange.humanoid import hands_of
from handfit_core.interchange.vmc import VmcMotion
from handfit_core.pipeline import hand_summaries

_PORT: Final = 39539
"""where VMC's receivers listen"""


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
    send.add_argument(
        "--wrist",
        action="store_true",
        help="turn the hands too: straight in their first frame, with forearms that keep still",
    )
    send.set_defaults(handler=_send)


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


def play(motion: VmcMotion, host: str, port: int, frame: float, *, loop: bool = False) -> tuple[int, int]:
    """Send a motion in real time; `frame` is a frame's length in seconds. Moments that are late are left out.

    Returns how many were sent and left out. Raises OptionError for a host that there is not, and OutputError.
    """
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    except (OSError, ValueError) as error:  # UnicodeError is a ValueError
        raise OptionError(f"--vmc: there is no host {host[:100]!r} ({why(error)})") from error
    length = float(motion.times[-1]) + frame
    sent, left_out, began = 0, 0, time.perf_counter()
    try:
        with socket.socket(family, kind) as out:
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
