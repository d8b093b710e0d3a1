"""Results in the user's cache, under a key of everything that they depend on."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import ModuleType
from typing import Any

from joblib import Memory

from handfit_core.common.files import cache_dir


def cached(function: Callable[..., Any], folder: str, ignore: Sequence[str]) -> Any:
    """Return the function with its results cached in that folder, by all arguments that are not ignored."""
    return Memory(cache_dir() / folder, verbose=0).cache(function, ignore=list(ignore))


def code_digest(*sources: ModuleType | Path) -> str:
    """Return a fingerprint of packages, modules and files, by which changed code invalidates cached
    results."""
    sha = hashlib.sha256()
    for source in sources:
        file = Path(source if isinstance(source, Path) else source.__file__ or "")
        for each in sorted(file.parent.rglob("*.py")) if file.name == "__init__.py" else [file]:
            sha.update(each.name.encode())
            sha.update(each.read_bytes())
    return sha.hexdigest()[:16]


def versions(*packages: str) -> dict[str, str]:
    """Return the installed versions of those packages, by name."""
    found = {}
    for package in packages:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found
