"""Pipes to and from a child process that are used without waiting, and without threads.

Threads are out of the question here: Blender up to 5.0 can crash when one runs Python during an operator.
On Unix our ends are simply not blocking. Windows learns that in Python 3.12 only; until then a reader asks
how much lies in the pipe, and a writer has the pipe take what fits. **The Windows half was not run.**
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time
from collections.abc import Sequence

if sys.platform == "win32":
    import _winapi
    import msvcrt
else:
    import fcntl
    import select

_SIZE = 1 << 20
"""bytes that a pipe should hold, so that the child need not wait while Blender is busy; a wish: macOS gives
64 kB"""
_PIPE_NOWAIT = 1
"""Windows' name for a pipe that does not block"""
_POLL_SECONDS = 0.002
"""seconds between two looks, where the system cannot wait for pipes"""


class _End:
    """Our end of a pipe."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        if sys.platform != "win32":
            os.set_blocking(descriptor, False)

    @property
    def descriptor(self) -> int:
        """The file descriptor; -1 once it is closed."""
        return self._descriptor

    @property
    def closed(self) -> bool:
        """Whether nothing comes or goes any more."""
        return self._descriptor < 0

    def close(self) -> None:
        """Close it; of a second time: nothing."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            with contextlib.suppress(OSError):
                os.close(descriptor)


class ReadEnd(_End):
    """Our end of a pipe into which a child writes."""

    def read(self, most: int) -> bytes | None:
        """Up to `most` bytes that are there; None while there are none, b"" when none will come any more."""
        try:
            if sys.platform == "win32":
                available = _readable_bytes(self)
                return os.read(self._descriptor, min(available, most)) if available else None
            return os.read(self._descriptor, most)
        except BlockingIOError:
            return None
        except OSError:  # on Windows also the ordinary end
            return b""


class WriteEnd(_End):
    """Our end of a pipe from which a child reads."""

    def __init__(self, descriptor: int) -> None:
        super().__init__(descriptor)
        if sys.platform == "win32":
            handle = msvcrt.get_osfhandle(descriptor)
            _winapi.SetNamedPipeHandleState(handle, _PIPE_NOWAIT, None, None)

    def write(self, data: memoryview) -> int:
        """How many of the bytes the pipe took; 0 while it is full. Raises OSError when nobody reads there."""
        if sys.platform == "win32":
            handle = msvcrt.get_osfhandle(self._descriptor)
            # A part that does not fit as a whole may be refused as a whole.
            for size in (1 << 16, 1 << 12, 1 << 8):
                written, _ = _winapi.WriteFile(handle, bytes(data[:size]))
                if written:
                    return written
            return 0
        try:
            return _write_without_signal(self._descriptor, data)
        except BlockingIOError:
            return 0

    def wait_for_room(self, seconds: float) -> bool:
        """Whether the pipe takes something within that time."""
        if sys.platform == "win32":
            time.sleep(seconds)
            return True
        return wait_for([], self, seconds)


def wait_for(readers: Sequence[ReadEnd], writer: WriteEnd | None, seconds: float) -> bool:
    """Return True when something can be read, has ended, or can be written, or False after `seconds`."""
    open_readers = [end for end in readers if not end.closed]
    if writer is not None and writer.closed:
        writer = None
    if sys.platform == "win32":
        until = time.monotonic() + seconds
        while not any(_is_readable(end) for end in open_readers):
            if time.monotonic() > until:
                return False
            time.sleep(min(_POLL_SECONDS, seconds))
            if writer is not None:
                return True
        return True
    if not open_readers and writer is None:
        time.sleep(seconds)
        return False
    # Not select(), which takes no descriptor above 1023.
    waiting = select.poll()
    for end in open_readers:
        waiting.register(end.descriptor, select.POLLIN)
    if writer is not None:
        waiting.register(writer.descriptor, select.POLLOUT)
    return bool(waiting.poll(seconds * 1000))


def new_pipe() -> tuple[int, int]:
    """Descriptors of the end that is read and of the one that is written. Raises OSError."""
    if sys.platform == "win32":
        read, write = _winapi.CreatePipe(None, _SIZE)
        return msvcrt.open_osfhandle(read, os.O_RDONLY), msvcrt.open_osfhandle(write, 0)
    read, write = os.pipe()
    if hasattr(fcntl, "F_SETPIPE_SZ"):
        with contextlib.suppress(OSError):  # a user may have so many such pipes, and no more
            fcntl.fcntl(write, fcntl.F_SETPIPE_SZ, _SIZE)
    return read, write


if sys.platform == "win32":

    def _readable_bytes(end: ReadEnd) -> int:
        """How many bytes can be read. Raises OSError when none are left and none will come."""
        return _winapi.PeekNamedPipe(msvcrt.get_osfhandle(end.descriptor), 0)[-2]

    def _is_readable(end: ReadEnd) -> bool:
        try:
            return _readable_bytes(end) > 0
        except OSError:
            return True

else:

    def _write_without_signal(descriptor: int, data: memoryview) -> int:
        """os.write where a child that is gone is an OSError and not the end of this process.

        Blender leaves SIGPIPE as the system has it, which is deadly; Python alone would ignore it. It is
        held back in this thread only, and taken away before anybody sees it.
        """
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGPIPE})
        try:
            return os.write(descriptor, data)
        except BrokenPipeError:
            if signal.SIGPIPE not in before and signal.SIGPIPE in signal.sigpending():
                signal.sigwait({signal.SIGPIPE})
            raise
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
