"""Scripts run as their users run them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CHROOT = os.environ.get("HANDFIT_BLENDER_CHROOT")
if CHROOT:
    CHROOT = str(Path(CHROOT).resolve())
TIMEOUT = 1200


@pytest.fixture(params=["wheel", "blender"])
def in_blender(request, tmp_path):
    """in_blender(script, *arguments) -> CompletedProcess: under the bpy wheel and in real Blender, in a
    folder of its own."""
    if request.param == "wheel":
        command = [sys.executable]
    elif CHROOT:
        wrapper = str(ROOT / "scripts" / "chroot_blender.sh")
        command = [wrapper, CHROOT, "blender", "-b", "-P"]
    else:
        pytest.skip("HANDFIT_BLENDER_CHROOT does not name a chroot with Blender in it")

    def run(script: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
        python = os.environ.get("HANDFIT_PYTHON", sys.executable)
        bind = ":".join(filter(None, [str(tmp_path), os.environ.get("CHROOT_BIND")]))
        after = [] if request.param == "wheel" else ["--"]
        return subprocess.run(
            [*command, str(script), *after, *map(str, arguments)],
            capture_output=True,
            text=True,
            cwd=tmp_path,
            env={**os.environ, "CHROOT_BIND": bind, "HANDFIT_PYTHON": python},
            timeout=TIMEOUT,
            check=False,
        )

    return run
