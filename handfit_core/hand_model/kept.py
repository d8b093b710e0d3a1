"""Cache of hand models: a slider's step or an edit while the artist drags must not read a file."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from handfit_core.errors import HandModelError
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.files import OPEN_HAND, file_of_side, load_model
from handfit_core.skeleton import Side


def kept_model(model: str, side: Side) -> HandModel:
    """`load_model`, cached: the same object every time, until its file or the folder around it changes.

    Raises HandModelError.
    """
    if model == OPEN_HAND:
        return load_model(model, side)
    try:
        path = Path(model).expanduser()
        folder = path if path.is_dir() else path.parent
        file = _found(path, side, folder.stat().st_mtime_ns)
        found = file.stat()
    except (OSError, ValueError, RuntimeError, HandModelError):
        return load_model(model, side)  # which says what is wrong
    return _read(file, side, (found.st_mtime_ns, found.st_size, found.st_ino))


@lru_cache(maxsize=4)
def _found(path: Path, side: Side, _changed: int) -> Path:
    return file_of_side(path, side)


@lru_cache(maxsize=4)
def _read(file: Path, side: Side, _stamp: tuple[int, int, int]) -> HandModel:
    return load_model(file, side)
