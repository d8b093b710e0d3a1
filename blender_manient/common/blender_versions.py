"""The differences between the versions of Blender from 4.2 on, which stand only here.

Every function asks for the thing itself rather than for Blender's version, so that builds with other
parts and versions to come are met too.

Up to Blender 4.3 an action holds curves for one object. From 4.4 on it holds them in a channel bag per
*slot*, and who uses the action names a slot of it; from 5.0 on `Action.fcurves` is gone.
"""

from __future__ import annotations

import contextlib
import importlib
from typing import Any

import bpy


def turns_movies() -> bool:
    """Return whether Blender turns a movie as its display matrix says, as it does from 4.4 on."""
    return bpy.app.version >= (4, 4)


def action_slot(user: Any) -> Any:
    """Return the slot that animation data or an NLA strip uses; None for none, and before Blender 4.4."""
    return getattr(user, "action_slot", None)


def slot_key(slot: Any) -> str:
    """Return what tells a slot from others of its action in notes on it; 0 before Blender 4.4."""
    return str(slot.handle) if slot is not None else "0"


def first_slot(action: bpy.types.Action) -> Any:
    """Return the first slot of an action that has one; None before Blender 4.4."""
    return action.slots[0] if _has_slots(action) else None


def slots_of(action: bpy.types.Action) -> list[Any]:
    """Return the slots of an action, each for one object; a list of one None before Blender 4.4."""
    return list(action.slots) if _has_slots(action) else [None]


def has_one_slot(action: bpy.types.Action) -> bool:
    """Return whether the action holds curves for one object at most."""
    return len(slots_of(action)) < 2


def new_slot(action: bpy.types.Action, name: str) -> Any:
    """Make a new slot for an object; None before Blender 4.4."""
    return action.slots.new(id_type="OBJECT", name=name) if _has_slots(action) else None


def channels(action: bpy.types.Action, slot: Any = None, *, make: bool = False) -> Any:
    """Return what holds the curves of an action: the action itself up to Blender 4.3, the slot's channel bag
    from 4.4 on. None where the slot has none, unless `make`."""
    if not _has_slots(action):
        return action
    for layer in action.layers:
        for strip in layer.strips:
            bag = strip.channelbag(slot) if slot is not None else None
            if bag is not None:
                return bag
    if not make:
        return None
    layer = action.layers[0] if len(action.layers) else action.layers.new("Layer")
    strip = layer.strips[0] if len(layer.strips) else layer.strips.new(type="KEYFRAME")
    return strip.channelbag(slot, ensure=True)


def assign_action(owner: bpy.types.Object, action: bpy.types.Action) -> Any:
    """Give an action to an object, with a slot where Blender has them. Returns what holds its curves."""
    data = owner.animation_data or owner.animation_data_create()
    if data.action != action:
        data.action = action
    if not _has_slots(action):
        return action
    if data.action_slot is None:
        # Where names match Blender has already taken a slot that exists.
        data.action_slot = new_slot(action, owner.name)
    return channels(action, data.action_slot, make=True)


def users_of(owner: bpy.types.Object, *, acting: bool = False) -> list[Any]:
    """Return what uses an action for an object: its animation data, then its strips from the top, for
    `acting` without those that are muted."""
    data = owner.animation_data
    tracks = data.nla_tracks if data is not None else ()
    strips = [s for track in tracks for s in track.strips if not (acting and (track.mute or s.mute))]
    return [user for user in (data, *reversed(strips)) if user is not None and user.action is not None]


def used_actions(owner: bpy.types.Object, *, acting: bool = False) -> list[tuple[Any, Any]]:
    """Return every (action, slot) of an object that can be changed: the present one and those in its NLA; or,
    for `acting`, every one that moves it now: linked ones too, and none that is muted."""
    used = [(user.action, action_slot(user)) for user in users_of(owner, acting=acting)]
    return list({(a, slot_key(slot)): (a, slot) for a, slot in used if acting or a.is_editable}.values())


def use_nodes(block: bpy.types.Material | bpy.types.World) -> Any:
    """Have a material or world made of nodes. Returns its node tree.

    From Blender 5.0 on all are from the start, and setting `use_nodes` warns.
    """
    if block.node_tree is None:
        block.use_nodes = True
    return block.node_tree


def has_strips(scene: bpy.types.Scene) -> bool:
    """Return whether the sequencer of a scene holds anything; up to Blender 4.3 its strips are called
    sequences."""
    editor: Any = scene.sequence_editor
    return editor is not None and len(editor.strips if hasattr(editor, "strips") else editor.sequences) > 0


def select_bones(armature: bpy.types.Object) -> None:
    """Select all bones of an armature, unless some are selected or it cannot be changed; up to Blender 4.5
    its data hold what is selected."""
    in_pose = "select" in bpy.types.PoseBone.bl_rna.properties
    owner: Any = armature if in_pose else armature.data
    bones = armature.pose.bones if in_pose else armature.data.bones
    if owner.is_editable and not any(bone.select for bone in bones):
        for bone in bones:
            bone.select = True


def has_operator(name: str) -> bool:
    """Return whether this Blender has the operator `module.name`; some builds lack USD and Alembic."""
    module, _, operator = name.partition(".")
    try:
        getattr(getattr(bpy.ops, module), operator).get_rna_type()
    except (AttributeError, KeyError):
        return False
    return True


def with_textures() -> dict[str, Any]:
    """Return the options that have the USD exporter write textures: `export_textures` is gone in Blender 5.0,
    `export_textures_mode` new in 4.3."""
    told = {"export_textures": True, "export_textures_mode": "NEW", "overwrite_textures": True}
    known = bpy.ops.wm.usd_export.get_rna_type().properties.keys() if has_operator("wm.usd_export") else ()
    return {name: value for name, value in told.items() if name in known}


def usd_stage(path: str) -> Any:
    """Return an open USD file, a pxr.Usd.Stage; None where this Blender has no module for it, as the bpy
    wheel of 4.2."""
    getattr(bpy.utils, "expose_bundled_modules", lambda: None)()
    with contextlib.suppress(ImportError):
        return importlib.import_module("pxr.Usd").Stage.Open(path)
    return None


def gltf_left_out() -> list[str]:
    """Return the glTF exporter's own list of custom properties that it leaves out: changing it changes what
    is written. An empty one where this Blender's exporter has none."""
    for module in ("extras", "gltf2_blender_extras"):  # the second up to Blender 4.2
        with contextlib.suppress(ImportError):
            return importlib.import_module(f"io_scene_gltf2.blender.com.{module}").BLACK_LIST
    return []


def property_group(block: bpy.types.ID, name: str) -> dict[str, Any]:
    """Return a copy of a data-block's custom property that is a group; empty where it is missing or no
    group."""
    value = block.get(name)
    return value.to_dict() if hasattr(value, "to_dict") else {}


def versions() -> tuple[tuple[int, int], tuple[int, int]]:
    """Main and minor version of the Blender that saved the open file, and of the running one."""
    return bpy.data.version[:2], bpy.app.version[:2]


def _has_slots(action: bpy.types.Action) -> bool:
    return hasattr(action, "slots")
