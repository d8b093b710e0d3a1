"""A machine on which there is nothing but Blender: folders of its own, all empty, and no network.

What runs in it sees neither the repository nor this machine's settings, and can be told apart from all other
processes by a mark in its environment, which its children inherit.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import uuid
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
INSIDE = Path(__file__).resolve().parent / "inside"
TRACES = ROOT / "tests" / "window" / "scenarios" / "traces.py"
MARK = "MANIENT_SEALED"
EMPTY = ("home", "profile", "cache", "config", "data", "state", "tmp", "work")
"""Folders that hold nothing in the beginning, and should hold nothing in the end"""


@cache
def without_network() -> tuple[str, ...]:
    """The command that runs another one without network; skips the test where none works."""
    for command in (("unshare", "--net"), ("unshare", "--map-root-user", "--net")):
        if shutil.which("unshare") and _works(*command, "true"):
            return command
    pytest.skip("the network cannot be cut off here: unshare --net needs root, or user namespaces")


def _works(*command: str) -> bool:
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


@dataclass(frozen=True)
class Finished:
    """What a process that ran in there left."""

    code: int
    facts: dict[str, Any]
    """What the script has written down, stage by stage"""
    said: str
    """Its stdout and stderr"""


class Sealed:
    """One such machine in the folder `base`."""

    def __init__(self, base: Path) -> None:
        self.base = base
        self._mark = uuid.uuid4().hex
        for name in (*EMPTY, "inside", "given", "made"):
            (base / name).mkdir(parents=True)
        for script in (*INSIDE.glob("*.py"), TRACES):
            shutil.copy(script, base / "inside")

    @property
    def made(self) -> Path:
        """Where scripts put what they are asked to make."""
        return self.base / "made"

    def give(self, file: Path) -> str:
        """Put a copy of a file in there; its path."""
        copy = self.base / "given" / file.name
        try:
            os.link(file, copy)  # a zip has 300 MB
        except OSError:
            shutil.copy(file, copy)
        return str(copy)

    @property
    def environment(self) -> dict[str, str]:
        """All environment variables that there are in there."""
        folders = {
            "HOME": "home",
            "BLENDER_USER_RESOURCES": "profile",
            **{f"XDG_{name.upper()}_HOME": name for name in ("cache", "config", "data", "state")},
            "TMPDIR": "tmp",
        }
        own = {name: str(self.base / folder) for name, folder in folders.items()}
        return {"PATH": "/usr/local/bin:/usr/bin:/bin", "LANG": "C.UTF-8", **own, MARK: self._mark}

    def run(self, script: str, **arguments: Any) -> Finished:
        """Run inside/SCRIPT.py with this environment's Python, isolated: `python -I`.

        The script gets a file with its `arguments` and one for its facts, after `--`.
        """
        asked, facts = (self.base / "given" / f"{what}.json" for what in ("asked", "facts"))
        asked.write_text(json.dumps({"made": str(self.made), **arguments}), encoding="utf-8")
        file = str(self.base / "inside" / f"{script}.py")
        settings = [f"{name}={value}" for name, value in self.environment.items()]
        command = ["env", "-i", *settings, sys.executable, "-I", file, "--", str(asked), str(facts)]
        done = subprocess.run(
            [*without_network(), *command],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            cwd=self.base / "work",
            timeout=600.0,
            check=False,
        )
        found = json.loads(facts.read_text(encoding="utf-8")) if facts.is_file() else {}
        return Finished(done.returncode, found, done.stdout)

    def left(self) -> list[str]:
        """Files, and folders without any, that are in the folders which were empty."""
        found = []
        for name in EMPTY:
            for folder, folders, files in os.walk(self.base / name):
                found += [str((Path(folder) / file).relative_to(self.base)) for file in files]
                if not folders and not files and Path(folder) != self.base / name:
                    found.append(str(Path(folder).relative_to(self.base)) + "/")
        return sorted(found)

    def processes(self) -> list[str]:
        """Command lines of processes that were started in there and still run."""
        return processes_with(f"{MARK}={self._mark}")


def processes_with(variable: str) -> list[str]:
    """Command lines of processes that have this NAME=VALUE in their environment."""
    found = []
    for folder in (f for f in Path("/proc").iterdir() if f.name.isdigit()):
        with suppress(OSError):  # it has ended meanwhile, or belongs to somebody else
            if variable.encode() in (folder / "environ").read_bytes().split(b"\0"):
                found.append((folder / "cmdline").read_bytes().replace(b"\0", b" ").decode().strip())
    return found
