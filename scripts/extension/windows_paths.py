"""Whether Windows' limit on the length of paths is met where Blender unpacks the wheels."""

from __future__ import annotations

from collections.abc import Sequence

from scripts.extension.wheel_file import WheelFile

LIMIT = 260
"""Characters of a path with its closing null, unless long paths are switched on in Windows"""
LONGEST_USER = 20
"""Characters that Windows allows in a user's name"""


def folder(user: str) -> str:
    """Where Blender unpacks wheels for a user of this name."""
    return (
        f"C:\\Users\\{user}\\AppData\\Roaming\\Blender Foundation\\Blender\\4.2\\extensions\\.local\\lib\\"
        "python3.11\\site-packages\\"
    )


def longest_path(wheels: Sequence[WheelFile], user: str = "u" * LONGEST_USER) -> tuple[int, WheelFile, str]:
    """The longest path that unpacking makes: characters with the closing null, the wheel, the file in it."""
    wheel, member = max(((w, m) for w in wheels for m in w.members), key=lambda found: len(found[1]))
    return len(folder(user)) + len(member) + 1, wheel, member


def warning(wheels: Sequence[WheelFile]) -> str:
    """A sentence where the longest path is too long for some user, else an empty text."""
    length, wheel, member = longest_path(wheels)
    if length <= LIMIT:
        return ""
    shortest = length - LONGEST_USER + 1
    whom = "every user" if shortest > LIMIT else "users with long names"
    return (
        f"warning: {wheel.path.name}: unpacked, {member} has a path of up to {length} characters, Windows "
        f"allows {LIMIT}; for {whom} Blender cannot unpack this wheel unless long paths are switched on, or "
        "Blender's files lie in a folder with a short name (BLENDER_USER_RESOURCES)"
    )
