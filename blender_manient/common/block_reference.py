"""References to data-blocks that survive a rename and an undo."""

from __future__ import annotations

from dataclasses import dataclass

import bpy


@dataclass(frozen=True)
class BlockReference:
    """Names one data-block of this session by its session_uid: an undo breaks Python's own references."""

    collection: str
    """The name of the collection of bpy.data that the block is in: objects, scenes, ..."""
    uid: int
    name: str
    """The block's name when the reference was made, for messages"""

    @classmethod
    def of(cls, collection: str, block: bpy.types.ID) -> BlockReference:
        """Make a reference to a block of bpy.data.COLLECTION."""
        return cls(collection, block.session_uid, block.name)

    def find(self):
        """Return the block, whatever its name is now; None where it was deleted."""
        blocks = getattr(bpy.data, self.collection)
        named = blocks.get(self.name)
        if named is not None and named.session_uid == self.uid:
            return named
        return next((block for block in blocks if block.session_uid == self.uid), None)
