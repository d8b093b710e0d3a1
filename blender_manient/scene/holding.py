"""What a character's hand holds: an object that follows it by a Child Of constraint."""

from __future__ import annotations

import bmesh
import bpy
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from handfit_core.retarget.contacts import HeldObject

from .actions import present_curves
from .own_scene import object_mode, shown_in_pose, unseen_scene
from .sampling import stepped


def held_by(armature: bpy.types.Object, hand: str, frames: np.ndarray) -> HeldObject | None:
    """Return the mesh that a character's hand, the bone of that name, holds on scene frames (T,); of several
    the first by name, and None without one. Its shape and its place in the hand are those of the frame in
    which it first is held most."""
    for obj in sorted(bpy.context.scene.objects, key=lambda o: o.name):
        for child in obj.constraints if obj.type == "MESH" else ():
            if not _follows(child, armature, hand):
                continue
            path = child.path_from_id("influence")
            curve = next((c for c in present_curves(obj) if c.data_path == path), None)
            share = np.array([child.influence if curve is None else curve.evaluate(f) for f in frames])
            if share.any():
                surface = _Surface(obj, armature, hand, float(frames[share.argmax()]))
                return HeldObject(surface.nearest, share) if surface.faces else None
    return None


def _follows(child: bpy.types.Constraint, armature: bpy.types.Object, hand: str) -> bool:
    """True if by this constraint an object follows a hand's bone, or a control at its wrist."""
    if child.type != "CHILD_OF" or child.target != armature or child.mute:
        return False
    followed, own = armature.data.bones.get(child.subtarget), armature.data.bones[hand]
    return followed is not None and (followed.head_local - own.head_local).length < 1e-3 * own.length


class _Surface:
    """The surface of a mesh in the space of a character's armature while the hand that holds it is at
    rest."""

    def __init__(self, obj: bpy.types.Object, armature: bpy.types.Object, hand: str, frame: float) -> None:
        mesh = bmesh.new()
        with object_mode(), unseen_scene("held") as scene, shown_in_pose([armature, obj]):
            for each in (armature, obj):
                scene.collection.objects.link(each)
            graph = next(stepped(scene, [frame]))
            shown, posed = obj.evaluated_get(graph), armature.evaluated_get(graph)
            now = posed.matrix_world @ posed.pose.bones[hand].matrix
            mesh.from_object(obj, graph)
            mesh.transform(armature.data.bones[hand].matrix_local @ now.inverted() @ shown.matrix_world)
            mesh.normal_update()  # A negative scale turns the faces over.
        self.faces = len(mesh.faces)
        # Of an open mesh, which has no inside, both sides are outside.
        closed = all(edge.is_manifold for edge in mesh.edges)
        self._outward = 0.0 if not closed else 1.0 if mesh.calc_volume(signed=True) > 0.0 else -1.0
        self._tree = BVHTree.FromBMesh(mesh)
        mesh.free()

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what `HeldObject.nearest` does."""
        distances, out = np.empty(len(points)), np.empty_like(points)
        for row, point in enumerate(points.tolist()):
            place, normal, _, distance = self._tree.find_nearest(point)
            away = Vector(point) - place
            inside = away.dot(normal) * self._outward < 0.0
            distances[row] = -distance if inside else distance
            out[row] = away / distances[row] if distance > 0.0 else normal
        return distances, out
