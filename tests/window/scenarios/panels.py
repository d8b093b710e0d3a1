"""The sections of the sidebar, and which of them are open."""

from __future__ import annotations

from contextlib import contextmanager

import bpy

from scenarios.capturing import part


def sections() -> list[type]:
    """All sections of the sidebar, parents before children."""
    registered = part("modules").MODULES
    return [c for one in registered for c in one.classes if issubclass(c, bpy.types.Panel)]


@contextmanager
def opened_by_default(*only: str):
    """Meanwhile all sections of new files are open, or `only` these are: a section's state comes from its
    class when it is first drawn."""
    before = {cls: set(getattr(cls, "bl_options", ())) for cls in sections()}
    before = {cls: options for cls, options in before.items() if "HIDE_HEADER" not in options}
    _register_with(
        {
            cls: options - {"DEFAULT_CLOSED"}
            if not only or any(name in cls.__name__ for name in only)
            else options | {"DEFAULT_CLOSED"}
            for cls, options in before.items()
        }
    )
    try:
        yield
    finally:
        _register_with(before)


def _register_with(options: dict[type, set[str]]) -> None:
    for cls in reversed(list(options)):
        bpy.utils.unregister_class(cls)
    for cls, wanted in options.items():
        cls.bl_options = wanted
        bpy.utils.register_class(cls)
