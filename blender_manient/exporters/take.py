"""The take: the captured numbers, with the artist's changes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import cast

from ..scene.retake import retaken
from ..scene.store import CapturedHand
from .exporter import Exporter, HandObjects, Preset


class TakeExporter(Exporter):
    """What `retaken` makes of hands that keep their take."""

    name = "npz"
    label = "Hand Take"
    description = "The captured numbers, for other programs and later import"
    suffix = ".take.npz"
    writes = "captured"
    kept_endings = (".npz",)

    def write(self, path: Path, hands: Sequence[HandObjects], _preset: Preset, _final: Path, /) -> None:
        """Write the take that the hands make now."""
        path.write_bytes(retaken(cast("Sequence[CapturedHand]", hands)).to_bytes(compact=False))
