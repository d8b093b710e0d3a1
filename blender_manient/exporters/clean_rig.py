"""A plain copy of a hand's or a character's rig for programs that take files literally.

Of a character it has the bones that deform, and no controls. Everything that moves the rig (keys, NLA,
constraints, parents, the object itself) becomes keys of its bones, one per frame; the object stands still
with scale 1. Lengths and axes lie in the data instead of in the object, so that no program has a scale or a
turn to undo. Which bones deform, and what they hang on without the controls, is found here, too.
"""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix

from handfit_core.common.skeleton import Side
from handfit_core.geometry.rotations import rotmat_to_quat, unflip_quats
from handfit_core.retarget.bones import Bones

from ..common.blender_versions import assign_action
from ..rigs import rig_of
from ..rigs.arm import has_arm, tree_with_arm
from ..rigs.captured_hand import edited_bones
from ..rigs.character import bones_of
from ..rigs.controls import control_bones
from ..scene.keys import new_curve
from ..scene.sampling import Sampled, rotations_of, sample, stepped
from ..scene.store import is_deformed_by
from .exporter import HandObjects, Preset


@dataclass(frozen=True)
class CleanHand:
    """A plain copy of a hand or a character, which programs can take literally."""

    side: Side | None
    armature: bpy.types.Object
    meshes: tuple[bpy.types.Object, ...]
    """The copied meshes; none of a hand whose mesh the artist deleted"""


NEAR = 1e-5
"""metres from its rest place within which a bone stays in it to the eye"""
_STILL = 1e-7
"""Share of the rig's size below which a bone's change of location or scale counts as none"""


@contextlib.contextmanager
def clean_rig(
    hand: HandObjects,
    name: str,
    frames: Sequence[int],
    metres_per_unit: float,
    preset: Preset,
    apart: float = 0.0,
) -> Iterator[CleanHand]:
    """Make a copy of the hand in the context's scene, whose armature object is called `name` (empty: as
    before).

    `metres_per_unit` is the artist's scene's. The preset's rotation is done to the data and undone by the
    object. `apart` is that of the exporter. The hand must be in that scene, which has the copy instead
    afterwards; its names are lent to the copy. When this context ends the copy is gone. A character's mesh
    that a bone carries is deformed by that bone alone in the copy; one that no bone of the copy moves, and
    what a captured hand holds, has keys of its own, and no parent, where it moves.
    """
    scene, units, turned = bpy.context.scene, preset.units, np.eye(4)
    if preset.turn is not None:
        turned[:3, :3] = preset.turn
    tree, standing = deforming_tree(hand.armature) if hand.side is None else ({}, {})
    parents: dict[str, str] = {}
    if tree:
        sampled = sample(hand.armature, frames, scene, tree).reparented(tree)
    else:
        sampled = sample(hand.armature, frames, scene).without(control_bones(hand.armature).values())
        if has_arm(hand.armature):
            parents = tree_with_arm(hand.armature, rig_of(hand.armature, hand.side).bones[0], sampled.names)
            sampled = sampled.reparented(parents)
    size = metres_per_unit * float(np.cbrt(abs(np.linalg.det(sampled.world[0, :3, :3])))) * units
    grow = turned @ np.diag([size, size, size, 1.0])
    carriers = [_carrier(hand.armature, mesh) for mesh in hand.meshes]
    free = [
        mesh
        for mesh, carrier in zip(hand.meshes, carriers, strict=True)
        if not (_deformed(hand.armature, mesh) or standing.get(carrier, ""))
    ]
    places = dict(zip(free, _places(free, frames, scene), strict=True))

    originals = [hand.armature, *hand.meshes]
    names = [o.name for o in originals]
    lent = [o for o in originals if o.library is None]  # linked ones keep theirs, which are no file's names
    for original in lent:
        original.name = f"{original.name} (source)"
    copies = [_copy(o, scene) if tree or o not in places else _solid(o, scene) for o in originals]
    actions = []
    try:
        armature = copies[0]
        armature.name = name or names[0]
        armature.data.transform(Matrix(grow))
        armature.matrix_basis = Matrix(np.linalg.inv(turned))
        in_metres = np.diag([units * metres_per_unit] * 3 + [1.0])
        for mesh, copied, own, carrier in zip(hand.meshes, copies[1:], names[1:], carriers, strict=True):
            copied.name = own
            copied.parent = armature
            copied.matrix_parent_inverse = Matrix.Identity(4)
            copied.matrix_basis = Matrix.Identity(4)
            if mesh in places:
                placed, motion = _from_largest(turned @ in_metres @ places[mesh])
                if np.abs(motion - np.eye(4)).max() > _STILL * size:
                    copied.parent = None  # Blender's FBX importer ignores keys of what an armature carries.
                    motion = np.linalg.inv(turned) @ motion
                    turns = unflip_quats(rotmat_to_quat(rotations_of(motion)))
                    parts = [
                        ("", "location", motion[:, :3, 3]),
                        ("", "rotation_quaternion", turns),
                        ("", "scale", np.linalg.norm(motion[:, :3, :3], axis=-2)),
                    ]
                    actions.append(_key(copied, parts, frames))
            else:
                placed = grow @ _at_rest(hand.armature, mesh, carrier)
            copied.data.transform(Matrix(placed), shape_keys=True)
            _retarget(copied, hand.armature, armature, tree)
            if mesh not in places and not is_deformed_by(copied, armature):
                _deform_by(copied, armature, standing[carrier] if carrier else "")
        if not tree and control_bones(armature):
            rig_of(armature, hand.side).remove_controls()
        _plain_bones(armature)
        if tree or parents:
            _reparent(armature, tree or parents)
        actions.append(_bake(armature, sampled, turned @ in_metres @ sampled.world, size, frames))
        if apart and tree:
            far = np.abs(sampled.basis()[..., :3, 3]).max(axis=(0, 2)) * size > NEAR * units
            unconnect(armature, {sampled.names[bone] for bone in np.flatnonzero(far)}, apart * units)
        for original in originals:
            scene.collection.objects.unlink(original)
        yield CleanHand(hand.side, armature, tuple(copies[1:]))
    finally:
        bpy.data.batch_remove([*copies, *(o.data for o in copies), *actions])
        for original, old in zip(originals, names, strict=True):
            if original in lent:
                original.name = old


def _copy(original: bpy.types.Object, scene: bpy.types.Scene) -> bpy.types.Object:
    """Return a copy of an object with data of its own, that nothing moves."""
    obj, data = original.copy(), original.data.copy()
    for copied in (obj, data):
        if copied.override_library is not None:  # of which nothing could be taken away
            copied.make_local(clear_liboverride=True)
    obj.data = data
    obj.animation_data_clear()
    if obj.type == "ARMATURE":
        data.animation_data_clear()
    obj.parent, obj.parent_type, obj.parent_bone = None, "OBJECT", ""
    for constraint in list(obj.constraints):
        obj.constraints.remove(constraint)
    obj.rotation_mode = "QUATERNION"
    obj.delta_location, obj.delta_scale = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
    obj.delta_rotation_quaternion = (1.0, 0.0, 0.0, 0.0)
    obj.hide_viewport = obj.hide_render = False
    scene.collection.objects.link(obj)
    return obj


def _solid(original: bpy.types.Object, scene: bpy.types.Scene) -> bpy.types.Object:
    """Return a mesh object of the shape that an object of any type shows now, that nothing moves."""
    shown = original.evaluated_get(bpy.context.evaluated_depsgraph_get())
    obj = bpy.data.objects.new(original.name, bpy.data.meshes.new_from_object(shown))
    obj.rotation_mode = "QUATERNION"
    scene.collection.objects.link(obj)
    return obj


def _carrier(armature: bpy.types.Object, mesh: bpy.types.Object) -> str:
    """Return the name of the bone that carries a mesh; empty where none does."""
    return mesh.parent_bone if mesh.parent == armature and mesh.parent_type == "BONE" else ""


def _deformed(armature: bpy.types.Object, mesh: bpy.types.Object) -> bool:
    """True if the armature deforms a mesh, by a modifier or as its parent."""
    return is_deformed_by(mesh, armature) or (mesh.parent == armature and mesh.parent_type == "ARMATURE")


def _places(
    meshes: Sequence[bpy.types.Object], frames: Sequence[int], scene: bpy.types.Scene
) -> list[np.ndarray]:
    """Return for each mesh (N, 4, 4): its matrix in the world on each of the N frames, in the scene's
    units."""
    found = [
        [np.array(mesh.evaluated_get(depsgraph).matrix_world, dtype=np.float64) for mesh in meshes]
        for depsgraph in (stepped(scene, frames) if meshes else ())
    ]
    return [np.array(places) for places in zip(*found, strict=True)]


def _from_largest(places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (4, 4) the place where an object is largest, and (N, 4, 4) the matrices from there to each of
    its N places."""
    sizes = np.abs(np.linalg.det(places[:, :3, :3]))
    largest = places[int((sizes > sizes.max() * (1.0 - 1e-4)).argmax())]
    return largest, places @ np.linalg.pinv(largest)


def _at_rest(armature: bpy.types.Object, mesh: bpy.types.Object, carrier: str) -> np.ndarray:
    """Return the (4, 4) matrix from a mesh's space to the armature's, with the bone `carrier` that carries it
    at rest."""
    local = np.array(armature.matrix_world.inverted() @ mesh.matrix_world)
    if not carrier:
        return local
    posed = np.array(armature.pose.bones[carrier].matrix)
    return np.array(armature.data.bones[carrier].matrix_local) @ np.linalg.inv(posed) @ local


def _deform_by(mesh: bpy.types.Object, armature: bpy.types.Object, bone: str) -> None:
    """Have one bone alone deform a mesh, or, without a name, those that its vertex groups name."""
    if bone:
        mesh.vertex_groups.clear()
        mesh.vertex_groups.new(name=bone).add(range(len(mesh.data.vertices)), 1.0, "REPLACE")
    mesh.modifiers.new("Armature", "ARMATURE").object = armature
    mesh.modifiers.move(len(mesh.modifiers) - 1, 0)  # where Blender deforms by a parent


def _reparent(armature: bpy.types.Object, tree: Mapping[str, str]) -> None:
    """Remove all bones that the tree does not name, and hang the others on the parents that it gives
    (`deforming_tree`)."""
    with edited_bones(armature.data) as bones:
        bones_left_out = [bone for bone in bones if bone.name not in tree]
        for bone in bones:
            bone.use_connect = False
        for bone in bones_left_out:
            bones.remove(bone)
        for name, parent in tree.items():
            bones[name].parent = bones[parent] if parent else None


def unconnect(armature: bpy.types.Object, moving: Collection[str], apart: float) -> None:
    """Unconnect all bones of an armature. Those of them that move from their rest are
    put `apart` beside the end of the bone above, or Blender's importers would connect them again."""
    with edited_bones(armature.data) as bones:
        for bone in bones:
            bone.use_connect = False
            if bone.name not in moving or bone.parent is None:
                continue
            aside = bone.parent.matrix.inverted() @ bone.head
            if np.hypot(aside.x, aside.z) < 0.6 * apart:
                bone.translate(apart * bone.parent.x_axis)


def _retarget(
    mesh: bpy.types.Object, old: bpy.types.Object, new: bpy.types.Object, tree: Mapping[str, str]
) -> None:
    """Have modifiers and shape keys of the copied mesh follow the copied bones; drivers by other bones
    stay."""
    for modifier in mesh.modifiers:
        if modifier.type == "ARMATURE" and modifier.object == old:
            modifier.object = new
    keys = mesh.data.shape_keys
    if keys is None or keys.animation_data is None:
        return
    for curve in keys.animation_data.drivers:
        for variable in curve.driver.variables:
            for target in variable.targets:
                if target.id == old and (not tree or target.bone_target in tree):
                    target.id = new


def _plain_bones(armature: bpy.types.Object) -> None:
    for bone in armature.data.bones:
        bone.use_inherit_rotation = True
        bone.use_local_location = True
        bone.inherit_scale = "FULL"
    for bone in armature.pose.bones:
        bone.rotation_mode = "QUATERNION"
        bone.matrix_basis = Matrix.Identity(4)
        for constraint in list(bone.constraints):
            bone.constraints.remove(constraint)


def _bake(
    armature: bpy.types.Object, sampled: Sampled, world: np.ndarray, size: float, frames: Sequence[int]
) -> bpy.types.Action:
    """Key every bone on every frame. `world` (N, 4, 4) leads from the old armature's space to the new one's,
    whose lengths are `size` times the old one's."""
    basis = sampled.basis()
    basis[:, :, :3, 3] *= size
    for bone, parent in enumerate(sampled.parents):
        if parent >= 0:
            continue
        rest = np.array(armature.data.bones[sampled.names[bone]].matrix_local)
        placed = world @ sampled.pose[:, bone] @ np.diag([1 / size, 1 / size, 1 / size, 1.0])
        basis[:, bone] = np.linalg.inv(rest) @ placed
    turns = unflip_quats(rotmat_to_quat(rotations_of(basis)))
    scales = np.linalg.norm(basis[..., :3, :3], axis=-2)
    parts = []
    for bone, name in enumerate(sampled.names):
        parts.append((name, "rotation_quaternion", turns[:, bone]))
        if np.abs(basis[:, bone, :3, 3]).max() > _STILL * size or sampled.parents[bone] < 0:
            parts.append((name, "location", basis[:, bone, :3, 3]))
        if np.abs(scales[:, bone] - 1.0).max() > 1e-5:
            parts.append((name, "scale", scales[:, bone]))
    return _key(armature, parts, frames)


def _key(
    obj: bpy.types.Object, parts: Sequence[tuple[str, str, np.ndarray]], frames: Sequence[int]
) -> bpy.types.Action:
    """Key bones, or without a name the object itself, on each frame; `parts` has attributes with their values
    (N, C)."""
    action = bpy.data.actions.new(obj.name)
    holder = assign_action(obj, action)
    for bone, attribute, values in parts:
        for index in range(values.shape[1]):
            new_curve(holder, bone, attribute, index, np.asarray(frames), values[:, index])
    return action


_BESIDE = 1e-3
"""Parts of a bone's length by which another may lie beside it and still stand for it"""


def deforming_tree(armature: bpy.types.Object) -> tuple[dict[str, str], dict[str, str]]:
    """Return the name of each bone that deforms, with that of the deforming bone it hangs on; and the name of
    every bone, with that of the deforming bone that stands for it. Empty names: none.

    A control rig's deforming bones often hang on bones that deform nothing, as Rigify's DEF- bones do on its
    ORG- bones. Such a bone is stood for by the deforming bone that lies on it at rest; where none does, its
    parent is asked. Where no bone is marked as deforming, all are.
    """
    bones = bones_of(armature)
    deform = np.array([bone.use_deform for bone in armature.data.bones], dtype=bool)
    kept = np.flatnonzero(deform if deform.any() else ~deform)
    parents: dict[int, int] = {}
    for bone in kept.tolist():
        below = _descendants(parents, bone)
        parents[bone] = _standing(bones, bones.ancestors(bone), bones.heads[bone], kept, below)
    names = ("" if bone < 0 else bones.names[bone] for bone in parents.values())
    tree = dict(zip((bones.names[bone] for bone in kept), names, strict=True))
    standing = {
        name: bones.names[found] if found >= 0 else ""
        for bone, name in enumerate(bones.names)
        for found in [_standing(bones, (bone, *bones.ancestors(bone)), bones.heads[bone], kept, set())]
    }
    return tree, standing


def _descendants(parents: dict[int, int], bone: int) -> set[int]:
    """Return the indices of a bone and of all that hang on it so far."""
    found = {bone}
    while more := {child for child, parent in parents.items() if parent in found} - found:
        found |= more
    return found


def _standing(
    bones: Bones, line: Iterable[int], near: np.ndarray, kept: np.ndarray, without: set[int]
) -> int:
    """Return the first of `line` that is among the kept bones, or for which one of them stands: of several
    the one whose end is nearest to a point (3,); -1 where there is none."""
    allowed = np.array([bone for bone in kept.tolist() if bone not in without], dtype=int)
    for bone in line:
        if bone in allowed:
            return bone
        head, along = bones.heads[bone], bones.tails[bone] - bones.heads[bone]
        length = max(float(np.linalg.norm(along)), 1e-9)
        ends = np.stack([bones.heads[allowed], bones.tails[allowed]], axis=1)  # (K, 2, 3)
        share = (ends - head) @ along / length**2
        beside = np.linalg.norm(ends - head - share[..., None] * along, axis=-1) / length
        lies = (beside < _BESIDE).all(1) & (np.abs(share - 0.5) < 0.5 + _BESIDE).all(1)
        if lies.any():
            those = allowed[lies]
            return int(those[np.linalg.norm(bones.tails[those] - near, axis=-1).argmin()])
    return -1
