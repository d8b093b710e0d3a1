"""One child process whose pipes are read and written by threads, so that nobody here ever waits for it."""

from __future__ import annotations

import atexit
import contextlib
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from typing import IO, Any

from handfit_core.errors import ProtocolError
from handfit_core.worker import protocol

_CHUNK = 1 << 16
_KEPT = 16_384
"""bytes of its stderr that are kept"""
_LINGER = 1.0
"""seconds between the end of its output and its own end, after which it is killed"""
_PATIENCE = 2.0
"""seconds that it gets, once its stdin is closed, to take its temporary files away"""


class ChildProcess:
    """A child that speaks JSON lines. Messages may be sent and taken at any time; nothing blocks.

    The pipes are used without Python's buffers: a buffer that a thread holds while the interpreter shuts
    down would abort Blender. Each thread closes its own pipe.
    """

    def __init__(self, command: Sequence[str], environment: dict[str, str], *, echo: bool = False) -> None:
        """Start it. `echo` repeats its stderr on ours. Raises OSError."""
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=environment,
            bufsize=0,
            **_apart(),
        )
        self.pid = self._process.pid
        self.noise = 0
        """Lines on its stdout that were no messages"""
        self._echo = echo
        self._said = b""
        self._received: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self._to_send: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._news = threading.Event()
        self._ending_since: float | None = None
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        assert self._process.stderr is not None
        self._stdout = _thread(self._read_messages, self._process.stdout)
        self._stderr = _thread(self._read_words, self._process.stderr)
        _thread(self._write, self._process.stdin)

    @property
    def exit_code(self) -> int | None:
        """None while it runs; -N where signal N ended it."""
        return self._process.poll()

    def send(self, line: bytes) -> None:
        """Put one encoded message on its way; to a child that is gone it is lost."""
        self._to_send.put(line)

    def received(self) -> list[dict[str, Any]]:
        """The messages since the last call, in order."""
        messages = []
        with contextlib.suppress(queue.Empty):
            while True:
                messages.append(self._received.get_nowait())
        return messages

    def wait_for_news(self, seconds: float) -> None:
        """Return when a message came or its output ended, or after `seconds`."""
        self._news.wait(seconds)
        self._news.clear()

    def ended(self) -> bool:
        """Whether it is over and everything it said was read; one that half ended is helped along."""
        exited = self._process.poll() is not None
        if exited and not self._stdout.is_alive() and not self._stderr.is_alive():
            return True
        if not exited and self._stdout.is_alive():
            return False
        now = time.monotonic()
        self._ending_since = self._ending_since or now
        if now - self._ending_since < _LINGER:
            return False
        self.kill()
        return exited  # some other process holds its pipes: nothing of interest comes from there

    def last_words(self) -> str:
        """The end of what it wrote on stderr."""
        return self._said.decode("utf-8", errors="replace")

    def stop(self, seconds: float) -> None:
        """Close its stdin, which ends it, and wait `seconds`; if it needs longer a thread kills it."""
        self._to_send.put(None)
        try:
            self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            _stopping.add(self)
            threading.Thread(target=self._finish, daemon=True).start()

    def _finish(self) -> None:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_PATIENCE)
        self.kill()
        self._process.wait()
        _stopping.discard(self)

    def kill(self) -> None:
        """End it at once, with whatever it started."""
        self._to_send.put(None)
        if self._process.poll() is not None:
            return
        with contextlib.suppress(OSError):
            if sys.platform == "win32":
                self._process.kill()
            else:
                os.killpg(self.pid, signal.SIGKILL)
        # The system needs a moment for a large process, and keeps its number until somebody has asked.
        threading.Thread(target=self._process.wait, daemon=True).start()

    def _read_messages(self, stream: IO[bytes]) -> None:
        parts: list[bytes] = []
        while chunk := _read(stream):
            first, *others = chunk.split(b"\n")
            parts.append(first)
            for other in others:
                self._take_line(b"".join(parts))
                parts = [other]
        self._news.set()

    def _take_line(self, line: bytes) -> None:
        if not line.strip():
            return
        try:
            message = protocol.decode(line)
        except ProtocolError:  # some library prints
            self.noise += 1
            self._remember(line + b"\n")
            return
        self._received.put(message)
        self._news.set()

    def _read_words(self, stream: IO[bytes]) -> None:
        while chunk := _read(stream):
            self._remember(chunk)
            if self._echo and sys.stderr is not None:
                sys.stderr.write(chunk.decode("utf-8", errors="replace"))

    def _remember(self, words: bytes) -> None:
        self._said = (self._said + words)[-_KEPT:]

    def _write(self, stream: IO[bytes]) -> None:
        with contextlib.suppress(OSError):  # it is gone, as its stdout tells
            while (line := self._to_send.get()) is not None:
                rest = memoryview(line)
                while rest:
                    rest = rest[os.write(stream.fileno(), rest) :]


_stopping: set[ChildProcess] = set()
"""Those that a thread would kill a little later; with the interpreter that thread would end, too"""


@atexit.register
def _kill_the_stopping() -> None:
    for child in list(_stopping):
        child.kill()


def _apart() -> dict[str, Any]:
    """No console window, and no share in a terminal's Ctrl-C: ending the child is up to us."""
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NO_WINDOW | subprocess.CREATE_NEW_PROCESS_GROUP}
    return {"start_new_session": True}


def _read(stream: IO[bytes]) -> bytes:
    try:
        return os.read(stream.fileno(), _CHUNK)
    except OSError:
        return b""


def _thread(use, stream: IO[bytes]) -> threading.Thread:
    def run() -> None:
        with contextlib.suppress(OSError), stream:
            use(stream)

    thread = threading.Thread(target=run, daemon=True, name="manient-worker")
    thread.start()
    return thread
