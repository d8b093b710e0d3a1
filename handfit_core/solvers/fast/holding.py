"""Joints that stay as they are while the rest of a hand is fitted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from handfit_core.skeleton import FINGER_JOINTS, FINGERS
from handfit_core.solvers.fast.blocks import Blocks
from handfit_core.solvers.fast.chain import Index, State

_JOINTS = np.array([FINGER_JOINTS[f] for f in FINGERS])
"""(5, 3) MANO's joints, finger by finger"""


@dataclass(frozen=True, eq=False)
class Held:
    """Which joints of B hands are held, and at what."""

    joints: np.ndarray
    """(B, 16) bool in MANO's order; 0 is the wrist: its rotation and its place"""
    state: State
    """B hands; only the held joints of it count"""

    def select(self, index: Index) -> Held:
        """The hands of that index."""
        return Held(self.joints[index], self.state.select(index))

    def variables(self) -> np.ndarray:
        """(B, 51) bool: root (3), joints finger by finger (45), place (3), as `smooth` orders them."""
        wrist = self.joints[:, :1].repeat(3, axis=1)
        fingers = self.joints[:, _JOINTS.reshape(-1)].repeat(3, axis=1)
        return np.concatenate([wrist, fingers, wrist], axis=1)

    def of(self, blocks: Blocks) -> Blocks:
        """The same problems without the held variables."""
        wrist, fingers = self._masks
        of_hand = np.zeros(blocks.hand_gradient.shape, dtype=bool)
        of_hand[:, :6] = wrist
        return blocks.holding(of_hand, fingers)

    @cached_property
    def _masks(self) -> tuple[np.ndarray, np.ndarray]:
        """(B, 1) and (B, 5, 9) bool."""
        held = self.variables()
        return held[:, :1], held[:, 3:48].reshape(-1, 5, 9)

    def put(self, state: State) -> State:
        """B hands with the held joints where they are held."""
        wrist, fingers = self.joints[:, :1], self.joints[:, _JOINTS, None, None]
        return replace(
            state,
            root=np.where(wrist[..., None], self.state.root, state.root),
            local=np.where(fingers, self.state.local, state.local),
            wrist=np.where(wrist, self.state.wrist, state.wrist),
        )
