"""What a rig is to everything else: an armature's bones as a hand of MANO's 16 joints."""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import bpy
import numpy as np

from handfit_core.common.errors import HandfitError, HandModelError, OptionError
from handfit_core.common.skeleton import Side
from handfit_core.hand_model import ShapedHand
from handfit_core.hand_model.axes import RestPose

from ..common.plugins import failure_sentence
from ..common.wording import capitalised


def bone_path(name: str) -> str:
    """Return the data path of a pose bone, as curves and drivers have it, whatever its name holds."""
    return f'pose.bones["{bpy.utils.escape_identifier(name)}"]'


class PosedBones(ABC):
    """Some bones of an armature that have, or get, keys."""

    def __init__(self, armature: bpy.types.Object) -> None:
        self.armature = armature

    @property
    @abstractmethod
    def bones(self) -> list[str]:
        """Return the bones' names. The first one's location may have keys too."""

    @property
    def lacking(self) -> str | None:
        """Return a sentence for a tooltip about which bone is missing; None where all are there."""
        there = self.armature.data.bones
        try:
            missing = next((name for name in self.bones if name not in there), None)
        except HandModelError as error:
            return capitalised(str(error))
        if missing is None:
            return None
        return f"The hand lacks the bone {missing}: give its bones their names back"

    def check(self) -> None:
        """Raise HandModelError where a bone is missing."""
        why = self.lacking
        if why is not None:
            raise HandModelError(f"{self.armature.name!r}: {why[:1].lower()}{why[1:]}")

    def allow(self, quats: np.ndarray) -> None:  # noqa: B027
        """Let the rig's limits, where it has any, through to poses (N, B, 4) that the bones get; NaN for
        bones that do not."""


class Rig(PosedBones):
    """One hand on one armature. Nothing outside of this folder knows a bone's name, axes or order.

    Poses of bones are quaternions (N, 16, 4) as (w, x, y, z), each relative to its bone's rest, and the wrist
    bone's locations (N, 3) in metres along its own axes; both in MANO's joint order.
    """

    def __init_subclass__(cls) -> None:
        """Have what goes wrong in a plug-in become a sentence for whoever asks it for bones and poses."""
        for name in {"bones", "rest", "to_bones", "from_bones", "follow"} & vars(cls).keys():
            own: Any = vars(cls)[name]
            getter = getattr(own, "fget", None)
            setattr(cls, name, property(_guarded(getter)) if getter is not None else _guarded(own))

    def __init__(self, armature: bpy.types.Object, side: Side) -> None:
        super().__init__(armature)
        self.side: Side = side

    @classmethod
    @abstractmethod
    def recognises(cls, armature: bpy.types.Object, side: Side) -> float:
        """Return how sure it is that the armature has a hand of this kind and side, 0 (it has none) to 1."""

    @property
    @abstractmethod
    def bones(self) -> list[str]:
        """Return the names of the 16 bones, the wrist's first."""

    @property
    def rest(self) -> RestPose:
        """Return how the bones lie at rest, as Blender has them now."""
        bones = [self.armature.data.bones[name] for name in self.bones]
        frames = np.array([bone.matrix_local.to_3x3() for bone in bones], dtype=np.float64)
        noted = getattr(self.armature, "manient", None)  # not there where the add-on is not registered
        origin = np.zeros(3) if noted is None else np.array(noted.origin, dtype=np.float64)
        return RestPose(self.side, frames, np.array(bones[0].head_local, dtype=np.float64), origin)

    def to_bones(
        self, shaped: ShapedHand, global_orient: np.ndarray, hand_pose: np.ndarray, transl: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return a take's poses as the bones have them: `RestPose.to_bones`."""
        return self.rest.to_bones(shaped, global_orient, hand_pose, transl)

    def from_bones(
        self, shaped: ShapedHand, quats: np.ndarray, locations: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the inverse of `to_bones`: global_orient (N, 3) and hand_pose (N, 45), axis-angle in
        radians, and transl (N, 3) in metres."""
        return self.rest.from_bones(shaped, quats, locations)

    def follow(self, shaped: ShapedHand) -> None:  # noqa: ARG002
        """Move the rest bones to where a hand of this shape has them. Raises OptionError for rigs that keep
        their own proportions."""
        raise OptionError(
            f"{self.armature.name!r} keeps its own proportions: its shape cannot be changed here"
        )

    @property
    def controls(self) -> dict[str, str]:
        """Return the bones to animate the hand with on top of its keys, by what they control; empty for
        none."""
        return {}

    def add_controls(self, model: str) -> None:  # noqa: ARG002
        """Give the hand controls; `model` is its hand model's name. Raises OptionError for rigs that have
        none of ours."""
        raise OptionError(f"{self.armature.name!r} has bones of its own: animate it with these")

    def remove_controls(self) -> None:
        """Take the hand's controls away again."""

    def add_arm(self, lengths: np.ndarray) -> None:  # noqa: ARG002
        """Give the hand an arm; lengths (2,) in metres, of upper arm and forearm. Raises OptionError for rigs
        that get none of ours."""
        raise OptionError(f"{self.armature.name!r} has bones of its own, and gets no arm")


def _guarded(method: Callable[..., Any]) -> Callable[..., Any]:
    """Return a method of a kind of rig so that its own errors are raised as HandModelErrors that name the
    kind."""

    @functools.wraps(method)
    def guarded(self: Rig, *args: Any, **kwargs: Any) -> Any:
        try:
            return method(self, *args, **kwargs)
        except (HandfitError, ReferenceError):
            raise
        except Exception as error:
            raise HandModelError(failure_sentence(type(self), error)) from error

    return guarded
