"""What the add-on keeps on library overrides, which from Blender 5.0 on lose groups of properties.

An override keeps what differs from the linked object. Where that one has never had the add-on's group, as in
files of people without the add-on, Blender cannot put it back. A plain property of the object survives: when
a file is saved, a copy of the group is put there as text.
"""

from __future__ import annotations

import contextlib
import json
from typing import Any, Final

import bpy

_BLOCKS: Final = {"Object": "objects", "Action": "actions"}


def register() -> None:
    """Add the property."""
    bpy.types.Object.manient_overridden = bpy.props.StringProperty(  # type: ignore
        description="Object.manient.character of a library override, as JSON",
        override={"LIBRARY_OVERRIDABLE"},
    )


def unregister() -> None:
    """Take it away again."""
    del bpy.types.Object.manient_overridden  # type: ignore


@bpy.app.handlers.persistent
def _keep(*_: Any) -> None:
    for obj in _overridden():
        values = _values(obj.manient.character)
        obj.manient_overridden = json.dumps(values) if values else ""


@bpy.app.handlers.persistent
def _put_back(*_: Any) -> None:
    for obj in _overridden():  # with what another version wrote, or somebody else
        with contextlib.suppress(ValueError, TypeError, KeyError, AttributeError, RecursionError):
            _set(obj.manient.character, json.loads(obj.manient_overridden or "{}"))


HANDLERS: Final = {"save_pre": _keep, "load_post": _put_back}


def _overridden() -> list[bpy.types.Object]:
    return [o for o in bpy.data.objects if o.type == "ARMATURE" and o.override_library and o.library is None]


def _values(group: Any) -> dict[str, Any]:
    """What of a group is set, groups inside it likewise, data-blocks by name."""
    found = {}
    for name in group.__annotations__:
        value = getattr(group, name)
        if isinstance(value, bpy.types.PropertyGroup):
            value = _values(value)
        elif isinstance(value, bpy.types.ID):
            value = value.name
        elif not group.is_property_set(name):
            continue
        if value not in (None, {}):
            found[name] = value
    return found


def _set(group: Any, values: dict[str, Any]) -> None:
    for name, value in values.items():
        if isinstance(value, dict):
            _set(getattr(group, name), value)
            continue
        kind = group.bl_rna.properties[name]
        if kind.type == "POINTER":
            value = getattr(bpy.data, _BLOCKS[kind.fixed_type.identifier]).get(value)
        if getattr(group, name) != value:
            setattr(group, name, value)
