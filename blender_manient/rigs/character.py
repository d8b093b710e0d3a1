"""Hands of characters: what a kind of rig answers for, and what is written to."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import bpy
import numpy as np

from handfit_core.common.skeleton import Side
from handfit_core.retarget.bones import Bones
from handfit_core.retarget.hand_map import HandMap
from handfit_core.retarget.recognition import Found

from .rig import PosedBones


@dataclass(frozen=True)
class ArmControls:
    """The bones of an arm that get keys: by FK upper arm, forearm and hand; by IK the hand, and what swivels
    the elbow."""

    hand: str
    upper: str = ""
    fore: str = ""
    swivel: str = ""
    """By IK, the bone that turns the elbow about the arm, by its rotation about its own Y. Its parent's Y
    follows the hand by the smallest rotation"""
    pole: str = ""
    """By IK, the bone that the elbow points to; then `swivel` does nothing"""

    @property
    def keyed(self) -> tuple[str, ...]:
        """Return the names of all bones that get keys."""
        names = self.upper, self.fore, self.hand, self.pole or self.swivel
        return tuple(name for name in names if name)


class Character(ABC):
    """A kind of character rig: which of its bones are hands."""

    label: ClassVar[str]
    """The name by which an artist knows this kind of rig"""

    @classmethod
    @abstractmethod
    def find(cls, armature: bpy.types.Object, bones: Bones, side: Side) -> Found | None:
        """Return the hand of that side, if the armature has one of this kind; else None."""

    @classmethod
    def troubles(cls, armature: bpy.types.Object, hand_map: HandMap) -> list[str]:  # noqa: ARG003
        """Return what would make keys on the mapped bones useless, such as a switch that is set to IK; one
        sentence each. None of them by default. The map has no `control` where only fingers get keys."""
        return []

    @classmethod
    def arm_controls(
        cls,
        armature: bpy.types.Object,  # noqa: ARG003
        hand_map: HandMap,
        bones: tuple[str, str],
    ) -> ArmControls:
        """Return the bones that get the keys of an arm; `bones` are its upper arm and forearm, and by default
        they are these."""
        return ArmControls(hand_map.moved_by, *bones)


class CharacterBones(PosedBones):
    """Some bones of a character that get keys."""

    def __init__(self, armature: bpy.types.Object, bones: Sequence[str]) -> None:
        super().__init__(armature)
        self._bones = list(bones)

    @property
    def bones(self) -> list[str]:
        """Return the bones' names."""
        return self._bones


def bones_of(armature: bpy.types.Object) -> Bones:
    """Return how an armature's bones lie at rest, as Blender has them now."""
    bones = armature.data.bones
    names = tuple(bone.name for bone in bones)  # parents before children
    index = {name: i for i, name in enumerate(names)}
    parents = [-1 if bone.parent is None else index[bone.parent.name] for bone in bones]
    matrices = np.empty((len(names), 4, 4), dtype=np.float32)
    tails = np.empty((len(names), 3), dtype=np.float32)
    bones.foreach_get("matrix_local", matrices.ravel())
    bones.foreach_get("tail_local", tails.ravel())
    matrices = np.swapaxes(matrices, -1, -2).astype(np.float64)  # Blender stores columns
    return Bones(
        names,
        np.array(parents, dtype=int),
        matrices[:, :3, 3].copy(),
        tails.astype(np.float64),
        matrices[:, :3, :3].copy(),
    )


def driven_bones(armature: bpy.types.Object) -> set[str]:
    """Return the bones that a constraint turns or moves, so that keys of their own do nothing."""
    return {
        bone.name
        for bone in armature.pose.bones
        if any(
            not one.mute and one.influence > 0.0 and not one.type.startswith("LIMIT")
            for one in bone.constraints
        )
    }
