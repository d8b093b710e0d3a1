"""The keys of a captured hand, or of a character's, as arrays, and back, in bulk.

Each bone keeps its own frames. Rotations are quaternions (w, x, y, z) relative to the bone's rest, locations
lie along the first bone's own axes, just as `Rig.to_bones` makes them. Frames are scene frames. Bones that
the artist switched to Euler angles or axis-angle are read and written in their own mode. Only the action
(and slot) that the armature uses now is touched, or another one's channels where they are named as `holder`.
Below a layer of changes (scene/layer.py) the motion is read.

An action that another object uses too is copied before anything is written to it. Where a bone is missing
all of these raise HandModelError, and writers raise OptionError where a channel is locked; nothing has
been changed then.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import bpy
import numpy as np
from mathutils import Euler, Quaternion

from handfit_core.common.errors import OptionError
from handfit_core.common.skeleton import NUM_JOINTS
from handfit_core.geometry.rotations import channels_to_quat, unflip_quats
from handfit_core.hand_model import ShapedHand
from handfit_core.hand_model.axes import RestPose
from handfit_core.hand_model.motion import HandMotion

from ..common.blender_versions import assign_action, channels, first_slot
from ..rigs.rig import PosedBones, Rig, bone_path
from .actions import channels_of, curves_in, own_action, strip_below

SAME_FRAME = 0.01
"""Scene frames within which two keys count as one, as for Blender itself"""


@dataclass(frozen=True, eq=False)
class PoseKeys:
    """The keys of a rig's B bones (16 of a captured hand): N frames on which at least one has a key."""

    frames: np.ndarray
    """(N,) scene frames, increasing"""
    quats: np.ndarray
    """(N, B, 4) w, x, y, z relative to the bones' rest; between a bone's own keys: the curves' values"""
    locations: np.ndarray
    """(N, 3) along the first bone's axes; of a captured hand in metres"""
    rotation_keyed: np.ndarray
    """(N, B) bool: true where the bone's rotation has a key"""
    location_keyed: np.ndarray
    """(N,) bool: true where the first bone's location has a key"""

    @classmethod
    def everywhere(
        cls, frames: np.ndarray, quats: np.ndarray, locations: np.ndarray | None = None
    ) -> PoseKeys:
        """Return keys for all bones, and for the first one's location where it is given, on every frame."""
        count = len(frames)
        return cls(
            np.asarray(frames, dtype=np.float64),
            quats,
            np.zeros((count, 3)) if locations is None else locations,
            np.ones(np.shape(quats)[:2], dtype=bool),
            np.full(count, locations is not None),
        )

    def only(self, rotations: np.ndarray | bool, locations: np.ndarray | bool) -> PoseKeys:
        """Return the rotation keys and the location keys that these masks let through: any that broadcast to
        (N, B) and to (N,)."""
        rotated, located = self.rotation_keyed & rotations, self.location_keyed & locations
        return replace(self, rotation_keyed=rotated, location_keyed=located)

    @property
    def channels(self) -> dict[str, Any]:
        """Return the joints, and the location, that have keys, as arguments of `check_unlocked` and
        `remove_pose_keys`."""
        joints = np.flatnonzero(self.rotation_keyed.any(axis=0)).tolist()
        return {"joints": joints, "location": bool(self.location_keyed.any())}

    def keyed_at(self, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return which rotations (M, B), and whether the location (M,), have keys on frames (M,), as bool."""
        there = np.abs(frames[:, None] - self.frames) <= SAME_FRAME
        return there @ self.rotation_keyed, there @ self.location_keyed

    def turned(self, old: RestPose, new: RestPose, plane: float = 0.0) -> PoseKeys:
        """Return these keys for bones with another rest pose; for a hand of the other side mirrored at
        `plane` (see `RestPose.moved_to`)."""
        return replace(
            self, quats=old.turned_to(new, self.quats), locations=old.moved_to(new, self.locations, plane)
        )


def read_pose_keys(
    rig: PosedBones, first: float = -np.inf, last: float = np.inf, *, holder: Any = None
) -> PoseKeys:
    """Return all keys of the bones from scene frame `first` to `last`, both included."""
    curves = _Curves(rig, holder)
    own = [frames_of(curves.rotation(bone)) for bone in curves.bones]
    placed = frames_of(curves.location(curves.bones[0]))
    frames = union([*own, placed])
    frames = frames[(frames >= first - SAME_FRAME) & (frames <= last + SAME_FRAME)]
    quats, locations = pose_at(rig, frames, holder=holder)
    keyed = np.stack([_contains(mine, frames) for mine in own], axis=-1)
    return PoseKeys(frames, quats, locations, keyed, _contains(placed, frames))


def pose_at(rig: PosedBones, frames: np.ndarray, *, holder: Any = None) -> tuple[np.ndarray, np.ndarray]:
    """Return the pose that the keys say on any scene frames (N,): quaternions (N, B, 4) as (w, x, y, z) and
    the first bone's locations (N, 3).

    Where something has no curve its present value counts. Constraints, drivers and the NLA are not asked."""
    values, locations = channel_values(rig, frames, holder=holder)
    modes = [rig.armature.pose.bones[name].rotation_mode for name in rig.bones]
    quats = [channels_to_quat(*one) for one in zip(values, modes, strict=True)]
    return unflip_quats(np.stack(quats, axis=1)), locations


def channel_values(
    rig: PosedBones, frames: np.ndarray, *, holder: Any = None
) -> tuple[list[np.ndarray], np.ndarray]:
    """Return the values of the bones' own channels on any scene frames (N,): (N, 3 or 4) per bone in its
    rotation mode, and the first bone's locations (N, 3).

    Where something has no curve its present value counts."""
    curves = _Curves(rig, holder)
    frames = np.asarray(frames, dtype=np.float64)
    values = [
        _values_at(curves.rotation(bone), getattr(bone, rotation_path(bone)), frames) for bone in curves.bones
    ]
    first = curves.bones[0]
    return values, _values_at(curves.location(first), first.location, frames)


def write_pose_keys(rig: PosedBones, keys: PoseKeys, *, holder: Any = None) -> None:
    """Write the rows that `keys` marks as keyed: keys that lie there get the new value, others are inserted.

    All other keys stay as they are. A key that exists keeps its interpolation, and its handles move with
    it; a new one takes the interpolation of the key before it (the first: straight lines). An action and
    curves are made where they are missing. Quaternions get the sign that is nearest to the key before.
    """
    if holder is None:
        rig.check()
        rig.allow(keys.quats)
        own_action(rig.armature)
        check_unlocked(rig, **keys.channels)
    curves = _Curves(rig, holder, make=True)
    for joint in keys.channels["joints"]:
        rows, bone = keys.rotation_keyed[:, joint], curves.bones[joint]
        parts, frames = curves.rotation(bone), keys.frames[rows]
        values = _from_quats(keys.quats[rows, joint], bone, parts, frames)
        for part, own in zip(parts, values, strict=True):
            _write(part, frames, own)
    if keys.channels["location"]:
        rows = keys.location_keyed
        for part, values in zip(curves.location(curves.bones[0]), keys.locations[rows].T, strict=True):
            _write(part, keys.frames[rows], values)
    curves.tag()


def writing_pose_keys(
    find: Callable[[], PosedBones], keys: PoseKeys, *, holder: Any = None
) -> Iterator[float]:
    """Write keys as `write_pose_keys` does, a bone per step, for a window that stays free; yields how much is
    done, 0..1. `find` gives the bones, and raises where they have gone between two steps."""
    joints = np.flatnonzero(keys.rotation_keyed.any(axis=0))
    if not len(joints) and keys.location_keyed.any():
        joints = np.zeros(1, dtype=int)
    for done, joint in enumerate(joints, start=1):
        chosen = np.arange(keys.rotation_keyed.shape[1]) == joint
        write_pose_keys(find(), keys.only(chosen, joint == joints[0]), holder=holder)
        yield done / len(joints)


def remove_pose_keys(
    rig: PosedBones,
    first: float,
    last: float,
    *,
    joints: list[int] | None = None,
    location: bool = True,
    holder: Any = None,
) -> None:
    """Take away the rotation keys of `joints` (None: all), and the first bone's location keys, from frame
    `first` to `last`, both included; of the present action, or of what `holder` holds."""
    if holder is None:
        check_unlocked(rig, joints=joints, location=location)
        own_action(rig.armature)
    curves = _Curves(rig, holder)
    for _, curve in curves.there(joints, location):
        data = _read(curve, _EVERYTHING)
        keep = (data["co"][:, 0] < first - SAME_FRAME) | (data["co"][:, 0] > last + SAME_FRAME)
        if not keep.all():
            _rebuild(curve, {name: values[keep] for name, values in data.items()})
    curves.tag()


def replace_keys(
    rig: PosedBones,
    joint: int | None,
    frames: np.ndarray,
    values: np.ndarray,
    before: np.ndarray,
    behind: np.ndarray,
    *,
    holder: Any = None,
) -> None:
    """Give the rotation of one bone (None: the first bone's location) these Bezier keys and no others.

    `frames` (K,); `values` (K, C) in the bone's own rotation mode; where the handles before and behind each
    key lie, (K, C, 2) frame and value. The two handles of a key are aligned.
    """
    curves = _Curves(rig, holder, make=True)
    kind = curves.location if joint is None else curves.rotation
    kinds = {"interpolation": "BEZIER", "handle_left_type": "ALIGNED", "handle_right_type": "ALIGNED"}
    for i, curve in enumerate(kind(curves.bones[joint or 0])):
        data = _plain(frames, values[:, i], kinds)
        _rebuild(curve, data | {"handle_left": before[:, i], "handle_right": behind[:, i]})
    curves.tag()


def level_handles(rig: PosedBones, joints: list[int], first: float, last: float) -> None:
    """Have the rotation curves of these bones not swing beyond their keys from frame `first` to `last`."""
    curves = _Curves(rig)
    level = _kind("handle_left_type", "AUTO_CLAMPED")
    for _, curve in curves.there(joints, location=False):
        data = _read(curve, ("co", "handle_left_type", "handle_right_type"))
        at = np.abs(data["co"][:, 0] - np.clip(data["co"][:, 0], first, last)) <= SAME_FRAME
        for name in ("handle_left_type", "handle_right_type"):
            data[name][at] = level
        _rebuild(curve, data)
    curves.tag()


def frames_between(keyed: np.ndarray) -> np.ndarray:
    """Return the frames of keys (N,), increasing, together with the whole frames in the gaps between them."""
    if len(keyed) < 2:
        return keyed
    between = np.arange(np.ceil(keyed[0]), np.floor(keyed[-1]) + 1.0)
    gaps = np.diff(keyed)[np.clip(np.searchsorted(keyed, between, side="right") - 1, 0, len(keyed) - 2)]
    return np.union1d(keyed, between[gaps > 1.0 + SAME_FRAME])


def align_signs(rig: PosedBones) -> None:
    """Turn the sign of quaternion keys where the curve would else take the long way round to the next one.

    q and -q are the same rotation, so no pose changes.
    """
    own_action(rig.armature)
    curves = _Curves(rig)
    for bone in curves.bones:
        parts = curves.rotation(bone)
        if bone.rotation_mode != "QUATERNION" or any(c is None for c in parts):
            continue
        data = [_read(c, _PLACES) for c in parts]
        frames = data[0]["co"][:, 0]
        if any(
            d["co"].shape != data[0]["co"].shape or not np.allclose(d["co"][:, 0], frames) for d in data[1:]
        ):
            continue
        quats = np.stack([d["co"][:, 1] for d in data], axis=-1).astype(np.float64)
        flipped = np.sum(unflip_quats(quats) * quats, axis=-1) < 0
        if not flipped.any():
            continue
        for curve, part in zip(parts, data, strict=True):
            for place in ("co", "handle_left", "handle_right"):
                part[place][flipped, 1] *= -1.0
                curve.keyframe_points.foreach_set(place, part[place].ravel())
            curve.update()
    curves.tag()


def set_pose(rig: PosedBones, quats: np.ndarray, location: np.ndarray | None = None) -> None:
    """Put the bones into a pose without keys: quats (B, 4), location (3,) of the first one.

    Bones whose quaternion is NaN stay as they are.
    """
    rig.check()
    rig.allow(np.asarray(quats)[None])
    for name, quat in zip(rig.bones, quats, strict=True):
        if np.isnan(quat).any():
            continue
        bone = rig.armature.pose.bones[name]
        if bone.rotation_mode == "QUATERNION":
            bone.rotation_quaternion = quat
        elif bone.rotation_mode == "AXIS_ANGLE":
            axis, angle = Quaternion(quat).to_axis_angle()
            bone.rotation_axis_angle = (angle, *axis)
        else:
            bone.rotation_euler = Quaternion(quat).to_euler(bone.rotation_mode, bone.rotation_euler)
    if location is not None:
        rig.armature.pose.bones[rig.bones[0]].location = location


def is_smooth(rig: PosedBones, *, holder: Any = None) -> bool:
    """True if any of the bones' keys lead to the next one by a Bezier curve."""
    curves = _Curves(rig, holder).there()
    kinds = [_read(curve, ("interpolation",))["interpolation"] for _, curve in curves]
    return bool(np.any(np.concatenate([[], *kinds]) == _kind("interpolation", "BEZIER")))


def displayed_pose(rig: PosedBones) -> np.ndarray:
    """Return the rotations (B, 4) that the bones have now, keyed or not, as quaternions (w, x, y, z)."""
    return np.array([bone.matrix_basis.to_quaternion() for bone in _Curves(rig).bones])


def check_unlocked(rig: PosedBones, *, joints: list[int] | None = None, location: bool = True) -> None:
    """Raise OptionError where a channel of these joints (None: all bones), or of the first one's location, is
    locked."""
    for name, curve in _Curves(rig).there(joints, location):
        if curve.lock or (curve.group is not None and curve.group.lock):
            raise OptionError(
                f"the animation channels of the bone {name} of {rig.armature.name!r} are locked: unlock "
                "them in the Dope Sheet or the Graph Editor"
            )


class _Curves:
    """The curves of a rig's bones in the armature's present action, or in what `holder` holds; `make` makes
    those that are missing. Raises HandModelError where a bone is missing."""

    def __init__(self, rig: PosedBones, holder: Any = None, *, make: bool = False) -> None:
        rig.check()
        self._armature, self._make = rig.armature, make
        self.bones = [rig.armature.pose.bones[name] for name in rig.bones]
        data = rig.armature.animation_data
        action = data.action if data else None
        if holder is None and make:
            holder = assign_action(rig.armature, action or bpy.data.actions.new(rig.armature.name))
        elif holder is None and action is not None:
            holder = channels_of(strip_below(rig.armature) or data)
        self._holder = holder
        self._found = {(c.data_path, c.array_index): c for c in curves_in(holder)}

    def tag(self) -> None:
        """Have Blender look at the keys again: writing them in bulk notifies nobody."""
        if self._holder is not None:
            self._holder.id_data.update_tag()
            self._armature.update_tag(refresh={"TIME"})

    def rotation(self, bone: bpy.types.PoseBone) -> list[Any]:
        """Return the 3 or 4 curves of a bone's rotation in its own mode; None for missing ones."""
        path = rotation_path(bone)
        return self._parts(bone.name, path, 3 if path == "rotation_euler" else 4)

    def location(self, bone: bpy.types.PoseBone) -> list[Any]:
        """Return the three curves of a bone's location; None for missing ones."""
        return self._parts(bone.name, "location", 3)

    def there(self, joints: Sequence[int] | None = None, location: bool = True) -> list[tuple[str, Any]]:
        """Return the existing curves of the rotations of these joints (None: of all bones), and of the first
        bone's location, each after its bone's name."""
        chosen = self.bones if joints is None else [self.bones[joint] for joint in joints]
        parts = [(bone.name, curve) for bone in chosen for curve in self.rotation(bone)]
        if location:
            parts += [(self.bones[0].name, curve) for curve in self.location(self.bones[0])]
        return [(name, curve) for name, curve in parts if curve is not None]

    def _parts(self, bone: str, path: str, count: int) -> list[Any]:
        path = f"{bone_path(bone)}.{path}"
        parts = [self._found.get((path, i)) for i in range(count)]
        if self._make and self._holder is not None and any(part is None for part in parts):
            present = self._armature.path_resolve(path)
            frames = frames_of(parts)
            for i in range(count):
                if parts[i] is not None:
                    continue
                curve = self._holder.fcurves.new(path, index=i)
                curve.group = self._holder.groups.get(bone) or self._holder.groups.new(bone)
                # A part that had no keys beside parts that have some stays what it was on those frames.
                _write(curve, frames, np.full(len(frames), present[i]))
                parts[i] = self._found[path, i] = curve
        return parts


def frames_of(parts: list[Any]) -> np.ndarray:
    """Return the frames on which any of the curves has a key."""
    return union([_read(c, ("co",))["co"][:, 0].astype(np.float64) for c in parts if c is not None])


def union(lists: list[np.ndarray]) -> np.ndarray:
    """Return all frames of the lists, increasing, without those that count as the key before them."""
    frames = np.unique(np.concatenate([np.empty(0), *lists]))
    return frames[np.append(True, np.diff(frames) > SAME_FRAME)[: len(frames)]]


def nearest(frames: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return for each wanted frame the index of the nearest of `frames` (N > 0, increasing), and whether the
    two count as one key."""
    after = np.clip(np.searchsorted(frames, wanted), 0, len(frames) - 1)
    before = np.maximum(after - 1, 0)
    index = np.where(np.abs(frames[before] - wanted) < np.abs(frames[after] - wanted), before, after)
    return index, np.abs(frames[index] - wanted) <= SAME_FRAME


def _contains(frames: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    if len(frames) == 0:
        return np.zeros(len(wanted), dtype=bool)
    return nearest(frames, wanted)[1]


def _values_at(parts: list[Any], present: Any, frames: np.ndarray) -> np.ndarray:
    """Return the values of the curves on each frame, (N, parts); `present` for those that are missing."""
    values = np.empty((len(frames), len(parts)))
    for i, curve in enumerate(parts):
        if curve is None or len(curve.keyframe_points) == 0:
            values[:, i] = present[i]
            continue
        co = _read(curve, ("co",))["co"].astype(np.float64)
        index, same = nearest(co[:, 0], frames)
        values[:, i] = co[index, 1]
        for row in np.flatnonzero(~same):
            values[row, i] = curve.evaluate(float(frames[row]))
    return values


def rotation_path(bone: bpy.types.PoseBone) -> str:
    """Return the name of the property that holds a bone's rotation in its own mode."""
    other = {"QUATERNION": "rotation_quaternion", "AXIS_ANGLE": "rotation_axis_angle"}
    return other.get(bone.rotation_mode, "rotation_euler")


def _from_quats(
    quats: np.ndarray, bone: bpy.types.PoseBone, parts: list[Any], frames: np.ndarray
) -> np.ndarray:
    """Return quaternions (N, 4) as values (parts, N) in the bone's rotation mode, near those of the key
    before."""
    earlier = frames[0] - 1.0 if len(frames) else 0.0
    co = _read(parts[0], ("co",))["co"]
    before = co[co[:, 0] < frames[0] - SAME_FRAME, 0]
    if len(before):
        earlier = float(before[-1])
    start = _values_at(parts, getattr(bone, rotation_path(bone)), np.array([earlier]))
    if bone.rotation_mode == "QUATERNION":
        turned = unflip_quats(np.concatenate([start, quats]))[1:]
        # Keys that lie far apart may be more than half a turn from each other: the sign of one that exists
        # stays if it turns much the same way, and so does that of what is keyed as the curve has it already.
        there = _values_at(parts, getattr(bone, rotation_path(bone)), frames)
        alike = np.sum(turned * there, axis=-1) / np.maximum(np.linalg.norm(there, axis=-1), 1e-9)
        same = _contains(co[:, 0].astype(np.float64), frames)
        known = np.abs(alike) > np.where(same, 0.7, 1.0 - 1e-6)
        among = (frames > co[:, 0].min(initial=np.inf) - SAME_FRAME) & (
            frames < co[:, 0].max(initial=-np.inf) + SAME_FRAME
        )
        known &= among
        last = np.maximum.accumulate(np.where(known, np.arange(len(frames)), -1))
        sign = np.where((last >= 0) & (alike[last] < 0.0), -1.0, 1.0)
        # Between keys, curves are of length one only nearly: what is to stay is not made so.
        turned *= sign[:, None]
        length = np.linalg.norm(there, axis=-1, keepdims=True)
        stays = among & (np.linalg.norm(turned * length - there, axis=-1) < 1e-6)
        return np.where(stays[:, None], there, turned).T
    if bone.rotation_mode == "AXIS_ANGLE":
        turned = [Quaternion(q).to_axis_angle() for q in quats.tolist()]
        return np.array([(angle, *axis) for axis, angle in turned]).T
    euler = Euler(start[0].tolist(), bone.rotation_mode)
    values = []
    for quat in quats.tolist():
        euler = Quaternion(quat).to_euler(bone.rotation_mode, euler)
        values.append(tuple(euler))
    return np.array(values).T


_PLACES = ("co", "handle_left", "handle_right")
_KINDS = ("interpolation", "handle_left_type", "handle_right_type", "easing", "type")
_AMOUNTS = ("amplitude", "back", "period")
_SELECTED = ("select_control_point", "select_left_handle", "select_right_handle")
_EVERYTHING = _PLACES + _KINDS + _AMOUNTS + _SELECTED


def new_curve(
    holder: Any, bone: str, attribute: str, index: int, frames: np.ndarray, values: np.ndarray
) -> None:
    """Make a new curve of a bone, in its group, or, without a name, of the object: straight lines between
    keys (N,)."""
    curve = holder.fcurves.new(f"{bone_path(bone)}.{attribute}" if bone else attribute, index=index)
    if bone:
        curve.group = holder.groups.get(bone) or holder.groups.new(bone)
    # Sensible handles, for users who switch a curve to Bezier.
    data, kept = _plain(frames, values), ("co", "interpolation", "handle_left_type", "handle_right_type")
    _rebuild(curve, {name: data[name] for name in kept})


def _read(curve: Any, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Return attributes of the curve's key points as arrays: places (N, 2), others (N,)."""
    points = curve.keyframe_points
    count = len(points)
    data = {}
    for name in names:
        kind = bool if name in _SELECTED else np.int32 if name in _KINDS else np.float32
        data[name] = np.empty((count, 2) if name in _PLACES else count, dtype=kind)
        points.foreach_get(name, data[name].ravel())
    return data


def change_places(curve: Any, scale: Sequence[float], shift: Sequence[float]) -> None:
    """Scale, then shift, where keys and their handles lie: frame and value."""
    scaled, shifted = np.array(scale, dtype=np.float32), np.array(shift, dtype=np.float32)
    _rebuild(curve, {name: places * scaled + shifted for name, places in _read(curve, _PLACES).items()})


def _rebuild(curve: Any, data: dict[str, np.ndarray]) -> None:
    """Give the curve exactly these key points."""
    points = curve.keyframe_points
    count = len(data["co"])
    if count < len(points):
        points.clear()
    if count > len(points):
        points.add(count - len(points))
    for name, values in data.items():
        kind = np.float32 if name in _PLACES else values.dtype
        points.foreach_set(name, np.ascontiguousarray(values, dtype=kind).ravel())
    curve.update()


def _write(curve: Any, frames: np.ndarray, values: np.ndarray) -> None:
    """Set the curve's value on `frames`: change the keys that lie there, insert the others."""
    if len(frames) == 0:
        return
    data = _read(curve, _PLACES)
    old = data["co"][:, 0].astype(np.float64)
    index, same = np.zeros(len(frames), dtype=int), np.zeros(len(frames), dtype=bool)
    if len(old):
        index, same = nearest(old, frames)
    if not same.all():  # where only values change, the rest of a key need not be read and written
        data |= _read(curve, tuple(name for name in _EVERYTHING if name not in _PLACES))
    rise = np.zeros(len(old), dtype=np.float32)
    rise[index[same]] = values[same] - data["co"][index[same], 1]
    for name in _PLACES:
        data[name][:, 1] += rise
    data["co"][index[same], 1] = values[same]  # exactly, whatever the sum was rounded to
    if same.all():
        _rebuild(curve, data)
        return
    frames, values = frames[~same], values[~same]
    leads = _leads(data, frames)
    _rebuild(curve, _inserted(data, frames[~leads], values[~leads]))
    for frame, value in zip(frames[leads].tolist(), values[leads].tolist(), strict=True):
        # Blender has the curve run through the new key as before; what the key is moved by, its handles are.
        key = curve.keyframe_points.insert(frame, value, options={"FAST"})
        key.interpolation = "BEZIER"
        key.handle_left_type = key.handle_right_type = "ALIGNED"
    if leads.any():
        curve.update()


def _inserted(data: dict[str, np.ndarray], frames: np.ndarray, values: np.ndarray) -> dict[str, np.ndarray]:
    """Return the key points with new ones between the old, each like the one before it in how it leads to the
    next."""
    old = data["co"][:, 0].astype(np.float64)
    before = np.maximum(np.searchsorted(old, frames) - 1, 0)
    new = _plain(frames, values)
    for name in ("interpolation", "easing", *_AMOUNTS):
        if len(old):
            new[name] = data[name][before]
    order = np.argsort(np.concatenate([old, frames]), kind="stable")
    return {name: np.concatenate([data[name], new[name].astype(data[name].dtype)])[order] for name in data}


def _leads(data: dict[str, np.ndarray], frames: np.ndarray) -> np.ndarray:
    """Return (N,) bool: the frames between two keys that a Bezier curve with handles of its own joins."""
    free = [_kind("handle_left_type", kind) for kind in ("FREE", "ALIGNED")]
    leads = data["interpolation"][:-1] == _kind("interpolation", "BEZIER")
    leads &= np.isin(data["handle_right_type"][:-1], free) & np.isin(data["handle_left_type"][1:], free)
    leads = np.concatenate([[False], leads, [False]])
    return leads[np.searchsorted(data["co"][:, 0].astype(np.float64), frames)]


def _plain(
    frames: np.ndarray, values: np.ndarray, kinds: Mapping[str, str] = MappingProxyType({})
) -> dict[str, np.ndarray]:
    """Return key points as Blender makes them, but with straight lines between; or of these `kinds`."""
    chosen = {
        "interpolation": "LINEAR",
        "handle_left_type": "AUTO_CLAMPED",
        "handle_right_type": "AUTO_CLAMPED",
        "easing": "AUTO",
        "type": "KEYFRAME",
        **kinds,
    }
    count = len(frames)
    return {
        "co": np.stack([frames, values], axis=-1),
        # Blender puts automatic handles where they belong.
        "handle_left": np.stack([frames - 1 / 3, values], axis=-1),
        "handle_right": np.stack([frames + 1 / 3, values], axis=-1),
        **{name: np.full(count, _kind(name, kind), dtype=np.int32) for name, kind in chosen.items()},
        **{name: np.zeros(count, dtype=np.float32) for name in _AMOUNTS},
        **{name: np.zeros(count, dtype=bool) for name in _SELECTED},
    }


def _kind(name: str, kind: str) -> int:
    """Return the number by which Blender knows a value of a key point's enumerated property."""
    return bpy.types.Keyframe.bl_rna.properties[name].enum_items[kind].value


def table_text(table: np.ndarray) -> str:
    """Return a table (N, C) as text for a property: base64 of little-endian float32."""
    return base64.b64encode(table.astype("<f4").tobytes()).decode("ascii")


def read_table(text: str, columns: int) -> np.ndarray:
    """Return the table (N, `columns`) that `table_text` made a text of. Raises ValueError."""
    return np.frombuffer(base64.b64decode(text, validate=True), "<f4").reshape(-1, columns).astype(np.float64)


CURVES = NUM_JOINTS * 4 + 3
"""How many curves the action of a hand has"""

_CHUNK = 250
"""How many frames are computed at once, in some milliseconds"""


def computing_keys(
    motion: HandMotion, shaped: ShapedHand, rest: RestPose, frames: np.ndarray
) -> Generator[int, None, PoseKeys]:
    """Compute a hand's keys, some frames at a time: yields how many, returns the keys.

    `rest` is how the rig's bones lie at rest, `frames` (T,) where the motion lies in the scene. Frames
    without a hand get no keys; filled ones do.
    """
    rows = np.flatnonzero(motion.present)
    quats, locations = np.empty((len(rows), NUM_JOINTS, 4)), np.empty((len(rows), 3))
    for start in range(0, len(rows), _CHUNK):
        some = slice(start, start + _CHUNK)
        quats[some], locations[some] = rest.to_bones(shaped, *(values[rows[some]] for values in motion.pose))
        # The sign goes on from that of the frames before.
        signed = slice(max(start - 1, 0), start + _CHUNK)
        quats[signed] = unflip_quats(quats[signed])
        yield len(quats[some])
    return PoseKeys.everywhere(frames[rows], quats, locations)


def animating(rig: Rig, keys: PoseKeys) -> Iterator[bpy.types.Action]:
    """Key a new action on the armature, a curve at a time. Yields the action each time.

    Straight lines join the keys: measured frames stay exactly as measured, and nothing overshoots in
    the gaps, as Bezier curves through noisy per-frame data would.
    """
    action = bpy.data.actions.new(rig.armature.name)
    assign_action(rig.armature, action)
    yield action
    parts = [(name, "rotation_quaternion", keys.quats[:, joint]) for joint, name in enumerate(rig.bones)]
    for bone, attribute, values in (*parts, (rig.bones[0], "location", keys.locations)):
        for index in range(values.shape[1]):
            # Asked for each curve: an undo may have moved what holds them.
            holder = channels(action, first_slot(action))
            new_curve(holder, bone, attribute, index, keys.frames, values[:, index])
            yield action
