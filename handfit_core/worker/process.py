"""One child process that speaks JSON lines; nobody here ever waits for it, and no thread runs for it.

Threads are out of the question: Blender up to 5.0 can crash when one runs Python during an operator. So the
child inherits one end of a pair of connected sockets, which can be used without waiting on all systems, and
what it prints goes to a file without a name, which nobody has to read in time.
"""

from __future__ import annotations

import contextlib
import json
import os
import selectors
import socket
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Sequence
from typing import Any, BinaryIO

_READ_BYTES = 1 << 16
"""bytes of the child's output that are read between two looks at the clock"""
_EXCHANGE_SECONDS = 0.004
"""seconds after which `exchange` reads, or writes, no more"""
_BUFFER_BYTES = 1 << 20
"""bytes that a socket should hold, so that the child need not wait while Blender is busy"""
_STDERR_TAIL_BYTES = 16_384
"""Bytes from the end of the child's stderr that are kept for a bug report"""
_EXIT_SECONDS = 1.0
"""seconds after the end of its output in which the child must end; else it is killed"""
_KILL_WAIT_SECONDS = 0.01
"""seconds that a killed process gets to disappear; a large one needs more, and is asked for later"""

_CONNECTION = "HANDFIT_CONNECTION"
"""The environment variable that tells a child the number of its end of the connection"""

_NO_SIGNAL = getattr(socket, "MSG_NOSIGNAL", 0)
"""The flag with which the system does not kill Blender, which leaves SIGPIPE deadly, for writing to a child
that is gone"""
_SO_NOSIGPIPE = 0x1022
"""The option by which a socket on macOS raises no SIGPIPE; Python has no name for it"""

_killed: list[subprocess.Popen[Any]] = []
"""Processes that were killed; the system keeps their numbers until somebody asks how they ended"""


class ChildProcess:
    """A child that speaks JSON lines. Nothing blocks; `exchange` has to be called again and again.

    What it writes meanwhile waits in the socket; when that is full, the child waits.
    """

    def __init__(self, command: Sequence[str], environment: dict[str, str], *, echo: bool = False) -> None:
        """Start the child. `echo` repeats its stderr on ours. Raises OSError."""
        reap()
        self._socket, theirs = socket.socketpair()
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115 - it lasts as long as the child
        with theirs:
            try:
                # Windows connects the two over 127.0.0.1, where another program could have been faster.
                if self._socket.getpeername() != theirs.getsockname():
                    raise OSError("another program took the connection")
                for end in (self._socket, theirs):
                    end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER_BYTES)
                if sys.platform == "darwin":
                    self._socket.setsockopt(socket.SOL_SOCKET, _SO_NOSIGPIPE, 1)
                self._socket.setblocking(False)
                self._process = subprocess.Popen(
                    command,
                    env={**environment, _CONNECTION: str(theirs.fileno())},
                    **{"stdin": subprocess.DEVNULL, "stdout": self._stderr, "stderr": self._stderr},
                    **_inherits(theirs),
                )
            except OSError:
                self._socket.close()
                raise
        self.pid = self._process.pid
        self._echoed: int | None = 0 if echo else None
        """Bytes of the child's stderr that were repeated on ours; None where none are to be"""
        self._line: list[bytes] = []
        """The parts of a line of which the end has not come yet"""
        self._received: list[dict[str, Any]] = []
        self._to_send: deque[memoryview] = deque()
        self._closed = False
        """True if the child says nothing any more"""
        self._over = False
        """True if the child has ended, and everything that it said was read"""
        self._ending_since: float | None = None

    @property
    def exit_code(self) -> int | None:
        """The child's exit code; None while it runs; -N where signal N ended it."""
        return self._process.poll()

    def send(self, line: bytes) -> None:
        """Put one encoded message on its way to the child; it is lost if the child is gone."""
        self._to_send.append(memoryview(line))
        self._write(time.perf_counter() + _EXCHANGE_SECONDS)

    def exchange(self) -> None:
        """Read what the child said, and write what it has not taken yet; for a few milliseconds at most."""
        until = time.perf_counter() + _EXCHANGE_SECONDS
        exited = self.exit_code is not None  # before reading: then all of what it said is there
        self._write(until)
        while not self._closed and time.perf_counter() < until:
            try:
                chunk = self._socket.recv(_READ_BYTES)
            except BlockingIOError:
                self._over = exited  # whatever else still holds the socket has nothing to say
                break
            except OSError:
                chunk = b""
            self._closed = not chunk
            self._take(chunk)
        self._over = self._over or (exited and self._closed)
        if self._echoed is not None and sys.stderr is not None:
            begin, self._echoed = self._echoed, os.fstat(self._stderr.fileno()).st_size
            sys.stderr.write(self._read_stderr(begin, self._echoed))

    def received(self) -> list[dict[str, Any]]:
        """Return the messages that `exchange` has read since the last call, in order."""
        messages, self._received = self._received, []
        return messages

    def wait_for_io(self, seconds: float) -> None:
        """Wait until `exchange` has something to read or write, at most for `seconds`."""
        if self._closed:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(min(seconds, _EXIT_SECONDS))
            return
        with selectors.DefaultSelector() as selector:
            writing = selectors.EVENT_WRITE if self._to_send else 0
            selector.register(self._socket, selectors.EVENT_READ | writing)
            selector.select(seconds)

    def ended(self) -> bool:
        """Return whether the child is over and everything it said was read; one that only closed its output
        is killed."""
        if self._closed and not self._over:
            self._ending_since = self._ending_since or time.monotonic()
            if time.monotonic() - self._ending_since > _EXIT_SECONDS:
                self._over = True
                self.kill()
        return self._over

    def stderr_tail(self) -> str:
        """Return the end of what the child wrote on stderr."""
        end = os.fstat(self._stderr.fileno()).st_size
        return self._read_stderr(max(0, end - _STDERR_TAIL_BYTES), end)

    def stop(self, seconds: float) -> None:
        """Close the child's connection for requests, after which a worker ends by itself, and kill it when
        that takes longer than `seconds`."""
        self._to_send.clear()
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_WR)
        until = time.monotonic() + seconds
        while self.exit_code is None and (left := until - time.monotonic()) > 0:
            self.exchange()
            self.wait_for_io(left)
        self.kill()

    def kill(self) -> None:
        """End the child at once; what it said last is read."""
        self.exchange()
        self._to_send.clear()
        self._socket.close()
        self._closed = True
        self._process.kill()
        try:
            self._process.wait(_KILL_WAIT_SECONDS)
        except subprocess.TimeoutExpired:
            _killed.append(self._process)

    def _write(self, until: float) -> None:
        while self._to_send and time.perf_counter() < until:
            try:
                taken = self._socket.send(self._to_send[0][:_BUFFER_BYTES], _NO_SIGNAL)
            except BlockingIOError:
                return
            except OSError:  # it is gone, as reading tells
                self._to_send.clear()
                return
            rest = self._to_send.popleft()[taken:]
            if rest:
                self._to_send.appendleft(rest)

    def _take(self, chunk: bytes) -> None:
        first, *others = chunk.split(b"\n")
        self._line.append(first)
        for other in others:
            self._received.append(json.loads(b"".join(self._line)))
            self._line = [other]

    def _read_stderr(self, begin: int, end: int) -> str:
        if hasattr(os, "pread"):
            said = os.pread(self._stderr.fileno(), end - begin, begin)
        else:
            self._stderr.seek(begin)
            said = self._stderr.read(end - begin)
            self._stderr.seek(0, os.SEEK_END)  # the child writes where we stand
        return said.decode("utf-8", errors="replace")


def _inherits(end: socket.socket) -> dict[str, Any]:
    """Return Popen's options for a child that has this end of a connection, and a process group of its own:
    no console window, and no share in a terminal's Ctrl-C, because ending the child is up to us.

    On Windows a virtual environment's Python starts another one, which inherits it in its turn.
    """
    if sys.platform == "win32":
        end.set_inheritable(True)
        start = subprocess.STARTUPINFO(lpAttributeList={"handle_list": [end.fileno()]})
        flags = subprocess.CREATE_NO_WINDOW | subprocess.CREATE_NEW_PROCESS_GROUP
        return {"startupinfo": start, "creationflags": flags}
    return {"pass_fds": [end.fileno()], "start_new_session": True}


def own_streams() -> tuple[BinaryIO, BinaryIO]:
    """Return the streams of requests and of events of a process that `ChildProcess` has started."""
    connection = socket.socket(fileno=int(os.environ.pop(_CONNECTION)))
    connection.set_inheritable(False)
    return connection.makefile("rb"), connection.makefile("wb")


def reap() -> None:
    """Ask the system about the killed processes, so that it forgets them."""
    _killed[:] = [process for process in _killed if process.poll() is None]


def wait_for_killed(seconds: float) -> bool:
    """Wait at most so long until all killed processes are gone, which frees their open files; return whether
    they are."""
    until = time.monotonic() + seconds
    for process in _killed:
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(max(0.0, until - time.monotonic()))
    reap()
    return not _killed
