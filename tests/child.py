"""Running something in a process of its own whose memory is limited and measured."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

_BEFORE = """
import resource
resource.setrlimit(resource.RLIMIT_AS, ({limit}, {limit}))
"""
# Not getrusage: what a process had in memory before it became this one counts there. Without the pages of
# libraries, which differ by a hundred MB with how the system happens to map them, and which it can drop.
_AFTER = """
with open("/proc/self/status") as stream:
    status = dict(line.split(":") for line in stream)
print((int(status["VmHWM"].split()[0]) - int(status["RssFile"].split()[0])) / 1e3, flush=True)
"""


def peak_megabytes(code: str, *args: str | os.PathLike[str], limit: int = 4 << 30, cwd: Path = ROOT) -> float:
    """Run Python code, with `args` in sys.argv, and return the most memory of its own that it took, in MB.

    Address space beyond `limit` bytes raises MemoryError in it. The code fails the test by failing. Where the
    system is not Linux, the test that asks is skipped.
    """
    if sys.platform != "linux":
        pytest.skip("memory is limited and measured through Linux's /proc")
    whole = _BEFORE.format(limit=limit) + textwrap.dedent(code) + _AFTER
    child = subprocess.run(
        [sys.executable, "-c", whole, *(os.fspath(arg) for arg in args)],
        env=os.environ | {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"},
        cwd=cwd,
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert child.returncode == 0, child.stderr[-3000:]
    return float(child.stdout.split()[-1])
