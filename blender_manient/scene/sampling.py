"""What a rig really shows, frame by frame: keys, NLA, constraints, drivers and parents together."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import bpy
import numpy as np

from handfit_core.geometry.rotations import rotmat_to_quat, unflip_quats

from ..rigs.rig import PosedBones, bone_path
from .actions import present_curves
from .own_scene import object_mode, shown_in_pose, unseen_scene

_AT_ONCE = 20
"""How many frames Blender evaluates in one slice"""
_SHEARED = 1e-4
"""How far the axes of a bone, of length 1, may be from its nearest rotation"""


@dataclass(frozen=True, eq=False)
class Sampled:
    """The bones that an armature shows on N frames. Matrices are Blender's: columns are axes and origin."""

    names: tuple[str, ...]
    """The B bones, parents before children"""
    parents: tuple[int, ...]
    """Index of each bone's parent; -1 for none"""
    rest: np.ndarray
    """(B, 4, 4) rest bones in the armature's space"""
    pose: np.ndarray
    """(N, B, 4, 4) posed bones in the armature's space"""
    world: np.ndarray
    """(N, 4, 4) the armature's space in the world, in the scene's units"""

    def of(self, names: Sequence[str]) -> np.ndarray:
        """Return (N, K, 4, 4) the named bones, posed in the armature's space."""
        return self.pose[:, [self.names.index(name) for name in names]]

    def basis(self) -> np.ndarray:
        """Return (N, B, 4, 4) what each bone does relative to its rest and its parent."""
        found = np.empty_like(self.pose)
        for bone, parent in enumerate(self.parents):
            if parent < 0:
                found[:, bone] = np.linalg.inv(self.rest[bone]) @ self.pose[:, bone]
                continue
            offset = np.linalg.inv(self.rest[parent]) @ self.rest[bone]
            found[:, bone] = np.linalg.inv(self.pose[:, parent] @ offset) @ self.pose[:, bone]
        return found

    def reparented(self, tree: Mapping[str, str]) -> Sampled:
        """Return the bones of `tree` alone, which maps each bone's name to its new parent's, empty for a
        root.

        Files hold no shear: where a bone would have it because one above is stretched, those above keep their
        places, turns and volume, and lose the stretch."""
        at = [self.names.index(name) for name in tree]
        order = {name: index for index, name in enumerate(tree)}
        parents = tuple(order.get(parent, -1) for parent in tree.values())
        found = replace(
            self, names=tuple(tree), parents=parents, rest=self.rest[at], pose=self.pose[:, at].copy()
        )
        basis = found.basis()[..., :3, :3]
        plain = rotations_of(basis) * np.linalg.norm(basis, axis=-2)[..., None, :]
        above = set()
        for bone in np.flatnonzero(
            np.abs(basis - plain).max(axis=(0, 2, 3), initial=0.0) > _SHEARED
        ).tolist():
            while (bone := parents[bone]) >= 0:
                above.add(bone)
        for bone in above:
            posed = found.pose[:, bone, :3, :3]
            posed[:] = rotations_of(posed) * np.cbrt(np.linalg.det(posed))[:, None, None]
        return found

    def without(self, names: Collection[str]) -> Sampled:
        """Return the armature without the named bones, whose children become roots."""
        kept = [index for index, name in enumerate(self.names) if name not in names]
        parents = tuple(kept.index(self.parents[i]) if self.parents[i] in kept else -1 for i in kept)
        return replace(
            self,
            names=tuple(self.names[i] for i in kept),
            parents=parents,
            rest=self.rest[kept],
            pose=self.pose[:, kept],
        )


def sample(
    armature: bpy.types.Object,
    frames: Iterable[float],
    scene: bpy.types.Scene,
    names: Collection[str] | None = None,
) -> Sampled:
    """Step a scene, which must contain the armature, through the frames and read all bones, or those of some
    names, which costs by far less where a character has hundreds: children of others count as having no
    parent.

    Leaves the scene on the last of them. What is hidden or in Rest Position is read as such: see
    `own_scene.shown_in_pose`.
    """
    resting = _at_rest(armature, names)
    found = [_shown(armature, depsgraph, resting.names) for depsgraph in stepped(scene, frames)]
    shape = len(found), len(resting.names), 4, 4
    return replace(
        resting,
        pose=np.array([pose for pose, _ in found], dtype=np.float64).reshape(shape),
        world=np.array([world for _, world in found], dtype=np.float64).reshape(-1, 4, 4),
    )


def stepped(scene: bpy.types.Scene, frames: Iterable[float]) -> Iterator[bpy.types.Depsgraph]:
    """Step a scene through frames, and have it evaluated on each. Blender writes what it finds back to the
    objects if the scene is the open one, else (`own_scene.unseen_scene`) nothing.
    """
    for frame in frames:
        whole = int(np.floor(frame))
        scene.frame_set(whole, subframe=float(frame - whole))
        is_open = scene == bpy.context.scene
        yield bpy.context.evaluated_depsgraph_get() if is_open else scene.view_layers[0].depsgraph


def shown_now(armature: bpy.types.Object) -> Sampled:
    """Return the bones that the open scene shows at its present frame."""
    resting = _at_rest(armature)
    pose, world = _shown(armature, bpy.context.evaluated_depsgraph_get(), resting.names)
    return replace(resting, pose=pose[None], world=world[None])


def _at_rest(armature: bpy.types.Object, wanted: Collection[str] | None = None) -> Sampled:
    """Return the bones of an armature on no frame."""
    # Parents come before children.
    bones = [bone for bone in armature.data.bones if wanted is None or bone.name in wanted]
    place = {bone.name: index for index, bone in enumerate(bones)}
    return Sampled(
        tuple(place),
        tuple(place.get(bone.parent.name, -1) if bone.parent else -1 for bone in bones),
        np.array([bone.matrix_local for bone in bones], dtype=np.float64).reshape(-1, 4, 4),
        np.empty((0, len(bones), 4, 4)),
        np.empty((0, 4, 4)),
    )


def _shown(
    armature: bpy.types.Object, depsgraph: bpy.types.Depsgraph, names: Iterable[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the bones of those names in the armature's space, (B, 4, 4), and that space in the world, (4,
    4), as they were evaluated."""
    shown = armature.evaluated_get(depsgraph)
    # Copied: Blender hands out views of what the next frame overwrites.
    pose = [shown.pose.bones[name].matrix for name in names]
    return np.array(pose, dtype=np.float64).reshape(-1, 4, 4), np.array(shown.matrix_world, dtype=np.float64)


def sample_unseen(
    armature: bpy.types.Object, frames: Iterable[float], names: Collection[str] | None = None
) -> Sampled:
    """Sample as `sample` does in a scene that no window opens; what is hidden or in Rest Position is shown in
    it."""
    with object_mode(), unseen_scene("sampled") as scene, shown_in_pose([armature]):
        scene.collection.objects.link(armature)
        return sample(armature, frames, scene, names)


def sampling_unseen(
    armature: bpy.types.Object,
    frames: np.ndarray,
    names: Collection[str] | None = None,
    around: Callable[[], contextlib.AbstractContextManager[None]] = contextlib.nullcontext,
) -> Generator[float, None, Sampled]:
    """Sample as `sample_unseen` does, some frames at a time; yields how much is done, 0..1. Blender evaluates
    them in a context that `around` makes."""
    parts = []
    for start in range(0, len(frames), _AT_ONCE):
        with around():
            parts.append(sample_unseen(armature, frames[start : start + _AT_ONCE], names))
        yield start / len(frames)
    pose, world = (np.concatenate([getattr(part, name) for part in parts]) for name in ("pose", "world"))
    return replace(parts[0], pose=pose, world=world)


def rests(armature: bpy.types.Object, bone: bpy.types.Bone) -> bool:
    """True if nothing can move a bone over time: no key, driver, strip or constraint of it or above it."""
    data = armature.animation_data
    above = {b.name for b in (bone, *bone.parent_recursive)}
    if any(len(armature.pose.bones[name].constraints) for name in above):
        return False
    if data is None:
        return True
    curves = [*data.drivers, *present_curves(armature)]
    starts = tuple(f"{bone_path(name)}." for name in above)
    return not len(data.nla_tracks) and not any(curve.data_path.startswith(starts) for curve in curves)


def sampled_pose(rig: PosedBones, frames: Iterable[float]) -> tuple[np.ndarray, np.ndarray]:
    """Return the pose that the bones show on N frames, whatever moves them: quaternions (N, B, 4) as (w, x,
    y, z) and the first one's locations (N, 3)."""
    return of_bones(rig, sample_unseen(rig.armature, frames))


def of_bones(rig: PosedBones, sampled: Sampled) -> tuple[np.ndarray, np.ndarray]:
    """Return the B bones relative to their rest and parents: quaternions (N, B, 4) as (w, x, y, z), and the
    first one's place (N, 3)."""
    basis = sampled.basis()[:, [sampled.names.index(name) for name in rig.bones]]
    return unflip_quats(rotmat_to_quat(rotations_of(basis))), basis[:, 0, :3, 3]


def rotations_of(matrices: np.ndarray) -> np.ndarray:
    """Return the rotations (..., 3, 3) nearest to matrices (..., 4, 4) or (..., 3, 3) with some scale."""
    left, _, right = np.linalg.svd(matrices[..., :3, :3])
    sign = np.linalg.det(left @ right)
    left[..., :, 2] *= sign[..., None]
    return left @ right
