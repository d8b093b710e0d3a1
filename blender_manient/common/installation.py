"""The state of the installation, and the one sentence that tells where it is not whole.

handfit_core and NumPy may be what is missing, so neither is imported here.
"""

from __future__ import annotations

import platform
import sys
import tomllib
from pathlib import Path

import bpy

NOT_WHOLE = "The add-on is not whole: remove it and install the zip again"
ADDON_FOLDER = Path(__file__).resolve().parents[1]

why_not = ""
"""The sentence that tells why only the panel that shows it is registered; empty where the add-on runs"""
details = ""
"""More about why the add-on does not run, for a bug report"""


def is_installed() -> bool:
    """Return whether this copy came from a zip, whose wheels Blender has unpacked; False for a checkout."""
    return __name__.startswith("bl_ext.")


def addon_version() -> str:
    """Return the version in the manifest, which lies above the add-on's folder in a checkout. Raises what
    reading it raises."""
    folder = ADDON_FOLDER if is_installed() else ADDON_FOLDER.parent
    manifest = tomllib.loads((folder / "blender_manifest.toml").read_text(encoding="utf-8"))
    return str(manifest["version"])


def versions() -> str:
    """Return the versions of the add-on, the core, Blender, Python, NumPy and the operating system; a few
    lines."""
    core, numpy = (_loaded_version(name) for name in ("handfit_core", "numpy"))
    build = bpy.app.build_hash
    commit = build.decode("ascii", "replace") if isinstance(build, bytes) else str(build)
    try:
        version = addon_version()
    except (OSError, ValueError, KeyError):
        version = "unknown"
    return "\n".join(
        (
            f"Manient Hand Capture {version}, handfit_core {core}",
            f"Blender {bpy.app.version_string} ({commit})",
            f"Python {platform.python_version()}, NumPy {numpy}",
            f"{platform.platform()} ({platform.machine()})",
            f"{'background' if bpy.app.background else 'window'}, {sys.executable}",
        )
    )


def without_home(text: str) -> str:
    """Return the text of a bug report with ~ for the user's own folder, so that it does not tell the user's
    name."""
    home = str(Path.home())
    return text.replace(home, "~") if len(home) > 1 else text


def _loaded_version(name: str) -> str:
    return str(getattr(sys.modules.get(name), "__version__", "not loaded"))
