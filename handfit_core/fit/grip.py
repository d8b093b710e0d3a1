"""A hand's grip: the prop where each hand holds it, and the points of the hand that may meet it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from handfit_core.common.batch import Batch
from handfit_core.common.skeleton import JOINTS_BY_FINGER, NUM_JOINTS, PARENTS
from handfit_core.fit.prop import PropSurface
from handfit_core.hand_model.chain import Posed, State
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.landmarks import bone_axes
from handfit_core.hand_model.surface import PALM, surface_of

_ALONG: Final = np.array([0.0, 0.35, 0.7, 1.0])
"""Where along a bone the centres of its four spheres lie, from 0 at its beginning to 1 at its end"""


@dataclass(frozen=True, eq=False)
class GripPoints:
    """S points of hands of one shape, which follow the joints as skin does (linear blend skinning)."""

    model: HandModel
    joints: np.ndarray
    """(16, 3) metres: the joints of the flat hand, model frame"""
    rest: np.ndarray
    """(S, 3) metres: the points of the flat hand, model frame"""
    weights: np.ndarray
    """(S, 16) skin weights, as in `HandModel`"""
    posedirs: np.ndarray
    """(S, 3, 135) metres: how the points move beyond skinning, as in `HandModel`"""
    flesh: np.ndarray
    """(S,) metres: the thickness of the flesh around the points"""

    @classmethod
    def spheres(cls, model: HandModel, betas: np.ndarray) -> GripPoints:
        """Return spheres along the bones of hands of shape `betas` (10,). A prop hardly ever reaches their
        centres, so that these tell from which side a finger came in."""
        flat = surface_of(model).of(betas[None], np.zeros((1, 45)))
        share = np.stack([1.0 - _ALONG, _ALONG])
        centres = (flat.ends[0].swapaxes(1, 2) @ share).swapaxes(1, 2).reshape(-1, 3)
        joints = np.append(JOINTS_BY_FINGER, np.zeros(len(flat.ends[0]) - PALM, dtype=int))
        weights = np.eye(NUM_JOINTS)[joints.repeat(len(_ALONG))]
        still = np.zeros((len(centres), *model.posedirs.shape[1:]))
        flesh = (flat.radii[0] @ share).reshape(-1)
        return cls(model, model.shaped(betas).joints, centres, weights, still, flesh)

    @classmethod
    def skin(cls, model: HandModel, betas: np.ndarray) -> GripPoints:
        """Return the V vertices of the skin of hands of shape `betas` (10,)."""
        shaped = model.shaped(betas)
        bare = np.zeros(len(shaped.vertices))
        return cls(model, shaped.joints, shaped.vertices, model.weights, model.posedirs, bare)

    def select(self, chosen: np.ndarray) -> GripPoints:
        """Return the points that `chosen` (S,) bool marks."""
        arrays = (self.rest, self.weights, self.posedirs, self.flesh)
        return GripPoints(self.model, self.joints, *(each[chosen] for each in arrays))

    @cached_property
    def palm(self) -> np.ndarray:
        """(S,) bool: true for points of the palm."""
        return self.weights.argmax(axis=1) == 0

    @cached_property
    def finger(self) -> np.ndarray:
        """(S,) the finger that each point belongs to, by its number in `skeleton.FINGERS`; points of the palm
        name the one that moves them most, if any does."""
        return self.weights[:, JOINTS_BY_FINGER].sum(axis=2).argmax(axis=1)

    @cached_property
    def follows(self) -> np.ndarray:
        """(S, 3) the share, 0..1, in which a point goes along with each of its finger's three joints."""
        own = np.take_along_axis(self.weights, JOINTS_BY_FINGER[self.finger], axis=1)
        return own[:, ::-1].cumsum(axis=1)[:, ::-1]

    @cached_property
    def pads(self) -> np.ndarray:
        """(10, S) bool: true for the points of each pad that may be drawn to a prop, the middle and the last
        one of each finger."""
        owner = self.weights.argmax(axis=1)
        to_back = ((self.rest - self.joints[owner]) * bone_axes(self.model)[owner, :, 1]).sum(axis=1)
        at = np.where((to_back < 0.0) | (self.flesh > 0.0), owner, 0)
        return at == JOINTS_BY_FINGER[:, 1:].reshape(-1, 1)

    def of_pads(self, gaps: np.ndarray) -> np.ndarray:
        """Return the points' gaps (B, S) as (B, 10, S), for each pad infinite where a point is not part of
        it."""
        return np.where(self.pads, gaps[:, None], np.inf)

    def places(self, posed: Posed) -> np.ndarray:
        """Return where the points of B posed hands are, (B, S, 3) metres in the camera frame."""
        batch, size = len(posed.state), len(self.rest)
        turns, joints = np.empty((batch, NUM_JOINTS, 3, 3)), np.empty((batch, NUM_JOINTS, 3))
        turns[:, 0], joints[:, 0] = posed.state.root, posed.state.wrist
        turns[:, JOINTS_BY_FINGER] = posed.frames.reshape(batch, 5, 3, 4, 3)[:, :, :, :3].swapaxes(2, 3)
        joints[:, JOINTS_BY_FINGER] = posed.origins[:, :, :3]
        turns = turns @ bone_axes(self.model).swapaxes(1, 2)
        bent = turns[:, PARENTS[1:]].swapaxes(2, 3) @ turns[:, 1:] - np.eye(3)
        dents = bent.reshape(batch, -1) @ self.posedirs.reshape(3 * size, -1).T
        rest = self.rest + dents.reshape(batch, size, 3)
        turn = (self.weights @ turns.reshape(batch, NUM_JOINTS, 9)).reshape(batch, size, 3, 3)
        place = self.weights @ (joints - (turns @ self.joints[..., None])[..., 0])
        return (turn @ rest[..., None])[..., 0] + place


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
        places = self.points.places(posed)
        seen_from = (places - self.place[:, None]) @ self.turn
        gaps, out = self.surface.gaps(seen_from.reshape(-1, 3), self.within)
        out = out.reshape(places.shape) @ self.turn.swapaxes(1, 2)
        return places, gaps.reshape(places.shape[:2]) - self.points.flesh, out
