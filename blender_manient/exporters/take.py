"""The take: the captured numbers, with the artist's changes."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO, cast

from .exporter import Exporter, HandObjects, Preset


class TakeExporter(Exporter):
    """What `retaken` makes of hands that keep their take."""

    name = "npz"
    label = "Hand Take"
    description = "The captured numbers, for other programs and later import"
    suffix = ".take.npz"
    writes = "captured"
    kept_endings = (".npz",)

    def write(self, path: Path, hands: Sequence[HandObjects], _preset: Preset, /) -> None:
        """Write the take that the hands make now."""
        from ..scene.retake import retaken
        from ..scene.store import CapturedHand

        path.write_bytes(retaken(cast("Sequence[CapturedHand]", hands)).to_bytes(compact=False))

    def is_whole(self, stream: BinaryIO, _size: int, /) -> bool:
        """Whether it has the table that ends every zip file."""
        return zipfile.is_zipfile(stream)
