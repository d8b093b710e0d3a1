"""Hand models, read once: an edit that is answered while the artist drags must not read a file."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from handfit_core.errors import HandModelError
from handfit_core.hand_model import OPEN_HAND, HandModel, load_model
from handfit_core.skeleton import Side


def hand_model(model: str, side: Side) -> HandModel:
    """The same object every time, until its file changes. Raises HandModelError."""
    return _read(model, side, () if model == OPEN_HAND else _stamps(Path(model).expanduser()))


@lru_cache(maxsize=4)
def _read(model: str, side: Side, stamps: tuple[tuple[str, int, int], ...]) -> HandModel:  # noqa: ARG001
    return load_model(model, side)


def _stamps(path: Path) -> tuple[tuple[str, int, int], ...]:
    """Name, modification time and size of all files that `load_model` may take for this path: itself, and
    MANO's beside it or in it."""
    try:
        folder = path if path.is_dir() else path.parent
        files = [p for p in folder.iterdir() if p == path or p.stem.lower().startswith("mano_")]
        stats = [(p.name, p.stat()) for p in sorted(files)]
    except OSError as error:
        raise HandModelError(
            f"{path}: the hand model cannot be read ({error.strerror}); pick it again"
        ) from error
    return tuple((name, stat.st_mtime_ns, stat.st_size) for name, stat in stats)
