"""Scripts run as their users run them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from handfit_core.geometry.camera import Intrinsics
from handfit_core.media.source import Source
from tests.takes import take_of, track_of

ROOT = Path(__file__).resolve().parents[2]
CHROOT = os.environ.get("HANDFIT_BLENDER_CHROOT")
if CHROOT:
    CHROOT = str(Path(CHROOT).resolve())
TIMEOUT = 1200


@pytest.fixture(params=["wheel", pytest.param("blender", marks=pytest.mark.slow)])
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


@pytest.fixture
def take_file(tmp_path):
    """take_file(name, frames) -> path of a saved take of a right hand."""

    def make(name: str = "wave", frames: int = 5) -> Path:
        t = np.linspace(0, 1, frames)
        orient = np.stack([0.3 + t, t * 0, t], -1)
        pose = np.tile(np.tile([0.0, 0.0, 0.4], 15), (frames, 1)) * t[:, None]
        camera = Intrinsics.assumed(320, 240)
        hand = track_of("right", orient, pose, np.tile([0.0, 0.0, 0.6], (frames, 1)), camera)
        take = take_of([hand], camera, 320, 240, source=Source("photo", (str(tmp_path / "gone.png"),)))
        return take.save(tmp_path / f"{name}.take.npz")

    return make
