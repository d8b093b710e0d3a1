"""The add-on's modules whose classes and handlers are registered with Blender, in their order."""

from __future__ import annotations

import importlib
import pkgutil
from types import ModuleType
from typing import Any

import bpy

from . import operators, panels, scene, session
from .common import preferences
from .panels import preferences as preferences_panel
from .session import hand_table, properties

_KINDS = (
    bpy.types.AddonPreferences,
    bpy.types.PropertyGroup,
    bpy.types.Operator,
    bpy.types.Panel,
    bpy.types.UIList,
    bpy.types.FileHandler,
)


class AddonModule:
    """Registers one module: its own classes in the order of their definition, and what it declares:

    * PROPERTIES: (Blender's type, name) -> function that makes the property which all of its data-blocks get:
      properties that live on when Python ends make Blender hang or crash then
    * HANDLERS: Blender's name of an event -> function
    * LISTENERS: name of a notifier in common/preferences.py -> function
    * MENUS: (name of Blender's menu, "append" or "prepend") -> function that draws an entry
    * TIMERS: functions that the module gives to Blender's timers

    `register` and `unregister` do what else there is to begin and to end.
    """

    def __init__(self, module: ModuleType) -> None:
        self.classes = [
            value
            for value in vars(module).values()
            if isinstance(value, type) and issubclass(value, _KINDS) and value.__module__ == module.__name__
        ]
        self._module = module
        # Blender 4.2 does not tell of imports.
        events = {name: getattr(bpy.app.handlers, name, []) for name in self._declared("HANDLERS")}
        # Handlers that are not persistent are gone as soon as a file is opened.
        kept = bpy.app.handlers.persistent
        self._handlers = [(events[name], kept(module.HANDLERS[name])) for name in events]
        self._register_classes, self._unregister_classes = bpy.utils.register_classes_factory(self.classes)

    def _declared(self, name: str) -> Any:
        return getattr(self._module, name, {})

    def register(self) -> None:
        """Register the classes, properties, handlers and menus that the module has."""
        self._register_classes()
        for (owner, name), make in self._declared("PROPERTIES").items():
            setattr(owner, name, make())
        for event, handler in self._handlers:
            event.append(handler)
        preferences.listeners |= self._declared("LISTENERS")
        for (menu, place), draw in self._declared("MENUS").items():
            getattr(getattr(bpy.types, menu), place)(draw)
        getattr(self._module, "register", _do_nothing)()
        # The add-on may be switched on in a file that is open; at start-up there is none yet.
        if hasattr(bpy.data, "objects") and "load_post" in self._declared("HANDLERS"):
            self._module.HANDLERS["load_post"]()

    def unregister(self) -> None:
        """Undo `register`, in reverse."""
        try:
            getattr(self._module, "unregister", _do_nothing)()
        finally:
            for timer in filter(bpy.app.timers.is_registered, self._declared("TIMERS")):
                bpy.app.timers.unregister(timer)
            for (menu, _), draw in self._declared("MENUS").items():
                getattr(bpy.types, menu).remove(draw)
            for name in self._declared("LISTENERS"):
                preferences.listeners.pop(name, None)
            for event, handler in self._handlers:
                if handler in event:
                    event.remove(handler)
            for owner, name in self._declared("PROPERTIES"):
                if hasattr(owner, name):
                    delattr(owner, name)
            self._unregister_classes()


def _do_nothing() -> None:
    pass


def _submodules(package: ModuleType) -> list[ModuleType]:
    return [
        importlib.import_module(f"{package.__name__}.{found.name}")
        for found in pkgutil.iter_modules(package.__path__)
        if not found.ispkg
    ]


_ORDER = (
    preferences_panel,  # what follows asks for what the user has chosen
    preferences,
    hand_table,
    properties,  # which has one of these, and which all that follow look into
    *_submodules(scene),
    *_submodules(session),
    *_submodules(operators),
    *_submodules(panels),
)
MODULES = tuple(AddonModule(module) for module in dict.fromkeys(_ORDER))
"""The add-on's modules, in the order of their registration"""
