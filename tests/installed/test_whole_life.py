"""From installing the zip to uninstalling it, in one Blender: with nothing else at hand, and no network."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = Path(__file__).resolve().parent / "inside" / "whole_life.py"
SHARED = ROOT / "tests" / "window" / "scenarios" / "traces.py", ROOT / "tests" / "drawn.py"
"""What the script imports"""
EMPTY = ("home", "profile", "cache", "config", "data", "state", "tmp", "work")
"""Folders that hold nothing in the beginning, and should hold nothing in the end"""
BLENDERS_OWN = """
cache/thumbnails/fail/blender/
cache/thumbnails/large/
profile/extensions/.cache/compat.dat
profile/extensions/.local/lib/python3.*/site-packages/
profile/extensions/.user/user_default/
profile/extensions/user_default/.blender_ext/cache/
""".split()
"""What stays of any extension that was installed: Blender's list of extensions that fit, and empty folders"""
BPY_VARIABLES = ("MATERIALX_SEARCH_PATH", "PXR_MTLX_STDLIB_SEARCH_PATHS", "OCIO")
"""What importing bpy sets by itself"""


def test_from_installing_to_uninstalling(zipped, samples, without_network, processes_with, tmp_path):
    for name in (*EMPTY, "inside", "given"):
        (tmp_path / name).mkdir()
    for script in (SCRIPT, *SHARED):
        shutil.copy(script, tmp_path / "inside")
    photo, video = samples / "photos" / "thumb_up.jpg", samples / "videos" / "asl_hand.mp4"
    given = {
        kind: shutil.copy(file, tmp_path / "given")
        for kind, file in {"zip": zipped, "photo": photo, "video": video}.items()
    }
    mark = f"MANIENT_SEALED={tmp_path}"
    folders = {"HOME": "home", "BLENDER_USER_RESOURCES": "profile", "TMPDIR": "tmp"}
    folders |= {f"XDG_{name.upper()}_HOME": name for name in ("cache", "config", "data", "state")}
    variables = [f"{name}={tmp_path / folder}" for name, folder in folders.items()]
    variables += ["PATH=/usr/local/bin:/usr/bin:/bin", "LANG=C.UTF-8", mark]
    names = [*(variable.partition("=")[0] for variable in variables), *BPY_VARIABLES]
    asked = tmp_path / "given" / "asked.json"
    asked.write_text(json.dumps({**given, "root": str(ROOT), "variables": names}), "utf-8")
    script = [sys.executable, "-I", str(tmp_path / "inside" / SCRIPT.name), "--", str(asked)]
    done = subprocess.run(
        [*without_network, "env", "-i", *variables, *script],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        cwd=tmp_path / "work",
        timeout=600.0,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-4000:]
    assert "Traceback" not in done.stdout
    assert processes_with(mark) == []
    left = {re.sub(r"python3\.\d+", "python3.*", name) for name in _left(tmp_path)}
    assert left <= set(BLENDERS_OWN)
    shutil.rmtree(tmp_path)  # some GB of disk


def _left(base: Path) -> list[str]:
    """Files, and folders without any, that are in the folders which were empty."""
    found = []
    for name in EMPTY:
        for folder, folders, files in os.walk(base / name):
            found += [str((Path(folder) / file).relative_to(base)) for file in files]
            if not folders and not files and Path(folder) != base / name:
                found.append(str(Path(folder).relative_to(base)) + "/")
    return found
