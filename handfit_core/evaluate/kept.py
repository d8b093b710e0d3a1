"""Results that are kept between runs, in files named after everything that they depend on."""

from __future__ import annotations

import hashlib
import zipfile
from pathlib import Path
from types import ModuleType

import numpy as np

from handfit_core.files import written_whole


def code_digest(*packages: ModuleType | Path) -> str:
    """Fingerprint of the Python files of packages or modules, or of those that begin with a file, so that
    changed code makes results anew."""
    sha = hashlib.sha256()
    for package in packages:
        place = package if isinstance(package, Path) else package.__file__
        assert place is not None
        file = Path(place)
        for source in sorted(file.parent.rglob("*.py")) if file.name == "__init__.py" else [file]:
            sha.update(source.name.encode())
            sha.update(source.read_bytes())
    return sha.hexdigest()[:16]


def load_kept(path: Path) -> dict[str, np.ndarray] | None:
    """The arrays of a kept file; None where there is none, or only a damaged one."""
    try:
        with open(path, "rb") as stream, np.load(stream, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
        return None


def save_kept(path: Path, arrays: dict[str, np.ndarray]) -> None:
    """Write arrays, whole or not at all. Raises OutputError."""
    with written_whole(path) as beside, open(beside, "wb") as stream:
        np.savez(stream, **arrays)  # pyright: ignore[reportArgumentType]
