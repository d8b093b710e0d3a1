"""The zip, and machines on which there is nothing but Blender and that zip.

The tests themselves import neither bpy nor the add-on: all that is tested runs in processes of its own.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

if importlib.util.find_spec("bpy") is None:
    pytest.skip("needs one of the bpy wheels", allow_module_level=True)

if sys.platform != "linux":
    pytest.skip("what is left running is looked for in Linux's /proc", allow_module_level=True)


@pytest.fixture(scope="session")
def zipped() -> Path:
    """The zip that was built for this machine."""
    path = os.environ.get("HANDFIT_ZIP")
    if not path:
        pytest.skip("HANDFIT_ZIP does not name the built zip (nox -s build)")
    return Path(path).resolve()


@pytest.fixture(scope="session")
def without_network() -> tuple[str, ...]:
    """The command that runs another one without network."""
    for command in (("unshare", "--net"), ("unshare", "--map-root-user", "--net")):
        if shutil.which("unshare") and not subprocess.run([*command, "true"], check=False).returncode:
            return command
    pytest.skip("the network cannot be cut off here: unshare --net needs root, or user namespaces")


@pytest.fixture(scope="session")
def processes_with() -> Callable[[str], list[str]]:
    """processes_with(NAME=VALUE) -> command lines of processes that have this in their environment."""

    def processes(variable: str) -> list[str]:
        found = []
        for folder in (f for f in Path("/proc").iterdir() if f.name.isdigit()):
            with suppress(OSError):  # it has ended meanwhile, or belongs to somebody else
                if variable.encode() in (folder / "environ").read_bytes().split(b"\0"):
                    found.append((folder / "cmdline").read_bytes().replace(b"\0", b" ").decode().strip())
        return found

    return processes
