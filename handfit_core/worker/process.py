"""One child process that speaks JSON lines; nobody here ever waits for it, and no thread runs for it."""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from handfit_core.errors import ProtocolError
from handfit_core.worker import protocol
from handfit_core.worker.pipes import ReadEnd, WriteEnd, new_pipe, wait_for
from handfit_core.worker.protocol import LONGEST_EVENT

_READ_BYTES = 1 << 14
"""bytes of the child's output that are read between two looks at the clock"""
_EXCHANGE_SECONDS = 0.004
"""seconds after which `exchange` reads, or writes, no more"""
_WRITE_WAIT_SECONDS = 0.001
"""seconds that a child which has just read gets to read on"""
_STDERR_TAIL_BYTES = 16_384
"""bytes of the child's stderr that are kept"""
_EXIT_SECONDS = 1.0
"""seconds after the end of its output in which the child must end; else it is killed"""
_POLL_SECONDS = 0.005
"""seconds between two looks at whether a child has ended"""
_KILL_WAIT_SECONDS = 0.01
"""seconds that a killed process gets to disappear; a large one needs more, and is asked for later"""

_PARENT_POLL_SECONDS = 1.0
"""seconds between two looks at whether the parent is still there"""

_killed: list[subprocess.Popen[Any]] = []
"""Processes that were killed; the system keeps their numbers until somebody asks how they ended"""


class ChildProcess:
    """A child that speaks JSON lines. Nothing blocks; `exchange` has to be called again and again.

    What it writes meanwhile waits in the pipes; when they are full, the child waits.
    """

    def __init__(self, command: Sequence[str], environment: dict[str, str], *, echo: bool = False) -> None:
        """Start it. `echo` repeats its stderr on ours. Raises OSError."""
        reap()
        (child_stdin, stdin), (stdout, child_stdout), (stderr, child_stderr) = (new_pipe() for _ in range(3))
        self._stdin, self._stdout, self._stderr = WriteEnd(stdin), ReadEnd(stdout), ReadEnd(stderr)
        try:
            self._process = subprocess.Popen(
                command,
                stdin=child_stdin,
                stdout=child_stdout,
                stderr=child_stderr,
                env=environment,
                **_own_group(),
            )
        except OSError:
            self._close()
            raise
        finally:
            for theirs in (child_stdin, child_stdout, child_stderr):
                os.close(theirs)
        self.pid = self._process.pid
        self.noise = 0
        """Lines on its stdout that were no messages"""
        self.line_too_long = False
        """Whether the child was cut off within a line that is longer than any message"""
        self.hung = False
        """Whether the child was killed because it had closed its output and did not end"""
        self._echo = echo
        self._stderr_tail = b""
        self._line: list[bytes] = []
        """The beginning of a line on its stdout"""
        self._line_size = 0
        self._received: list[dict[str, Any]] = []
        self._to_send: deque[memoryview] = deque()
        self._ending_since: float | None = None

    @property
    def exit_code(self) -> int | None:
        """None while it runs; -N where signal N ended it. What it has started ends with it."""
        if self._process.returncode is None and "start_new_session" in _own_group() and hasattr(os, "waitid"):
            with contextlib.suppress(OSError):
                # Until we ask for its end, nobody else's group can have its number.
                if os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None:
                    os.killpg(self.pid, signal.SIGKILL)
        return self._process.poll()

    def send(self, line: bytes) -> None:
        """Put one encoded message on its way; to a child that is gone it is lost."""
        self._to_send.append(memoryview(line))
        self._write()

    def exchange(self) -> None:
        """Read what it said, and write what it has not taken yet; for a few milliseconds at most."""
        self._write()
        until = time.perf_counter() + _EXCHANGE_SECONDS
        streams = [(self._stdout, self._take_output), (self._stderr, self._take_stderr)]
        # In turns: neither of them can keep us from hearing the other.
        while streams:
            streams = [stream for stream in streams if _read(*stream)]
            if time.perf_counter() > until:
                return

    def received(self) -> list[dict[str, Any]]:
        """The messages that `exchange` has read since the last call, in order."""
        messages, self._received = self._received, []
        return messages

    def wait_for_io(self, seconds: float) -> None:
        """Wait until `exchange` has something to read or write, at most for `seconds`."""
        wait_for((self._stdout, self._stderr), self._stdin if self._to_send else None, seconds)

    def ended(self) -> bool:
        """Whether it is over and everything it said was read; one that half ended is helped along."""
        exited = self.exit_code is not None
        if exited and self._stdout.closed and self._stderr.closed:
            return True
        if not exited and not self._stdout.closed:
            return False
        now = time.monotonic()
        self._ending_since = self._ending_since or now
        if now - self._ending_since < _EXIT_SECONDS:
            return False
        self.hung = not exited
        self.kill()
        return exited  # some other process holds its pipes: nothing of interest comes from there

    def stderr_tail(self) -> str:
        """The end of what the child wrote on stderr, with lines on stdout that were no messages."""
        return self._stderr_tail.decode("utf-8", errors="replace")

    def close_stdin(self) -> None:
        """Close the child's stdin, after which a worker ends by itself."""
        self._to_send.clear()
        self._stdin.close()

    def stop(self, seconds: float) -> None:
        """Close its stdin, which ends it, and kill it when that takes longer than `seconds`."""
        self.close_stdin()
        until = time.monotonic() + seconds
        while self.exit_code is None and (left := until - time.monotonic()) > 0:
            self.exchange()
            self.wait_for_io(min(_POLL_SECONDS, left))
        self.kill()

    def kill(self) -> None:
        """End it at once, with whatever it started; what it said last is read."""
        self.exchange()
        self._to_send.clear()
        self._close()
        if self.exit_code is not None:
            return
        with contextlib.suppress(OSError):
            if sys.platform == "win32":
                subprocess.run(
                    ["taskkill", "/T", "/F", "/PID", str(self.pid)], capture_output=True, check=False
                )
            elif os.getpgid(self.pid) == self.pid:
                os.killpg(self.pid, signal.SIGKILL)
            else:
                self._process.kill()
        try:
            self._process.wait(_KILL_WAIT_SECONDS)
        except subprocess.TimeoutExpired:
            _killed.append(self._process)

    def _close(self) -> None:
        for end in (self._stdin, self._stdout, self._stderr):
            end.close()

    def _write(self) -> None:
        until = time.perf_counter() + _EXCHANGE_SECONDS
        reads = False
        while self._to_send and time.perf_counter() < until:
            try:
                taken = self._stdin.write(self._to_send[0])
            except OSError:  # it is gone, as its stdout tells
                self._to_send.clear()
                self._stdin.close()
                return
            if not taken and not (reads and self._stdin.wait_for_room(_WRITE_WAIT_SECONDS)):
                return
            reads = taken > 0
            rest = self._to_send.popleft()[taken:]
            if rest:
                self._to_send.appendleft(rest)

    def _take_output(self, chunk: bytes) -> None:
        first, *others = chunk.split(b"\n")
        self._line.append(first)
        self._line_size += len(first)
        if self._line_size > LONGEST_EVENT:
            self.line_too_long = True
            self._line = []
            self._stdout.close()
            return
        noise: list[bytes] = []
        for other in others:
            line = b"".join(self._line)
            self._line, self._line_size = [other], len(other)
            if not line.strip():
                continue
            message = _message(line)
            if message is None:  # some library prints
                noise.append(line)
            else:
                self._received.append(message)
        if noise:
            self.noise += len(noise)
            self._keep_tail(b"\n".join(noise) + b"\n")

    def _take_stderr(self, chunk: bytes) -> None:
        self._keep_tail(chunk)
        if self._echo and sys.stderr is not None:
            sys.stderr.write(chunk.decode("utf-8", errors="replace"))

    def _keep_tail(self, text: bytes) -> None:
        self._stderr_tail = (self._stderr_tail + text)[-_STDERR_TAIL_BYTES:]


def out_of_memory_kills() -> int | None:
    """How many processes the system has killed since it started because memory ran out; None where it does
    not tell, which Linux alone does."""
    with contextlib.suppress(OSError), open("/proc/vmstat", "rb") as lines:
        for line in lines:
            if line.startswith(b"oom_kill "):
                return int(line.split()[1])
    return None


def end_with_parent(parent: int, end: Callable[[], None]) -> None:
    """Call `end` soon after that parent of this process has ended, however it did.

    Blender's process runs no threads, so a signal has to look, in the main thread; where there is none of the
    kind, as on Windows, nobody does.
    """
    if not hasattr(signal, "setitimer"):
        return

    def look(_number: int, _frame: object) -> None:
        if os.getppid() != parent:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            end()

    signal.signal(signal.SIGALRM, look)
    signal.siginterrupt(signal.SIGALRM, False)
    signal.setitimer(signal.ITIMER_REAL, _PARENT_POLL_SECONDS, _PARENT_POLL_SECONDS)
    # While Python ends, signals do again what they do by default, and this one's is to kill the process.
    atexit.register(signal.setitimer, signal.ITIMER_REAL, 0.0)


def reap() -> None:
    """Ask the system about the killed processes, so that it forgets them."""
    _killed[:] = [process for process in _killed if process.poll() is None]


def wait_for_killed(seconds: float) -> bool:
    """Wait until all killed processes are gone, which frees the files they had open; whether they are."""
    until = time.monotonic() + seconds
    while True:
        reap()
        if not _killed or time.monotonic() > until:
            return not _killed
        time.sleep(_POLL_SECONDS)


def _read(end: ReadEnd, take: Callable[[bytes], None]) -> bool:
    """Take one chunk; whether there was one."""
    if end.closed:
        return False
    chunk = end.read(_READ_BYTES)
    if chunk:
        take(chunk)
    elif chunk is not None:
        end.close()
    return bool(chunk)


def _message(line: bytes) -> dict[str, Any] | None:
    if not line.startswith(b"{"):  # a flood of other lines is dealt with quickly
        return None
    try:
        return protocol.decode(line)
    except ProtocolError:
        return None


SAME_GROUP = "HANDFIT_SAME_GROUP"
"""Set in the environment, processes belong to the group of who starts them, which may be killed as a whole"""


def _own_group() -> dict[str, Any]:
    """Popen's options for a process group of its own: no console window, and no share in a terminal's Ctrl-C,
    because ending the child is up to us."""
    if os.environ.get(SAME_GROUP):
        return {}
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NO_WINDOW | subprocess.CREATE_NEW_PROCESS_GROUP}
    return {"start_new_session": True}
