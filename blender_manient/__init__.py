"""Manient Hand Capture: photos and videos of hands become rigged, animated hands in Blender."""

from .operators import import_take

_PARTS = (import_take,)


def register() -> None:
    """Register every part of the add-on, in order."""
    for part in _PARTS:
        part.register()


def unregister() -> None:
    """Undo `register`, in reverse."""
    for part in reversed(_PARTS):
        part.unregister()
