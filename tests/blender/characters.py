"""Character armatures that tests build: bones anywhere, named as they like."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix, Vector

from blender_manient.scene.characters import keep_map
from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, NUM_JOINTS, PARENTS, Side
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model import axes
from handfit_core.hand_model.files import kept_model
from handfit_core.retarget.hand_map import HandMap


@dataclass(frozen=True)
class BoneSpec:
    """One bone to be built, in the armature's space."""

    name: str
    parent: str
    head: Sequence[float] | np.ndarray
    tail: Sequence[float] | np.ndarray
    roll: float = 0.0


def build_armature(specs: Sequence[BoneSpec], name: str = "Character") -> bpy.types.Object:
    """An armature in the open scene with these bones; parents come before children."""
    data = bpy.data.armatures.new(name)
    obj = bpy.data.objects.new(name, data)
    bpy.context.collection.objects.link(obj)
    bpy.context.view_layer.objects.active = obj
    obj.select_set(True)
    bpy.ops.object.mode_set(mode="EDIT")
    for spec in specs:
        bone = data.edit_bones.new(spec.name)
        bone.head, bone.tail, bone.roll = Vector(spec.head), Vector(spec.tail), spec.roll
        if spec.parent:
            bone.parent = data.edit_bones[spec.parent]
    bpy.ops.object.mode_set(mode="OBJECT")
    return obj


def joint_name(joint: int, side: Side) -> str:
    """A name that no table knows."""
    return f"b{joint:02d}_{side[0]}"


def mixamo_names(side: Side, prefix: str = "mixamorig:") -> dict[int, str]:
    """What Mixamo calls a hand's bones, by MANO's joints."""
    own = f"{prefix}{side.capitalize()}Hand"
    called = dict(zip(FINGERS, ("Thumb", "Index", "Middle", "Ring", "Pinky"), strict=True))
    fingers = {j: f"{own}{called[f]}{i + 1}" for f in FINGERS for i, j in enumerate(FINGER_JOINTS[f])}
    return {0: own, **fingers}


def hand_specs(
    side: Side,
    rng: np.random.Generator,
    *,
    bend: float = 0.0,
    stretch: float = 0.0,
    names: Mapping[int, str] | None = None,
    parent: str = "",
    place: np.ndarray | None = None,
    turn: np.ndarray | None = None,
    scale: float = 1.0,
) -> list[BoneSpec]:
    """The 16 bones of a hand with random proportions (`stretch`), rest bends (`bend`, radians), and rolls."""
    shaped = kept_model("open-hand", side).shaped()
    rest, tips = axes.points_to_rest(shaped.joints), axes.points_to_rest(shaped.tips)
    names = names or {joint: joint_name(joint, side) for joint in range(NUM_JOINTS)}
    turn = np.eye(3) if turn is None else turn
    heads, turned = np.zeros((NUM_JOINTS, 3)), np.empty((NUM_JOINTS, 3, 3))
    turned[0] = np.eye(3)
    for joint in range(1, NUM_JOINTS):
        above = PARENTS[joint]
        length = 1.0 + rng.uniform(-stretch, stretch)
        heads[joint] = heads[above] + turned[above] @ (length * (rest[joint] - rest[above]))
        turned[joint] = turned[above] @ rotvec_to_rotmat(rng.uniform(-1.0, 1.0, 3) * bend / np.sqrt(3.0))
    place = np.zeros(3) if place is None else place

    def put(point: np.ndarray) -> list[float]:
        return (place + scale * (turn @ point)).tolist()

    specs = []
    for joint in range(NUM_JOINTS):
        after = [j for j in range(NUM_JOINTS) if PARENTS[j] == joint]
        if joint == 0:
            tail = heads[FINGER_JOINTS["middle"][0]]
        elif after:
            tail = heads[after[0]]
        else:
            finger = next(f for f, name in enumerate(FINGERS) if joint in FINGER_JOINTS[name])
            tail = heads[joint] + turned[joint] @ (tips[finger] - rest[joint])
        above = names[PARENTS[joint]] if joint else parent
        roll = rng.uniform(-np.pi, np.pi)
        specs.append(BoneSpec(names[joint], above, put(heads[joint]), put(tail), roll))
    return specs


def map_of(side: Side, names: Mapping[int, str] | None = None) -> HandMap:
    """The table of such a hand."""
    return HandMap(side, tuple((names or {}).get(j, joint_name(j, side)) for j in range(NUM_JOINTS)))


def one_handed(side: Side = "right", seed: int = 3, name: str = "Character", **fields) -> bpy.types.Object:
    """A character with one such hand and its table, whose fingertips need not touch; `fields` of
    `hand_specs`."""
    armature = build_armature(hand_specs(side, np.random.default_rng(seed), **fields), name)
    keep_map(armature, map_of(side))
    armature.manient.character.contacts = False
    return armature


def placed(obj: bpy.types.Object, rng: np.random.Generator, scale: float) -> None:
    """Put an object somewhere, turned and scaled."""
    turn = rotvec_to_rotmat(rng.normal(size=3))
    obj.matrix_world = (
        Matrix.Translation(rng.normal(size=3).tolist()) @ Matrix(turn).to_4x4() @ Matrix.Scale(scale, 4)
    )
