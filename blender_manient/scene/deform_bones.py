"""The bones that deform a character, in a hierarchy without the controls."""

from __future__ import annotations

from collections.abc import Iterable

import bpy
import numpy as np

from handfit_core.retarget.bones import Bones

from ..rigs.character import bones_of

_BESIDE = 1e-3
"""parts of a bone's length by which another may lie beside it and still stand for it"""


def deforming_tree(armature: bpy.types.Object) -> tuple[dict[str, str], dict[str, str]]:
    """The name of each bone that deforms, with that of the deforming bone it hangs on; and the name of every
    bone, with that of the deforming bone that stands for it. Empty names: none.

    A control rig's deforming bones often hang on bones that deform nothing, as Rigify's DEF- bones do on its
    ORG- bones. Such a bone is stood for by the deforming bone that lies on it at rest; where none does, its
    parent is asked. Where no bone is marked as deforming, all are.
    """
    bones = bones_of(armature)
    deform = np.array([bone.use_deform for bone in armature.data.bones], dtype=bool)
    kept = np.flatnonzero(deform if deform.any() else ~deform)
    hung: dict[int, int] = {}
    for bone in kept.tolist():
        hung[bone] = _standing(bones, bones.ancestors(bone), bones.heads[bone], kept, _hanging(hung, bone))
    names = ("" if bone < 0 else bones.names[bone] for bone in hung.values())
    tree = dict(zip((bones.names[bone] for bone in kept), names, strict=True))
    standing = {
        name: bones.names[found] if found >= 0 else ""
        for bone, name in enumerate(bones.names)
        for found in [_standing(bones, (bone, *bones.ancestors(bone)), bones.heads[bone], kept, set())]
    }
    return tree, standing


def _hanging(hung: dict[int, int], bone: int) -> set[int]:
    """The bone and all that hang on it so far."""
    found = {bone}
    while more := {child for child, parent in hung.items() if parent in found} - found:
        found |= more
    return found


def _standing(
    bones: Bones, line: Iterable[int], near: np.ndarray, kept: np.ndarray, without: set[int]
) -> int:
    """The first of `line` that is among the kept bones, or for which one of them stands: of several the one
    whose end is nearest to a point (3,). -1: none of them."""
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
