"""Where to work so that the user's scene is neither seen nor changed: a scene of its own, in Object mode."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator

import bpy
import numpy as np


@contextlib.contextmanager
def object_mode() -> Iterator[None]:
    """Leave edit, sculpt and paint modes, whose data is not in the object yet and would be written over what
    is; go back there afterwards. Pose mode may stay."""
    active = bpy.context.view_layer.objects.active
    mode = active.mode if active is not None else "OBJECT"
    if mode in ("OBJECT", "POSE"):
        yield
        return
    bpy.ops.object.mode_set(mode="OBJECT")
    try:
        yield
    finally:
        bpy.ops.object.mode_set(mode=mode)


@contextlib.contextmanager
def own_scene(name: str) -> Iterator[bpy.types.Scene]:
    """Open a new, empty scene; afterwards remove it and open the user's again, on its frame, with every view
    and every pose as it was, also where a pose has no keys yet.

    It has to be the open one: exporters write what is open (glTF's opens the scene that it writes), and
    movies and image sequences follow the open scene's frame even while another scene is rendered.
    """
    window = bpy.context.window
    before = window.scene
    frame, subframe = before.frame_current, before.frame_subframe
    scene = bpy.data.scenes.new(name)
    with _transforms_kept():
        try:
            with _windows_kept(window):
                window.scene = scene
                yield scene
        finally:
            bpy.data.scenes.remove(scene)
            before.frame_set(frame, subframe=subframe)


@contextlib.contextmanager
def _windows_kept(window: bpy.types.Window) -> Iterator[None]:
    """Whatever scene the window shows meanwhile, it and the windows that follow it look as before.

    A view that finds no camera in the new scene stops looking through it, and a window that does not find
    its view layer there takes another.
    """
    main = window.parent or window
    windows = [w for w in bpy.context.window_manager.windows if main in (w, w.parent)]
    scene, camera = window.scene, window.scene.camera
    layers = [(w, w.view_layer) for w in windows]
    spaces = [
        space for w in windows for area in w.screen.areas for space in area.spaces if space.type == "VIEW_3D"
    ]
    cameras = [(space, space.camera) for space in spaces]
    views = [
        (view, view.view_perspective)
        for space in spaces
        for view in (space.region_3d, *space.region_quadviews)
        if view is not None
    ]
    try:
        yield
    finally:
        window.scene = scene
        for each, layer in layers:
            if each.view_layer != layer:
                each.view_layer = layer
        for space, own in cameras:
            if space.camera != own:
                space.camera = own
        if scene.camera != camera:  # a view that is locked to the scene's camera has passed its own on
            scene.camera = camera
        for view, perspective in views:
            if view.view_perspective != perspective:
                view.view_perspective = perspective


@contextlib.contextmanager
def unseen_scene(name: str) -> Iterator[bpy.types.Scene]:
    """Make a new, empty scene that no window opens, and remove it afterwards.

    `sampling.sample` evaluates objects in it, of which Blender writes nothing back to them. There is nothing
    to restore as in `own_scene`, and no editor changes its region, tool or render engine below an operator.
    """
    scene = bpy.data.scenes.new(name)
    try:
        yield scene
    finally:
        bpy.data.scenes.remove(scene)


_TRANSFORMS = {
    "location": 3,
    "rotation_quaternion": 4,
    "rotation_euler": 3,
    "rotation_axis_angle": 4,
    "scale": 3,
}
"""Properties of objects and of pose bones, and how many numbers each has"""


@contextlib.contextmanager
def _transforms_kept() -> Iterator[None]:
    """Animated objects and bones stand afterwards as they stood, whatever frames were shown in between: what
    the artist moved and did not key yet would be lost with the first frame."""
    before = [(obj, _transforms(obj)) for obj in bpy.data.objects if obj.animation_data is not None]
    try:
        yield
    finally:
        for obj, kept in before:
            if _set_transforms(obj, kept):
                obj.update_tag(refresh={"OBJECT", "DATA"})


def _transforms(obj: bpy.types.Object) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """For each property the object's own numbers (n,), and those of its bones one after the other."""
    bones = obj.pose.bones if obj.pose is not None else None
    found = {}
    for name, count in _TRANSFORMS.items():
        posed = np.empty(len(bones) * count if bones is not None else 0, dtype=np.float32)
        if bones is not None:
            bones.foreach_get(name, posed)
        found[name] = (np.array(getattr(obj, name), dtype=np.float32), posed)
    return found


def _set_transforms(obj: bpy.types.Object, kept: dict[str, tuple[np.ndarray, np.ndarray]]) -> bool:
    """Set what differs from `kept`, as `_transforms` gave it; whether anything did."""
    changed = False
    for name, (own, posed) in _transforms(obj).items():
        kept_own, kept_posed = kept[name]
        if not np.array_equal(own, kept_own):
            setattr(obj, name, kept_own)
            changed = True
        if not np.array_equal(posed, kept_posed):
            obj.pose.bones.foreach_set(name, kept_posed)
            changed = True
    return changed


@contextlib.contextmanager
def shown_in_pose(objects: Iterable[bpy.types.Object | None]) -> Iterator[None]:
    """Objects that the artist hid, and armatures left in Rest Position, are shown as they move meanwhile.

    Blender evaluates nothing that is hidden: it would be read as it stood when it was hidden.
    """
    wanted: list[tuple[bpy.types.ID, str, object]] = []
    for obj in objects:
        if obj is None:
            continue
        wanted += [(obj, "hide_viewport", False), (obj, "hide_render", False)]
        if obj.type == "ARMATURE":
            wanted.append((obj.data, "pose_position", "POSE"))
    changed = []
    try:
        for block, name, value in wanted:
            before = getattr(block, name)
            if before != value:
                setattr(block, name, value)
                changed.append((block, name, before))
        yield
    finally:
        for block, name, before in changed:
            setattr(block, name, before)
