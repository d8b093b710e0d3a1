"""The cameras that the system lists; nothing is opened, and nothing heavy is loaded."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Final

SYSTEM_CAMERAS: Final = Path("/sys/class/video4linux")
"""The folder in which Linux lists its cameras"""


def cameras(names: Path = SYSTEM_CAMERAS) -> list[tuple[int, str]]:
    """Return the numbers and names of the cameras that the system lists without opening one, which Linux
    alone does; elsewhere the list is empty."""
    found = []
    for folder in names.glob("video*"):
        number = folder.name.removeprefix("video")
        with contextlib.suppress(OSError, ValueError):
            if int((folder / "index").read_text("ascii")) == 0:  # others have no pictures
                found.append((int(number), (folder / "name").read_text("utf-8", "replace").strip()))
    return sorted(found)
