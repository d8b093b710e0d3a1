"""Doors that do what no case may do: test_engine.py sees that each is caught."""

from __future__ import annotations

import os
import socket
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from handfit_core.errors import InputError


def _refuse(text: str = "a sentence") -> None:
    raise InputError(text)


def _raise() -> None:
    raise ValueError("no sentence for an artist")


def _exit() -> None:
    raise SystemExit(3)


def _eat(size: int) -> None:
    np.ones(size, dtype=np.uint8)


def _connect(port: int) -> None:
    socket.create_connection(("127.0.0.1", port)).close()


def _compute() -> None:
    while True:
        pass


def _say(text: str) -> None:
    print(text, file=sys.stderr)


DOORS: dict[str, Callable[..., Any]] = {
    "nothing": lambda: None,
    "refuse": _refuse,
    "raise": _raise,
    "exit": _exit,
    "abort": os.abort,
    "leave": lambda: os._exit(0),
    "eat": _eat,
    "compute": _compute,
    "sleep": lambda: time.sleep(3600),
    "connect": _connect,
    "say": _say,
    "write": lambda name: Path(name).write_bytes(b"x"),
    "remove": lambda name: Path(name).unlink(),
}
