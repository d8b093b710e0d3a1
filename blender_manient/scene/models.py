"""Hand models for rigs that are in the scene: read once, not for every step of a slider."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from handfit_core.hand_model import OPEN_HAND, HandModel, load_model
from handfit_core.skeleton import Side


def kept_model(model: str, side: Side) -> HandModel:
    """As `load_model`, but read again only where the file has changed. Raises HandModelError."""
    try:
        changed = 0 if model == OPEN_HAND else Path(model).stat().st_mtime_ns
    except (OSError, ValueError):
        changed = 0  # `load_model` says what is wrong, every time
    return _read(model, side, changed)


@lru_cache(maxsize=4)
def _read(model: str, side: Side, _changed: int) -> HandModel:
    return load_model(model, side)
