"""Grip: lay the fingers on an object that the hand holds, over a range of frames."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import bpy
import numpy as np

from handfit_core.common.arrays import packed
from handfit_core.common.errors import HandfitError, OptionError
from handfit_core.common.skeleton import FINGERS
from handfit_core.edit import Prop
from handfit_core.hand_model.axes import WORLD_FROM_CAMERA

from ..common.wording import capitalised, counted
from ..scene.corrections import correct_frames
from ..scene.own_scene import object_mode
from ..scene.sampling import stepped
from ..session.refiner import Refiner
from .base import polled_hand
from .refit_range import RangeFit, RangeFitOperator

_RIGID = 1e-5
"""How far a matrix may be from a rotation"""
_MOVED = 1e-6
"""By how much a pose's numbers differ where fingers were laid on the prop"""


class MANIENT_OT_grip(RangeFitOperator, bpy.types.Operator):
    """Lay the fingers that are near an object on its surface, over a range of frames. Other fingers stay, and
    so does the wrist, unless the palm is inside the object; before and after it fades out over Spread. Asks
    for the object and the range first."""

    bl_label = "Grip"
    progress_text = "Laying fingers on the object"

    prop: bpy.props.StringProperty(name="Object", description="What the hand holds")  # type: ignore
    fingers: bpy.props.BoolVectorProperty(  # type: ignore
        name="Fingers", description="Which fingers may be laid on it", size=5, default=(True,) * 5
    )

    def suggest(self, context):
        """The selected mesh beside the hand, and the frames that Re-fit Range suggests."""
        super().suggest(context)
        own = polled_hand(context)
        others = [o for o in context.selected_objects if o.type == "MESH" and o not in own.meshes]
        if others and not self.prop:
            self.prop = others[0].name

    def draw_properties(self):
        self.layout.prop_search(self, "prop", bpy.context.scene, "objects", text="")
        row = self.layout.row(align=True)
        for index, finger in enumerate(FINGERS):
            row.prop(self, "fingers", index=index, text=finger.capitalize(), toggle=True)

    def summary(self, context):
        try:
            prop = _prop_named(context, self.prop)
            count = len(self.rows(context, Refiner(polled_hand(context).armature)))
        except HandfitError as error:
            return capitalised(str(error)), True
        return f"Lays fingers within 2 cm of {prop.name!r} on it, in {counted(count, 'frame')}", False

    def make_fit(self, context):
        return _GripFit(self, context)

    def other_properties(self) -> dict[str, Any]:
        return {"prop": self.prop, "fingers": tuple(self.fingers)}

    def report_text(self, fit):
        return "INFO", f"Fingers lie on {self.prop!r} in {counted(fit.fitted, 'frame')}"


def _prop_named(context: bpy.types.Context, name: str) -> bpy.types.Object:
    """The object that the hand may hold. Raises OptionError."""
    prop, hand = context.scene.objects.get(name), polled_hand(context)
    if prop is None:
        raise OptionError("choose an object of this scene for the hand to hold")
    if prop.type not in ("MESH", "CURVE", "SURFACE", "FONT", "META"):
        raise OptionError(f"{name!r} has no surface: choose a mesh")
    if prop in hand.meshes:
        raise OptionError(f"{name!r} is the hand itself: choose what it holds")
    if not prop.visible_get():
        raise OptionError(f"{name!r} is hidden: show it, then grip again")
    return prop


class _GripFit(RangeFit):
    """The frames of a range, whose fingers are laid on an object."""

    def __init__(self, operator: MANIENT_OT_grip, context: bpy.types.Context) -> None:
        super().__init__(operator, context)
        prop = _prop_named(context, operator.prop)
        self._name, fingers = prop.name, np.array(operator.fingers)
        rows, refiner = self.rows.tolist(), self.refiner
        self._start = refiner.keyed_poses(rows)
        self.requests = [
            (len(part), self._request(part, held)) for part, held in self._held(context, prop, fingers)
        ]

    def _request(self, part: np.ndarray, held: Prop) -> Any:
        rows, start = self.rows[part].tolist(), self._start.select(part)
        hand = self.refiner.request(rows, [{} for _ in rows], start, mode="grip", touches=[{} for _ in rows])
        return lambda: hand() | {"prop": packed(held)}

    def _held(
        self, context: bpy.types.Context, prop: bpy.types.Object, fingers: np.ndarray
    ) -> Iterator[tuple[np.ndarray, Prop]]:
        """Frames in which the object only moves, by their indices, and what it is in them."""
        scene, armature = context.scene, self.refiner.armature
        frame, subframe = scene.frame_current, scene.frame_subframe
        rest = self.refiner.hand.rig.rest
        shapes, places = [], []
        with object_mode():
            for graph in stepped(scene, self.refiner.scene_frames()[self.rows]):
                shown = prop.evaluated_get(graph)
                to_rest = np.linalg.inv(np.array(armature.evaluated_get(graph).matrix_world))
                place = to_rest @ np.array(shown.matrix_world)
                place[:3, 3] += rest.origin
                places.append(WORLD_FROM_CAMERA.T @ place[:3])
                shapes.append(_faces(shown))
        scene.frame_set(frame, subframe=subframe)
        first = 0
        for at in range(1, len(places) + 1):
            if at < len(places) and all(map(np.array_equal, shapes[at], shapes[first])):
                continue
            for part, vertices, placed in _rigid_parts(shapes[first][0], np.array(places[first:at])):
                yield first + part, Prop(vertices, shapes[first][1], placed, fingers)
            first = at

    def received(self, poses):
        changed = np.abs(poses.quats - self._start.quats).max(axis=(1, 2)) > _MOVED
        changed |= np.abs(poses.locations - self._start.locations).max(axis=1) > _MOVED
        if not changed.any():
            raise OptionError(f"no finger comes near {self._name!r} in this range: nothing was changed")
        poses.quats[~changed] = poses.locations[~changed] = np.nan
        super().received(poses)

    def writing(self):
        there, poses = self.poses.present, self.poses
        frames = [self.refiner.source_frame(row) for row in self.rows[there]]
        correct_frames(
            self.refiner.armature, frames, poses.quats[there], poses.locations[there], self.spread, posed=True
        )
        yield 1.0


def _faces(shown: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) and triangles (F, 3) of an evaluated object, in its own units."""
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
    """Frames between which places (N, 3, 4) turn and move vertices (V, 3), but do not scale them: their
    indices, the vertices in metres, and (N, 3, 4) how these are turned and moved."""
    left = np.arange(len(places))
    while len(left):
        linear, at = places[left, :, :3], places[left, :, 3]
        turn = linear @ np.linalg.pinv(linear[0])
        rigid = np.abs(turn @ turn.swapaxes(1, 2) - np.eye(3)).max(axis=(1, 2)) < _RIGID
        rigid[0], turn[0] = True, np.eye(3)
        yield left[rigid], vertices @ linear[0].T, np.concatenate([turn, at[..., None]], axis=2)[rigid]
        left = left[~rigid]
