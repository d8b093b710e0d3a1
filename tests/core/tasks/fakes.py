"""The command `batch` with captures that take no time, or die, or hang, as the input's name says.

`python -m tests.core.tasks.fakes ARGUMENT...` is `python -m handfit_core batch ARGUMENT...` with them.
"""

from __future__ import annotations

import errno
import os
import signal
import sys
import time
from pathlib import Path

import numpy as np

from handfit_core.__main__ import main
from handfit_core.capturing.options import CaptureOptions
from handfit_core.common.errors import NoHandFoundError
from handfit_core.geometry.camera import Intrinsics
from handfit_core.media.source import Source
from handfit_core.take import Take
from handfit_core.tasks import capture, workers
from handfit_core.tasks.record import Result
from handfit_core.tasks.task import Task
from tests.takes import take_of, track_of

CAMERA = Intrinsics(600.0, 600.0, 320.0, 240.0)
CALLS = "calls.txt"
"""Beside the inputs: a line for each capture that was begun"""


def fake_task(task: Task, output: Path, settings: capture.Settings) -> Result:
    """`run_task` with such captures."""
    capture.capture = fake_capture
    return capture.run_task(task, output, settings)


def fake_capture(source: str, _options: CaptureOptions) -> Take:
    """A take of one hand, which depends on the name alone."""
    path = Path(source)
    again = (path.parent / CALLS).exists()
    with (path.parent / CALLS).open("a") as stream:
        stream.write(f"{path.stem}\n")
    kind = path.stem.rstrip("0123456789")
    if kind == "dies":
        os.kill(os.getpid(), signal.SIGKILL)
    elif kind == "hangs" or (kind == "tires" and again):
        time.sleep(600)
    elif kind == "waits":
        while not (path.parent / "go").exists():
            time.sleep(0.1)
    elif kind == "slow":
        time.sleep(0.5)
    elif kind == "hungry":
        raise MemoryError
    elif kind == "broken":
        raise ZeroDivisionError("division by zero")
    elif kind == "empty":
        raise NoHandFoundError(f"{path.name}: no hand was found")
    elif kind == "full":
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    depth = np.array([[0.0, 0.0, 0.4 + 0.001 * len(path.stem)]])
    hand = track_of("right", np.zeros((1, 3)), np.zeros((1, 45)), depth, CAMERA)
    return take_of([hand], CAMERA, 640, 480, source=Source("photo", (source,)))


if __name__ == "__main__":
    from tests.core.tasks import fakes

    workers.Workers.run = staticmethod(fakes.fake_task)
    sys.exit(main(["batch", *sys.argv[1:]]))
