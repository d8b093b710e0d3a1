"""The zip in a fixed form: Blender's tool writes the files as the file system orders them, with their times.

(Its manifest can list the files, but with such a list it puts each wheel into the zip twice.) Nothing is
compressed: other builds of zlib compress to other bytes, and the wheels of others, nearly all of the zip, are
compressed already.
"""

from __future__ import annotations

import shutil
import zipfile
from pathlib import Path

SAME_TIME = (2020, 1, 1, 0, 0, 0)


def fix(path: Path) -> None:
    """Rewrite the zip: entries sorted by name, of one time and mode, not compressed."""
    beside = path.with_name(f".{path.name}")
    with zipfile.ZipFile(path) as source, zipfile.ZipFile(beside, "w") as target:
        for entry in sorted(source.infolist(), key=lambda entry: entry.filename):
            info = zipfile.ZipInfo(entry.filename, SAME_TIME)
            info.compress_type = zipfile.ZIP_STORED
            info.file_size = entry.file_size
            info.create_system = 3  # Unix, whose modes these are, on whatever system this runs
            info.external_attr = 0o644 << 16
            with source.open(entry) as content, target.open(info, "w") as copy:
                shutil.copyfileobj(content, copy, 1 << 20)
    beside.replace(path)
