"""Controls of a captured hand: bones to animate it with by hand, on top of its keys.

A finger's control turns about its X to curl the finger, each joint about its own X in the proportion in which
fingers close, and about its Z to spread it; the fingers' control does both to all of them. The hand's control
stands where the keys have the wrist and moves the hand from there; constraints that are put on it, such as
Child Of, move the hand too. All of it happens in constraints after the keys, so controls at rest change
nothing, and the keys stay what they are. Limits of the joints come last in each finger bone's constraints.
They are those of anatomy, and reach as far as the keys do.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from math import pi
from typing import Any, Final

import bpy
import numpy as np
from mathutils import Matrix

from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, NUM_JOINTS
from handfit_core.geometry.rotations import quat_to_rotmat
from handfit_core.hand_model.anatomy import JointLimits, anatomical_angles
from handfit_core.hand_model.axes import ANATOMICAL_IN_BONE

from ..common.blender_versions import channels, used_actions
from .arm import TO_ELBOW, TO_WRIST

MARK: Final = "hand_control"
"""Custom property of a control's bone that says what it controls, whatever name the artist gives it"""
CAPTURED: Final = "wrist_captured"
"""The role of the bone that follows the wrist's keys and nothing else: the hand's control stands there while
it rests"""
ROLES: Final = (CAPTURED, "hand", "fingers", *FINGERS)
"""Every bone that belongs to the controls, in the order in which they are made"""
LIMIT: Final = "Joint Limits"
_CONTROL: Final = "Hand Control"
"""The beginning of the names of the controls' constraints"""
_COLLECTIONS: Final = ("Captured Bones", "Hand Controls", "Mechanism")
_BEFORE: Final = "before_controls"
"""Custom property of a bone with what is given back when the controls are removed, as JSON"""
_HAND_COLOR: Final = np.array([1.0, 0.7, 0.15])
_FINGER_COLOR: Final = np.array([0.25, 0.8, 1.0])
_SHAPE: Final = "hand_control_shape"
_QUARTER: Final = pi / 2
_FAN: Final = {"thumb": -1.0, "index": -1.0, "middle": -0.2, "ring": 0.5, "little": 1.2}
"""By finger, how far it spreads, as a share of the turn of the fingers' control; negative to the other
side"""
_TURN: Final = {
    **{"map_from": "ROTATION", "map_to": "ROTATION", "use_motion_extrapolate": True},
    **{"from_rotation_mode": "XYZ", "to_euler_order": "XYZ"},
    **{f"map_to_{axis}_from": axis.upper() for axis in "xyz"},
    **{f"from_min_{axis}_rot": -_QUARTER for axis in "xyz"},
    **{f"from_max_{axis}_rot": _QUARTER for axis in "xyz"},
}
"""Settings of the constraints by which bones are turned as others are"""
_LIMITED: Final = {
    **{"euler_order": "XZY", "use_transform_limit": True},
    **dict.fromkeys(("use_limit_x", "use_limit_y", "use_limit_z"), True),
}
_SHAPES: Final = {
    "finger": (  # a ball on a stem that stands on the back of the finger's first bone
        ((0.0, 0.5, -0.95), (0.13, 0.0, 0.0), (0.0, 0.13, 0.0)),
        ((0.0, 0.5, -0.95), (0.0, 0.13, 0.0), (0.0, 0.0, 0.13)),
        ((0.0, 0.5, -0.95), (0.13, 0.0, 0.0), (0.0, 0.0, 0.13)),
        ((0.0, 0.5, -0.56), (0.0, 0.0, 0.26), (0.0, 0.0, 0.0)),
    ),
    "fingers": (
        ((0.0, 0.7, -0.42), (0.36, 0.0, 0.0), (0.0, 0.12, 0.0)),
        ((0.0, 0.7, -0.42), (0.31, 0.0, 0.0), (0.0, 0.07, 0.0)),
    ),
    "hand": (
        ((0.0, -0.05, 0.0), (0.5, 0.0, 0.0), (0.0, 0.0, 0.42)),
        ((0.0, -0.09, 0.0), (0.5, 0.0, 0.0), (0.0, 0.0, 0.42)),
    ),
}
"""Ellipses, each by its centre and half axes, in lengths of a bone, along its axes: +Y to its tip, -Z out of
the back"""
_RING_POINTS: Final = 32
_PLAY: Final = np.radians(1.0)
"""Radians by which limits reach farther than the keys, for what lies between keys"""
_KNUCKLES: Final = 0.75
"""Where the fingers' control is turned about, as a share of the length of the wrist's bone"""


def control_bones(armature: bpy.types.Object) -> dict[str, str]:
    """Return an armature's controls: the names of their bones by what they control, in the order of `ROLES`;
    empty where it has none."""
    marked = {bone.get(MARK): bone.name for bone in armature.data.bones}
    return {role: marked[role] for role in ROLES if role in marked}


def with_moved(armature: bpy.types.Object, bones: list[str], selected: set[str]) -> set[str]:
    """Return the names of selected bones, and of those of the 16 `bones` that selected controls move."""
    moved = {"hand": [0], "fingers": range(1, NUM_JOINTS), **FINGER_JOINTS}
    chosen = [role for role, name in control_bones(armature).items() if name in selected]
    return selected | {bones[joint] for role in chosen for joint in moved.get(role, ())}


def _joint_of(role: str) -> int:
    """Return the index, in MANO's order, of the joint whose bone a control lies on."""
    return FINGER_JOINTS[role][0] if role in FINGERS else 0


def place_controls(edit_bones: Any, bones: list[str], controls: dict[str, str]) -> None:
    """Lay the controls where the 16 `bones` lie, both in edit mode."""
    for role, name in controls.items():
        model = edit_bones[bones[_joint_of(role)]]
        bone = edit_bones[name]
        offset = (model.tail - model.head) * (_KNUCKLES if role == "fingers" else 0.0)
        bone.head, bone.tail = model.head + offset, model.tail + offset
        bone.roll = model.roll


def make_bones(edit_bones: Any, bones: list[str]) -> dict[str, str]:
    """Make the controls' bones, which do nothing yet; return their names by what they control."""
    suffix = bones[0][-2:]
    made = {role: edit_bones.new(role + suffix) for role in ROLES}
    for role, bone in made.items():
        bone.use_deform = False
        bone.parent = {CAPTURED: None, "hand": made[CAPTURED]}.get(role, edit_bones[bones[0]])
    names = {role: bone.name for role, bone in made.items()}
    place_controls(edit_bones, bones, names)
    return names


def set_up(armature: bpy.types.Object, bones: list[str], names: dict[str, str], limits: JointLimits) -> None:
    """Have the bones that `make_bones` made control the hand, and give them their shapes."""
    pose = armature.pose.bones
    for role, name in names.items():
        armature.data.bones[name][MARK] = role
    free = [name for name in bones[1:] if not any(pose[name].lock_location)]
    before = {"unlocked": free, "display": armature.data.display_type}
    armature.data.bones[names[CAPTURED]][_BEFORE] = json.dumps(before)
    armature.data.display_type = "STICK"  # the controls are to be seen behind the bones
    for name in free:
        pose[name].lock_location = (True,) * 3
    _collect(armature, bones, names)
    _follow_keys(armature, bones[0], names[CAPTURED])
    for role in ROLES[1:]:
        _dress(pose[names[role]], role, pose[bones[_joint_of(role)]])

    def driven(bone: str, role: str, kind: Any, name: str, **settings: Any) -> None:
        source = {"target": armature, "subtarget": names[role], "target_space": "LOCAL"}
        _constraint(pose[bone], kind, name, **source, **settings)

    def turned(bone: str, role: str, name: str, mix: str, **quarter: float) -> None:
        """Have the control of a role turn a bone: its quarter turn about x, y or z turns the bone about the
        same axis by so many radians."""
        ranges = _TURN | {"mix_mode_rot": mix}
        for axis, turn in quarter.items():
            ranges |= {f"to_min_{axis}_rot": -turn, f"to_max_{axis}_rot": turn}
        driven(bone, role, "TRANSFORM", name, **ranges)

    driven(bones[0], "hand", "COPY_TRANSFORMS", _CONTROL, mix_mode="AFTER_FULL")
    for finger, joints in FINGER_JOINTS.items():
        turned(names[finger], "fingers", _CONTROL, "ADD", x=_QUARTER, z=_QUARTER * _FAN[finger])
        turned(bones[joints[0]], finger, f"{_CONTROL} Spread", "BEFORE", z=_QUARTER)
        for joint in joints:
            turned(bones[joint], finger, _CONTROL, "AFTER", x=float(limits.upper[joint - 1, 2]))
    for joint in range(1, NUM_JOINTS):
        limit = _constraint(pose[bones[joint]], "LIMIT_ROTATION", LIMIT, **_LIMITED)
        _limit(limit, limits.lower[joint - 1], limits.upper[joint - 1])


def take_down(armature: bpy.types.Object) -> None:
    """Undo `set_up`. The controls' bones stay, and do nothing any more."""
    pose, names = armature.pose.bones, control_bones(armature)
    for bone, constraint in list(_constraints(armature)):
        bone.constraints.remove(constraint)
    drivers: Any = armature.animation_data.drivers if armature.animation_data is not None else []
    for curve in list(drivers):
        if curve.data_path.startswith(f'pose.bones["{names.get(CAPTURED)}"]'):
            drivers.remove(curve)
    if CAPTURED in names:
        _give_back(armature, armature.data.bones[names[CAPTURED]].get(_BEFORE, ""))
    shapes = {pose[name].custom_shape for name in names.values()} - {None}
    for name in names.values():
        pose[name].custom_shape = None
    for shape in shapes:
        if shape.get(_SHAPE) and shape.users == 0:
            bpy.data.meshes.remove(shape.data)  # and with it the object
    for name in _COLLECTIONS:
        collection = armature.data.collections_all.get(name)
        if collection is not None:
            armature.data.collections.remove(collection)


def _give_back(armature: bpy.types.Object, text: str) -> None:
    # What was not written here gives nothing back: the .blend may come from anybody.
    with contextlib.suppress(ValueError, TypeError, KeyError, AttributeError, RecursionError):
        before = json.loads(text)
        for name in before["unlocked"]:
            if name in armature.pose.bones:
                armature.pose.bones[name].lock_location = (False,) * 3
        if armature.data.display_type == "STICK":
            armature.data.display_type = before["display"]


def switch(armature: bpy.types.Object) -> None:
    """Switch the controls and the limits on or off, as the properties of `Object.manient` say."""
    for _, constraint in _constraints(armature):
        on = armature.manient.limits if constraint.name == LIMIT else armature.manient.use_controls
        constraint.enabled = on


def reset(armature: bpy.types.Object) -> None:
    """Put the controls at rest, and switch the constraints that others put on them off. Keys stay."""
    for bone in _handles(armature):
        bone.matrix_basis = Matrix.Identity(4)
        for constraint in _foreign(bone):
            constraint.enabled = False


def in_use(armature: bpy.types.Object) -> bool:
    """True if the controls move the hand in some frame, or may do so."""
    handles = _handles(armature)
    if not handles or not armature.manient.use_controls:
        return False
    return are_moving(armature) or any(
        not np.allclose(bone.matrix_basis, np.eye(4), atol=1e-6) for bone in handles
    )


def are_moving(armature: bpy.types.Object) -> bool:
    """True if the controls may do something else in every frame: they have keys, or constraints that others
    put on them."""
    if any(_foreign(bone) for bone in _handles(armature)):
        return True
    for _, curve in keyed_curves(armature):
        is_one = curve.data_path.endswith("scale") or (
            curve.array_index == 0 and curve.data_path.endswith("quaternion")
        )
        if any(abs(point.co.y - is_one) > 1e-6 for point in curve.keyframe_points):
            return True
    return False


def keyed_curves(armature: bpy.types.Object) -> Iterator[tuple[Any, bpy.types.FCurve]]:
    """Yield the curves of the controls, each after what holds it, in every action that moves the armature."""
    paths = tuple(f'pose.bones["{name}"]' for name in control_bones(armature).values())
    for action, slot in used_actions(armature) if paths else ():
        holder = channels(action, slot)
        for curve in list(holder.fcurves) if holder is not None else ():
            if curve.data_path.startswith(paths):
                yield holder, curve


def is_own(constraint: bpy.types.Constraint) -> bool:
    """True if the add-on made the constraint: for the controls, where it has no effect unless they are
    `in_use`, or for the arm, where it has none on the hand."""
    return _is_of_controls(constraint) or constraint.name.startswith((TO_WRIST, TO_ELBOW))


def _is_of_controls(constraint: bpy.types.Constraint) -> bool:
    return constraint.name.startswith((_CONTROL, LIMIT))


def _handles(armature: bpy.types.Object) -> list[bpy.types.PoseBone]:
    """Return the pose bones of the controls that the artist moves."""
    names = control_bones(armature)
    return [armature.pose.bones[name] for role, name in names.items() if role != CAPTURED]


def _foreign(bone: bpy.types.PoseBone) -> list[bpy.types.Constraint]:
    """Return those constraints of a control that the add-on did not make and that do something."""
    return [
        c for c in bone.constraints if not c.name.startswith(_CONTROL) and not c.mute and c.influence > 0.0
    ]


def widen(armature: bpy.types.Object, bones: list[str], quats: np.ndarray) -> None:
    """Have the joints' limits let poses (N, 16, 4), quaternions as (w, x, y, z), through; NaN for those that
    do not matter."""
    limits = [armature.pose.bones[name].constraints.get(LIMIT) for name in bones[1:]]
    if len(quats) == 0 or not any(limits):
        return
    angles = anatomical_angles(quat_to_rotmat(quats[:, 1:]), ANATOMICAL_IN_BONE)
    lower, upper = np.fmin.reduce(angles) - _PLAY, np.fmax.reduce(angles) + _PLAY
    for limit, low, high in zip(limits, lower, upper, strict=True):
        if limit is not None:
            least = [-limit.max_y, -limit.max_z, limit.min_x]
            most = [-limit.min_y, -limit.min_z, limit.max_x]
            _limit(limit, np.fmin(least, low), np.fmax(most, high))


def _limit(limit: Any, lower: np.ndarray, upper: np.ndarray) -> None:
    """Set a joint's limits: (3,) twist, spread, bend in radians; bones have them about -Y, -Z and X."""
    limit.min_y, limit.min_z, limit.min_x = -upper[0], -upper[1], lower[2]
    limit.max_y, limit.max_z, limit.max_x = -lower[0], -lower[1], upper[2]


def _constraints(armature: bpy.types.Object) -> Iterator[tuple[bpy.types.PoseBone, bpy.types.Constraint]]:
    for bone in armature.pose.bones:
        for constraint in bone.constraints:
            if _is_of_controls(constraint):
                yield bone, constraint


def _constraint(bone: bpy.types.PoseBone, kind: Any, name: str, **settings: Any) -> Any:
    constraint = bone.constraints.new(kind)
    for key, value in {"name": name, "owner_space": "LOCAL", **settings}.items():
        setattr(constraint, key, value)
    return constraint


def _follow_keys(armature: bpy.types.Object, wrist: str, bone: str) -> None:
    """Give a bone all channels of the wrist, before its constraints, whichever rotation mode it has.

    Drivers read the channels themselves: what the hand's control does to the wrist must not come back to it.
    """
    channels = {"rotation_mode": 1, "location": 3, "rotation_quaternion": 4, "rotation_euler": 3}
    for path, count in (channels | {"rotation_axis_angle": 4}).items():
        for index in range(count):
            curve = armature.pose.bones[bone].driver_add(path, -1 if count == 1 else index)
            curve.keyframe_points.clear()  # from Blender 5.0 on it begins as a line, with steps at its points
            driver = curve.driver
            driver.type = "AVERAGE"
            target = driver.variables.new().targets[0]
            target.id = armature
            target.data_path = f'pose.bones["{wrist}"].{path}' + (f"[{index}]" if count > 1 else "")


def _collect(armature: bpy.types.Object, bones: list[str], names: dict[str, str]) -> None:
    for name in names.values():  # new bones are in the collection that the artist has as the active one
        for other in list(armature.data.bones[name].collections):
            other.unassign(armature.data.bones[name])
    handles = [name for role, name in names.items() if role != CAPTURED]
    for title, members in zip(_COLLECTIONS, (bones, handles, [names[CAPTURED]]), strict=True):
        collection = armature.data.collections.new(title)
        for name in members:
            collection.assign(armature.data.bones[name])
        collection.is_visible = title != _COLLECTIONS[2]


def _dress(bone: bpy.types.PoseBone, role: str, at: bpy.types.PoseBone) -> None:
    """Give a control its shape, drawn about the bone `at`, and leave it only what it does."""
    bone.rotation_mode = "XYZ"
    bone.lock_scale = (True,) * 3
    if role != "hand":
        bone.lock_location = (True,) * 3
        bone.lock_rotation = (False, True, False)
    bone.custom_shape = _shape(role if role in ("hand", "fingers") else "finger")
    bone.custom_shape_transform = at
    bone.color.palette = "CUSTOM"
    color = _FINGER_COLOR if role in FINGERS else _HAND_COLOR
    bone.color.custom.normal = color
    bone.color.custom.select, bone.color.custom.active = 0.5 + 0.5 * color, 0.7 + 0.3 * color


def _shape(kind: str) -> bpy.types.Object:
    """Return an object without faces that all hands of the file share, in no scene: it is only drawn for
    bones."""
    for there in bpy.data.objects:
        if there.get(_SHAPE) == kind and there.library is None:
            return there
    at, a, b = np.swapaxes(_SHAPES[kind], 0, 1)[:, :, None]  # (R, 1, 3) each
    t = np.linspace(0.0, 2.0 * pi, _RING_POINTS, endpoint=False)[:, None]
    points, own = at + np.cos(t) * a + np.sin(t) * b, np.arange(_RING_POINTS)
    edges = _RING_POINTS * np.arange(len(points))[:, None, None] + np.stack([own, np.roll(own, -1)], axis=-1)
    mesh = bpy.data.meshes.new(f"Hand control, {kind}")
    mesh.from_pydata(points.reshape(-1, 3).tolist(), edges.reshape(-1, 2).tolist(), [])
    shape = bpy.data.objects.new(mesh.name, mesh)
    shape[_SHAPE] = kind
    return shape
