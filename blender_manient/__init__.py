"""Manient Hand Capture: photos and videos of hands become rigged, animated hands in Blender.

Importing this package needs neither Blender nor handfit_core nor NumPy: its pure modules work anywhere, and
where something is missing or wrong, the add-on comes up with a sentence about it instead of an error.
"""

from __future__ import annotations

import sys


def register() -> None:
    """Register every module of the add-on, or only the panel that says why it cannot run."""
    # Needs bpy, without which this package can be imported.
    from . import registration

    registration.register()


def unregister() -> None:
    """Undo `register`."""
    # Needs bpy, without which this package can be imported.
    from . import registration

    registration.unregister()


# Where the add-on is replaced while it is disabled, Blender reloads this file, and no other.
for _name in [name for name in sys.modules if name.startswith(f"{__name__}.")]:
    del sys.modules[_name]
    globals().pop(_name.removeprefix(f"{__name__}."), None)
