"""Results that are kept between runs, under a key of everything that they depend on."""

from __future__ import annotations

import hashlib
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import ModuleType

from joblib import Memory


def code_digest(*sources: ModuleType | Path) -> str:
    """Fingerprint of packages, modules and files, so that changed code makes results anew."""
    sha = hashlib.sha256()
    for source in sources:
        file = Path(source if isinstance(source, Path) else source.__file__ or "")
        for each in sorted(file.parent.rglob("*.py")) if file.name == "__init__.py" else [file]:
            sha.update(each.name.encode())
            sha.update(each.read_bytes())
    return sha.hexdigest()[:16]


def versions(*packages: str) -> dict[str, str]:
    """The versions of those packages that are installed."""
    found = {}
    for package in packages:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def memory_at(folder: Path) -> Memory:
    """Keeps results of functions in a folder."""
    return Memory(folder, verbose=0)
