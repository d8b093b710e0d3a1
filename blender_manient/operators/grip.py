"""Grip: lay the fingers on an object that the hand holds, over a range of frames."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from handfit_core.common.arrays import packed
from handfit_core.common.errors import OptionError
from handfit_core.common.skeleton import FINGERS, JOINTS_BY_FINGER
from handfit_core.edit import Prop
from handfit_core.edit.corrections import changed_quats, correction_between
from handfit_core.edit.settings import GRIPS
from handfit_core.geometry.rotations import quat_multiply, quat_to_rotmat, rotmat_to_quat
from handfit_core.hand_model.axes import WORLD_FROM_CAMERA

from ..common.wording import counted
from ..scene.actions import present_curves
from ..scene.corrections import correct_frames
from ..scene.keys import read_pose_keys
from ..scene.own_scene import object_mode
from ..scene.sampling import rotations_of, stepped
from ..scene.store import CapturedHand
from ..session.properties import has_surface
from ..session.refiner import Refiner
from .base import polled_hand
from .refit_range import RangeFit, RangeFitOperator

_RIGID = 1e-5
"""Largest difference of a matrix's numbers from those of a rotation that still counts as one"""
_MOVED = 1e-6
"""Largest difference of a quaternion's or a place's numbers that counts as no change"""
_STILL = 1e-4
"""Largest difference of matrices between frames of an object that stands still"""
_FLESH = 0.01
"""metres around a finger's bones"""


class MANIENT_OT_grip(RangeFitOperator, bpy.types.Operator):
    """Lay the fingers that are near an object on its surface, over a range of frames. Other fingers stay, and
    so does the wrist, unless the palm is inside the object; before and after it fades out over Spread. Asks
    for the object and the range first."""

    bl_label = "Grip"
    progress_text = "Laying fingers on the object"

    prop: bpy.props.StringProperty(name="Object", description="What the hand holds", options={"SKIP_SAVE"})
    fingers: bpy.props.BoolVectorProperty(
        name="Fingers", description="Which fingers may be laid on it", size=5, default=(True,) * 5
    )
    strength: bpy.props.FloatProperty(
        name="Strength",
        description="How far fingers go from where they are to the object's surface",
        subtype="FACTOR",
        default=1.0,
        min=0.0,
        max=1.0,
    )
    rides: bpy.props.BoolProperty(
        name="Move Together",
        description="From the first frame to the last the object keeps its present place in the hand. If it "
        "stands still, it rides with the hand by a Child Of constraint, and lies before and after where the "
        "hand takes and leaves it. If it moves, or another hand carries it, the hand rides with it",
    )

    _ticked_for: bpy.types.Object | None = None
    """The object for which the fingers near to it were ticked; None before"""

    def suggest(self, context):
        """Suggest the selected mesh beside the hand, and the frames that Re-fit Range suggests."""
        super().suggest(context)
        own, settings = polled_hand(context), context.scene.manient
        others = [o for o in context.selected_objects if o.type == "MESH" and o not in own.meshes]
        settings.grip_prop = next(iter(others), settings.grip_prop)
        self.check(context)

    def check(self, context):
        """Tick the fingers that are near the object, once another object is chosen."""
        prop = context.scene.manient.grip_prop
        self.prop = prop.name if prop is not None else ""
        if prop != self._ticked_for:
            self._ticked_for = prop
            self.fingers = _near(polled_hand(context), prop)
        return super().check(context)

    def draw_properties(self):
        # The dialog opens with its first field under the mouse, where Enter would search for an object.
        self.layout.prop(self, "strength")
        self.layout.prop(bpy.context.scene.manient, "grip_prop", text="")
        row = self.layout.row(align=True)
        for index, finger in enumerate(FINGERS):
            row.prop(self, "fingers", index=index, text=finger.capitalize(), toggle=True)
        self.layout.prop(self, "rides")

    def summary(self, context):
        prop = _prop_named(context, self.prop)
        count = len(self.rows(context, Refiner(polled_hand(context).armature)))
        return f"Lays fingers within 2 cm of {prop.name!r} on it, in {counted(count, 'frame')}", False

    def make_fit(self, context):
        return _GripFit(self, context)

    def report_text(self, fit):
        rides = ", and the hand rides with it" * fit.hand_rides
        return "INFO", f"Fingers lie on {self.prop!r} in {counted(fit.laid, 'frame')}{rides}"


def _near(hand: CapturedHand, prop: bpy.types.Object | None) -> list[bool]:
    """Tell which fingers are near an object's surface as it is shown; all of them where no finger is near, or
    there is no such surface."""
    armature = hand.armature
    shown = prop and prop.evaluated_get(bpy.context.evaluated_depsgraph_get())
    if not shown or shown.type != "MESH" or not shown.data.polygons or not shown.matrix_world.determinant():
        return [True] * len(FINGERS)
    to_prop = shown.matrix_world.inverted() @ armature.matrix_world
    to_hand, near = to_prop.inverted_safe(), []
    for joints in JOINTS_BY_FINGER[:, 1:]:
        ends = [armature.pose.bones[hand.rig.bones[joint]].tail for joint in joints]
        found = [to_hand @ shown.closest_point_on_mesh(to_prop @ end)[1] for end in ends]
        gaps = [(a - b).length for a, b in zip(ends, found, strict=True)]
        near.append(min(gaps) < GRIPS.reach[1] + _FLESH)
    return near if any(near) else [True] * len(FINGERS)


def _prop_named(context: bpy.types.Context, name: str) -> bpy.types.Object:
    """Return the object of that name that the hand may hold. Raises OptionError."""
    prop, hand = context.scene.objects.get(name), polled_hand(context)
    if prop is None:
        raise OptionError("choose an object of this scene for the hand to hold")
    if not has_surface(prop):
        raise OptionError(f"{name!r} has no surface: choose a mesh")
    if prop in hand.meshes:
        raise OptionError(f"{name!r} is the hand itself: choose what it holds")
    if not prop.visible_get():
        raise OptionError(f"{name!r} is hidden: show it, then grip again")
    return prop


class _GripFit(RangeFit):
    """The work of laying fingers on an object in the frames of a range."""

    laid: int
    """The number of frames in which fingers were laid on it"""
    hand_rides = False
    """True if the hand rides with the object"""

    def __init__(self, operator: MANIENT_OT_grip, context: bpy.types.Context) -> None:
        super().__init__(operator, context)
        prop = _prop_named(context, operator.prop)
        self._name, self._strength, self._prop_rides = prop.name, operator.strength, False
        rows, refiner = self.rows.tolist(), self.refiner
        frames, now = refiner.scene_frames()[self.rows], context.scene.frame_current_final
        self._now = int(np.abs(frames - now).argmin()) if frames[0] <= now <= frames[-1] else 0
        if not len(read_pose_keys(refiner.hand.rig).frames):
            raise OptionError("the hand has no keys to correct: capture it again, or key it first")
        self._start = refiner.keyed_poses(rows)
        held = self._held(context.scene, prop, np.array(operator.fingers), together=operator.rides)
        self.requests = [(len(part), self._request(part, each)) for part, each in held]

    def _request(self, part: np.ndarray, held: Prop) -> Any:
        rows, start = self.rows[part].tolist(), self._start.select(part)
        hand = self.refiner.request(rows, [{} for _ in rows], start, mode="grip", touches=[{} for _ in rows])
        return lambda: hand() | {"prop": packed(held)}

    def _held(
        self, scene: bpy.types.Scene, prop: bpy.types.Object, fingers: np.ndarray, *, together: bool
    ) -> Iterator[tuple[np.ndarray, Prop]]:
        """Yield groups of frames in which the object keeps its shape and size: their indices, and the object
        as it is turned and moved in them."""
        armature, now = self.refiner.armature, (scene.frame_current, scene.frame_subframe)
        shapes, matrices, carriers = [], [], []
        with object_mode():
            for graph in stepped(scene, self.refiner.scene_frames()[self.rows]):
                shown, space = prop.evaluated_get(graph), armature.evaluated_get(graph).matrix_world
                shapes.append(_faces(shown))
                matrices.append(np.array([shown.matrix_world, self._hand_now(graph), space]))
                child = _carrying(prop)
                carriers.append(child.target if child else prop.parent if prop.parent == armature else None)
        scene.frame_set(now[0], subframe=now[1])
        worlds, hands, spaces = np.array(matrices).swapaxes(0, 1)
        if not np.linalg.det(hands).all():
            raise OptionError("the hand is scaled to zero: scale it up, then grip again")
        if together:
            worlds = self._together(prop, worlds, hands, carriers)
        places = np.linalg.inv(spaces) @ worlds
        places[:, :3, 3] += self.refiner.hand.rig.rest.origin
        places = WORLD_FROM_CAMERA.T @ places[:, :3]
        first = 0
        for at in range(1, len(places) + 1):
            if at < len(places) and all(map(np.array_equal, shapes[at], shapes[first])):
                continue
            for part, vertices, placed in _rigid_parts(shapes[first][0], places[first:at]):
                yield first + part, Prop(vertices, shapes[first][1], placed, fingers)
            first = at

    def _together(
        self, prop: bpy.types.Object, worlds: np.ndarray, hands: np.ndarray, carriers: list[Any]
    ) -> np.ndarray:
        """Decide whether the object rides with the hand or the hand with it, from the matrices (N, 4, 4) of
        both in the world and what carries the object. Returns where the object will be."""
        now, armature = self._now, self.refiner.armature
        if all(carrier == armature for carrier in carriers[:-1]):
            self._prop_rides, self._first_hand = prop.parent != armature, Matrix(hands[0])
            if carriers[-1] is None and len(worlds) > 1:  # It was left there.
                worlds[-1] = hands[-1] @ np.linalg.inv(hands[-2]) @ worlds[-2]
            return worlds
        if armature in carriers:
            raise OptionError(
                f"{self._name!r} rides with this hand in a part of the range: grip it there only, or delete "
                "its constraint"
            )
        if not any(carriers) and np.abs(worlds - worlds[now]).max() < _STILL:
            action = prop.animation_data and prop.animation_data.action
            if prop.library is not None or (action and action.library is not None):
                raise OptionError(f"{prop.name!r} or its action is linked and cannot ride: make it local")
            self._prop_rides = True
            return hands @ np.linalg.inv(hands[now]) @ worlds
        if armature.manient.locked[0]:
            raise OptionError(f"{self._name!r} moves, but the wrist is locked and cannot follow: unlock it")
        self.hand_rides = True
        motion = np.linalg.inv(hands) @ worlds @ np.linalg.pinv(worlds[now]) @ hands[now]
        wrists = self._start.quats[:, 0]
        self._start.locations[:] += (quat_to_rotmat(wrists) @ motion[:, :3, 3:])[..., 0]
        wrists[:] = quat_multiply(wrists, rotmat_to_quat(rotations_of(motion)))
        return worlds

    def _hand_now(self, graph: bpy.types.Depsgraph) -> Matrix:
        """Return the matrix of the wrist's bone in the world, as it is shown."""
        shown = self.refiner.armature.evaluated_get(graph)
        return shown.matrix_world @ shown.pose.bones[self.refiner.hand.rig.bones[0]].matrix

    def received(self, poses):
        changed = np.abs(poses.quats - self._start.quats).max(axis=(1, 2)) > _MOVED
        changed |= np.abs(poses.locations - self._start.locations).max(axis=1) > _MOVED
        if not changed.any():
            raise OptionError(f"no finger comes near {self._name!r} in this range: nothing was changed")
        self.laid = int(changed.sum())
        if self._strength < 1.0:
            turns = self._strength * correction_between(self._start.quats, poses.quats)
            poses.quats[:] = changed_quats(self._start.quats, np.zeros_like(turns), turns)
            poses.locations[:] -= (1.0 - self._strength) * (poses.locations - self._start.locations)
        for rows, start in ((poses.quats, self._start.quats), (poses.locations, self._start.locations)):
            rows[~changed] = start[~changed] if self.hand_rides else np.nan
        super().received(poses)

    def writing(self):
        there, poses = self.poses.present, self.poses
        frames = [self.refiner.source_frame(row) for row in self.rows[there]]
        correct_frames(
            self.refiner.armature, frames, poses.quats[there], poses.locations[there], self.spread, posed=True
        )
        yield 1.0
        prop = bpy.context.scene.objects.get(self._name)
        if self._prop_rides and prop is not None and len(self.rows) > 1:
            self._ride(bpy.context.scene, prop)

    def _ride(self, scene: bpy.types.Scene, prop: bpy.types.Object) -> None:
        """Have the prop keep its present place in the hand from the first frame to the last, and lie where it
        takes and leaves it before and after."""
        now = scene.frame_current, scene.frame_subframe
        kept, first, last = self.refiner.scene_frames()[self.rows[[self._now, 0, -1]]].tolist()
        turn = {"QUATERNION": "rotation_quaternion", "AXIS_ANGLE": "rotation_axis_angle"}
        own = ("location", turn.get(prop.rotation_mode, "rotation_euler"), "scale")
        steps = stepped(scene, (kept, first, last))
        in_hand = self._hand_now(next(steps)).inverted() @ prop.matrix_world
        hand, child = self._hand_now(next(steps)), _carrying(prop)
        if child is None:
            prop.matrix_world = hand @ in_hand
            child = self._hung(prop, first, last)
            child.inverse_matrix = hand.inverted()
            for path in own:
                prop.keyframe_insert(path, frame=first)
            for curve in present_curves(prop):
                if curve.data_path in (*own, child.path_from_id("influence")):
                    for key in curve.keyframe_points:
                        if first - 1 <= key.co.x < last:
                            key.interpolation = "CONSTANT"
        else:
            child.inverse_matrix = hand.inverted() @ self._first_hand @ child.inverse_matrix
        bpy.context.view_layer.update()
        in_hand = hand.inverted() @ prop.matrix_world
        hand = self._hand_now(next(steps))
        if _carrying(prop) is None:
            prop.matrix_world = hand @ in_hand
            for path in own:
                prop.keyframe_insert(path, frame=last)
        scene.frame_set(now[0], subframe=now[1])

    def _hung(self, prop: bpy.types.Object, first: float, last: float) -> bpy.types.Constraint:
        """Return a new constraint by which the prop follows the hand from the first frame to the last."""
        child = prop.constraints.new("CHILD_OF")
        child.name = f"Held by {self.refiner.armature.name}"
        child.target, child.subtarget = self.refiner.armature, self.refiner.hand.rig.bones[0]
        for frame, influence in ((first - 1, 0.0), (first, 1.0), (last, 0.0)):
            child.influence = influence
            child.keyframe_insert("influence", frame=frame)
        return child


def _carrying(prop: bpy.types.Object) -> Any:
    """Return the constraint by which a hand carries a prop in the scene's frame; None without one."""
    held = (c for c in prop.constraints if c.type == "CHILD_OF" and c.influence > 0.0 and not c.mute)
    return next((c for c in held if c.target is not None and c.target.type == "ARMATURE"), None)


def _faces(shown: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """Return the vertices (V, 3) and triangles (F, 3) of an evaluated object, in its own units."""
    mesh = shown.to_mesh()
    vertices, triangles = np.empty((0, 3), dtype=np.float32), np.empty((0, 3), dtype=np.int32)
    if mesh is not None:
        mesh.calc_loop_triangles()
        vertices = np.empty((len(mesh.vertices), 3), dtype=np.float32)
        triangles = np.empty((len(mesh.loop_triangles), 3), dtype=np.int32)
        mesh.vertices.foreach_get("co", vertices.reshape(-1))
        mesh.loop_triangles.foreach_get("vertices", triangles.reshape(-1))
        shown.to_mesh_clear()
    return vertices, triangles


def _rigid_parts(
    vertices: np.ndarray, places: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Split frames into groups in which the object is turned and moved but not scaled.

    Yields each group's frame indices, the vertices (V, 3) in metres, and (N, 3, 4) its turns and places."""
    left = np.arange(len(places))
    while len(left):
        linear, at = places[left, :, :3], places[left, :, 3]
        turn = linear @ np.linalg.pinv(linear[0])
        rigid = np.abs(turn @ turn.swapaxes(1, 2) - np.eye(3)).max(axis=(1, 2)) < _RIGID
        rigid[0], turn[0] = True, np.eye(3)
        yield left[rigid], vertices @ linear[0].T, np.concatenate([turn, at[..., None]], axis=2)[rigid]
        left = left[~rigid]
