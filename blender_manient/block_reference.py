"""A data-block found again later: after a rename, an undo, or not at all where it was deleted."""

from __future__ import annotations

from dataclasses import dataclass

import bpy


@dataclass(frozen=True)
class BlockReference:
    """One data-block of this session. Holds no reference, which an undo would break."""

    collection: str
    """Its place in bpy.data: objects, scenes, ..."""
    uid: int
    name: str
    """As it was called then; for messages"""

    @classmethod
    def of(cls, collection: str, block: bpy.types.ID) -> BlockReference:
        """Remember a block of bpy.data.COLLECTION."""
        return cls(collection, block.session_uid, block.name)

    def find(self):
        """The block, whatever it is called now; None where it is gone."""
        blocks = getattr(bpy.data, self.collection)
        named = blocks.get(self.name)
        if named is not None and named.session_uid == self.uid:
            return named
        return next((block for block in blocks if block.session_uid == self.uid), None)
