"""This project's own takes, as `convert` writes them."""

from __future__ import annotations

from pathlib import Path

from handfit_core.interchange.writers import Writer
from handfit_core.take import Take


def _write(take: Take, path: Path) -> None:
    take.save(path)


WRITER = Writer("Take", (".take.npz", ".npz"), _write)
