"""How the bones of an armature lie at rest."""

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
    """(B, 3) where each bone ends; imported rigs have tails that mean nothing"""
    frames: np.ndarray
    """(B, 3, 3) each bone's axes, X, Y and Z in columns; Y is along the bone"""
    inherits: np.ndarray
    """(B,) bool: true if the bone turns with its parent"""

    @cached_property
    def index(self) -> dict[str, int]:
        """The index of each bone by its name."""
        return {name: i for i, name in enumerate(self.names)}

    @cached_property
    def children(self) -> tuple[tuple[int, ...], ...]:
        """The indices of each bone's children."""
        found: list[list[int]] = [[] for _ in self.names]
        for bone, parent in enumerate(self.parents.tolist()):
            if parent >= 0:
                found[parent].append(bone)
        return tuple(map(tuple, found))

    def ancestors(self, bone: int) -> Iterator[int]:
        """The bone's parent, that one's parent, and so on."""
        while (bone := int(self.parents[bone])) >= 0:
            yield bone

    def holding(self, those: Sequence[int], wanted: int | None = None) -> int | None:
        """The bone that all those hang from: `wanted` if they do, else their nearest common ancestor; None
        where they have none."""
        first, *others = ([*self.ancestors(bone)] for bone in those)
        shared = [bone for bone in first if all(bone in line for line in others)]
        return wanted if wanted in shared else shared[0] if shared else None
