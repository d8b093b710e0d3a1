"""A hand's grip: the prop where each hand holds it, and the points of the hand that may meet it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from handfit_core.common.batch import Batch
from handfit_core.common.skeleton import JOINTS_BY_FINGER
from handfit_core.fit.prop import PropSurface
from handfit_core.hand_model.chain import Chain, Posed, State
from handfit_core.hand_model.landmarks import bone_axes
from handfit_core.hand_model.surface import FINGER_OF_BONE, LEVEL_OF_BONE, NUM_BONES, Surface

LEVELS: Final = 2
"""Number of a finger's pads that are drawn to a prop: finger f has number 2 f, of its middle bone, and 2 f +
1, of its last"""
_ALONG: Final = np.array([0.0, 0.35, 0.7, 1.0])
"""Where along a bone the centres of its four spheres lie, from 0 at its beginning to 1 at its end"""


class GripPoints:
    """S points of a hand, each of which belongs to the finger that `finger` (S,) says.

    `follows`: (S, 3) the share, 0..1, in which a point goes along with each of its finger's three joints.
    `pad`: (S,) the number of the pad that a point is part of; -1: none. `palm`: (S,) bool, true for points of
    the palm.
    """

    def __init__(
        self, finger: np.ndarray, follows: np.ndarray, level: np.ndarray, on_pad: np.ndarray
    ) -> None:
        self.finger, self.follows, self.palm = finger, follows, level == 3
        self.pad = np.where(on_pad & np.isin(level, (1, 2)), LEVELS * finger + level - 1, -1)

    def places(self, posed: Posed) -> tuple[np.ndarray, np.ndarray]:
        """Return where the points of B posed hands are, (B, S, 3) metres in the camera frame, and the
        thickness (B, S) in metres of the flesh around them."""
        raise NotImplementedError


class Spheres(GripPoints):
    """Spheres along the bones, whose middles a prop hardly ever reaches: they tell where a finger came in."""

    def __init__(self, surface: Surface) -> None:
        level = LEVEL_OF_BONE.repeat(len(_ALONG))
        follows = (np.arange(3) <= level[:, None]) & (level[:, None] < 3)
        super().__init__(
            FINGER_OF_BONE.repeat(len(_ALONG)), follows * 1.0, level, np.ones(len(level), dtype=bool)
        )
        self._surface, self._share = surface, np.stack([1.0 - _ALONG, _ALONG])

    def places(self, posed: Posed) -> tuple[np.ndarray, np.ndarray]:
        """Return the spheres' centres (B, S, 3) and their radii (B, S), in metres, camera frame."""
        capsules, size = self._surface.capsules(posed), NUM_BONES * len(_ALONG)
        centres = (capsules.ends.swapaxes(2, 3) @ self._share).swapaxes(2, 3).reshape(-1, size, 3)
        return centres, (capsules.radii @ self._share).reshape(-1, size)


class SkinVertices(GripPoints):
    """S vertices of the skin itself, moved by linear blend skinning. All hands of a batch must be of one
    shape."""

    def __init__(self, chain: Chain, vertices: np.ndarray) -> None:
        model, axes = chain.model, bone_axes(chain.model)
        weights = model.weights[vertices]
        owner = weights.argmax(axis=1)
        by_finger = weights[:, JOINTS_BY_FINGER]  # (S, 5, 3)
        finger = by_finger.sum(axis=2).argmax(axis=1)
        own = by_finger[np.arange(len(vertices)), finger]
        flat = model.shaped()
        to_back = ((flat.vertices[vertices] - flat.joints[owner]) * axes[owner, :, 1]).sum(axis=1)
        level = np.where(owner == 0, 3, (owner - 1) % 3)
        super().__init__(finger, own[:, ::-1].cumsum(axis=1)[:, ::-1], level, to_back < 0.0)
        self._chain, self._vertices = chain, vertices

    def places(self, posed: Posed) -> tuple[np.ndarray, np.ndarray]:
        """Return the vertices (B, S, 3) in metres, camera frame, and zeros, as no flesh is around them."""
        betas, *pose = self._chain.parameters(posed.state)
        places = self._chain.model.skinned(self._vertices, betas[0], *pose)[0]
        return places, np.zeros(places.shape[:2])


@dataclass(frozen=True, eq=False)
class Grip(Batch):
    """The prop that B hands hold, where it is, and what is drawn to it."""

    surface: PropSurface
    points: GripPoints
    turn: np.ndarray
    """(B, 3, 3) rotations that turn the prop into the camera frame: x = turn p + place"""
    place: np.ndarray
    """(B, 3) metres: where the prop's origin lies in the camera frame, as in x = turn p + place"""
    drawn: np.ndarray
    """(B, 10) how firmly each of the ten pads is drawn to the prop, 0..1"""
    captured: State
    """The B hands as they were before they grip"""
    within: float
    """metres from the prop beyond which points of the hand do not count"""

    def gaps(self, posed: Posed) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the points of B posed hands (B, S, 3) in metres, the distances (B, S) of their skins from
        the prop, negative inside it, and unit vectors (B, S, 3) that lead out of it."""
        places, thickness = self.points.places(posed)
        seen_from = (places - self.place[:, None]) @ self.turn
        gaps, out = self.surface.gaps(seen_from.reshape(-1, 3), self.within)
        out = out.reshape(places.shape) @ self.turn.swapaxes(1, 2)
        return places, gaps.reshape(places.shape[:2]) - thickness, out
