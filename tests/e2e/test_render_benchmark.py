"""scripts/render_benchmark.py in a real Blender, as docs/evaluation.md calls it."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CHROOT = os.environ.get("HANDFIT_BLENDER_CHROOT")


@pytest.mark.skipif(not CHROOT, reason="HANDFIT_BLENDER_CHROOT does not name a chroot with Blender in it")
def test_in_blender(tmp_path: Path) -> None:
    output = tmp_path / "pictures"
    command = [
        *(str(ROOT / "scripts" / "chroot_blender.sh"), str(Path(CHROOT or "").resolve()), "blender", "-b"),
        *("-P", str(ROOT / "scripts" / "render_benchmark.py"), "--", str(output)),
        *("--stills", "1", "--clips", "0", "--size", "64"),
    ]
    environment = {**os.environ, "CHROOT_BIND": str(tmp_path)}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=600, check=False)
    assert "Traceback" not in done.stderr + done.stdout
    if "built without OpenImageDenoise" in done.stderr:  # as Debian's is
        assert done.returncode == 2
        return
    assert done.returncode == 0, done.stderr
    (picture,) = json.loads((output / "index.json").read_text(encoding="utf-8"))["pictures"]
    assert (output / picture["file"]).is_file()
