"""The bones of an armature at rest: their places, their axes, and how they hang on each other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True, eq=False)
class Bones:
    """The B bones of an armature at rest, in the armature's own space and units, parents before children."""

    names: tuple[str, ...]
    parents: np.ndarray
    """(B,) the index of each bone's parent; -1 for none"""
    heads: np.ndarray
    """(B, 3) where each bone begins"""
    tails: np.ndarray
    """(B, 3) where each bone ends; the tails of imported rigs may mean nothing"""
    frames: np.ndarray
    """(B, 3, 3) each bone's axes, with X, Y and Z in columns; Y is along the bone"""

    @cached_property
    def index(self) -> dict[str, int]:
        """The index of each bone by its name."""
        return {name: i for i, name in enumerate(self.names)}

    @cached_property
    def children(self) -> tuple[tuple[int, ...], ...]:
        """For each bone the indices of its children."""
        found: list[list[int]] = [[] for _ in self.names]
        for bone, parent in enumerate(self.parents.tolist()):
            if parent >= 0:
                found[parent].append(bone)
        return tuple(map(tuple, found))

    def ancestors(self, bone: int) -> Iterator[int]:
        """Yield the index of the bone's parent, then that of the parent's parent, and so on up to a bone
        without one."""
        while (bone := int(self.parents[bone])) >= 0:
            yield bone

    def holding(self, those: Sequence[int], wanted: int | None = None) -> int | None:
        """Find the bone that all the bones `those` hang from: `wanted` if they do, else their nearest common
        ancestor; None where they have none."""
        first, *others = ([*self.ancestors(bone)] for bone in those)
        shared = [bone for bone in first if all(bone in line for line in others)]
        return wanted if wanted in shared else shared[0] if shared else None
