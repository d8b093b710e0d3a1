"""A socket that listens on this machine, and tells whether anybody connected."""

from __future__ import annotations

import contextlib
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

# A process of its own: while a native library of the test's own process waits for an answer, no thread of it
# runs.
_ACCEPT = """
import socket, sys
server = socket.socket(fileno=int(sys.argv[1]))
while True:
    connection = server.accept()[0]
    with open(sys.argv[2], "a") as log:
        log.write("x")
    connection.close()
"""


@contextlib.contextmanager
def listening(folder: Path) -> Iterator[tuple[int, Callable[[], int]]]:
    """The port on 127.0.0.1, and how many connections were made so far."""
    log = folder / "connections"
    log.touch()
    with socket.create_server(("127.0.0.1", 0)) as server:
        number = str(server.fileno())
        child = subprocess.Popen(
            [sys.executable, "-c", _ACCEPT, number, str(log)], pass_fds=[server.fileno()]
        )
        port = server.getsockname()[1]

        def count() -> int:
            # Connections are taken in order: once this one is, so are all that came before.
            with socket.create_connection(("127.0.0.1", port)) as own:
                while own.recv(1):
                    pass
            nonlocal ours
            ours += 1
            return log.stat().st_size - ours

        ours = 0
        try:
            yield port, count
        finally:
            child.kill()
            child.wait()
