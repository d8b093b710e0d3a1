"""The table of a character's bones as the panel shows and changes it.

What is kept is one text for each hand (`Object.manient.character`), which library overrides take along; these
properties only read and write it, for the character that is selected.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, StringProperty

from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, SIDES
from handfit_core.retarget.hand_map import PALM_FINGERS, HandMap, empty_map

from ..scene.characters import active_character, keep_map, table_of, why_not_reachable

BONES: dict[str, tuple[str, int]] = {
    "hand": ("bones", 0),
    **{f"{f}_{i + 1}": ("bones", joint) for f in FINGERS for i, joint in enumerate(FINGER_JOINTS[f])},
    **{f"{finger}_palm": ("palm", i) for i, finger in enumerate(PALM_FINGERS)},
}
"""By a property's name, the HandMap's field that holds the bone's name, and the index of the bone in it"""


def _of(get: Callable[[HandMap], Any], changes: Callable[[HandMap, Any], dict[str, Any]]) -> dict[str, Any]:
    """Return a property's functions: `get` tells its value by a table, and `changes` which fields of the
    table another value changes."""

    def read(table: Any) -> Any:
        armature = active_character(bpy.context)
        return get(empty_map(table.side) if armature is None else table_of(armature, table.side))

    def write(table: Any, value: Any) -> None:
        armature = active_character(bpy.context)
        if armature is not None and why_not_reachable(armature) is None:
            shown = table_of(armature, table.side)
            keep_map(armature, replace(shown, **changes(shown, value)))

    return {"get": read, "set": write}


def _bone(name: str) -> Any:
    """Return the property of one bone's name."""
    field, index = BONES[name]

    def changes(shown: HandMap, value: str) -> dict[str, Any]:
        names = list(getattr(shown, field))
        names[index] = value
        return {field: tuple(names)}

    return StringProperty(
        name=name.replace("_", " ").title(),
        description="The bone that stands for it; empty: the character has none",
        **_of(lambda shown: getattr(shown, field)[index], changes),
    )


def _field(name: str) -> dict[str, Any]:
    return _of(lambda shown: getattr(shown, name), lambda _shown, value: {name: value})


class ManientHandTable(bpy.types.PropertyGroup):
    """Scene.manient.hand_table: one property for every bone that a HandMap can name, and for what else it
    says."""

    side: EnumProperty(
        name="Side",
        items=(("left", "Left", "The left hand's bones"), ("right", "Right", "The right hand's bones")),
    )
    control: StringProperty(
        name="Moved By",
        description="The bone that moves the whole hand; empty: the hand's own",
        **_field("control"),
    )
    thumb_roll: FloatProperty(
        name="Thumb Roll",
        description="Turns the thumb's bones about themselves, in degrees, where the thumb's skin bends "
        "sideways; positive turns its nail towards the back of the hand",
        soft_min=-90.0,
        soft_max=90.0,
        min=-180.0,
        max=180.0,
        precision=0,
        **_field("thumb_roll"),
    )
    keep_rest: BoolProperty(
        name="Keep Rest",
        description="Fingers differ from the captured ones as the character's rest pose does, instead of "
        "pointing as these do: for hands that are drawn relaxed",
        **_field("keep_rest"),
    )
    fold: FloatProperty(
        name="Palm Fold",
        description="How much of ring and little finger's bend their metacarpal bones take over",
        subtype="FACTOR",
        min=0.0,
        max=1.0,
        **_field("fold"),
    )


# Texts, as the annotations above are: properties that live on when Python ends make Blender 4.2 crash then.
ManientHandTable.__annotations__ |= {name: f"_bone({name!r})" for name in BONES}


def _read_linked(*_args) -> None:
    """Read the settings of linked characters that have overrides. That makes those that their file does not
    have, without which Blender 5.2 saves the overrides' own settings in a way that it cannot load."""
    for obj in bpy.data.objects:
        override = obj.override_library
        if obj.type == "ARMATURE" and override is not None and override.reference is not None:
            for side in SIDES:
                getattr(override.reference.manient.character, side).hand_map  # noqa: B018


HANDLERS = {"save_pre": _read_linked}
