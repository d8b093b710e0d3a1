"""What the scripts in here share: their arguments and facts, and Blender's extensions from a script."""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import socket
import sys
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any

import addon_utils
import bpy

REPOSITORY = "user_default"
ID = "manient"
HEAVY = ("scipy", "cv2", "mediapipe")
"""What captures, and must never be loaded by Blender's own process"""
NOT_HERE = (*HEAVY, "handfit_core", "blender_manient")
"""What only the zip may bring"""


class Facts:
    """Facts stage by stage, written down at once: a stage that fails leaves those before."""

    def __init__(self) -> None:
        asked, self._path = sys.argv[sys.argv.index("--") + 1 :]
        self.asked: dict[str, Any] = json.loads(Path(asked).read_text(encoding="utf-8"))
        self._found: dict[str, Any] = {}

    def add(self, stage: str, **found: Any) -> None:
        """Write down what a stage found."""
        self._found[stage] = found
        Path(self._path).write_text(json.dumps(self._found, indent=1, default=str), encoding="utf-8")


def surroundings() -> dict[str, Any]:
    """What is in reach before anything is installed."""
    try:
        socket.create_connection(("192.0.2.1", 80), timeout=2.0).close()
        outside = "reached"
    except OSError as error:
        outside = type(error).__name__
    return {
        "interfaces": [name for _, name in socket.if_nameindex()],
        "outside": outside,
        "modules": [name for name in NOT_HERE if importlib.util.find_spec(name) is not None],
        "variables": sorted(os.environ),
        "path": sys.path,
        "folder": str(Path.cwd()),
        "python": sys.version.split()[0],
        "blender": bpy.app.version_string,
        "executable": sys.executable,
    }


def module(name: str = "") -> ModuleType:
    """The installed add-on, or a module of it."""
    return importlib.import_module(".".join(filter(None, ("bl_ext", REPOSITORY, ID, name))))


def enabled() -> list[str]:
    """Names of our add-ons that are enabled."""
    return [name for name in bpy.context.preferences.addons.keys() if ID in name]  # noqa: SIM118


def install(file: str) -> dict[str, Any]:
    """Install a zip and enable it, as dropping it onto Blender's window does."""
    if not addon_utils.check("bl_pkg")[1]:
        addon_utils.enable("bl_pkg", default_set=True)
    install_files = bpy.ops.extensions.package_install_files
    said = attempt(install_files, filepath=file, repo=REPOSITORY, enable_on_install=True)
    return {"said": said, "enabled": enabled()}


def uninstall() -> str:
    """Uninstall; what Blender says."""
    repositories = [repo.module for repo in bpy.context.preferences.extensions.repos]
    index = repositories.index(REPOSITORY)
    return attempt(bpy.ops.extensions.package_uninstall, repo_index=index, pkg_id=ID)


def attempt(operator: Any, **arguments: Any) -> str:
    """Run an operator: FINISHED, or what it reports instead."""
    try:
        return ", ".join(sorted(operator(**arguments)))
    except RuntimeError as error:
        return str(error).strip()


def check_report() -> str:
    """The text of Check Installation."""
    attempt(bpy.ops.manient.check_installation)
    with suppress(KeyError):
        return bpy.data.texts["Hand Capture Check"].as_string()
    return ""


def capture(source: str, **settings: Any) -> dict[str, Any]:
    """Capture as the panel does; what came of it."""
    panel = bpy.context.scene.manient
    panel.source = source
    for name, value in settings.items():
        setattr(panel, name, value)
    said = attempt(bpy.ops.manient.capture)
    return {"said": said, "hands": [hand(armature) for armature in hands()]}


def hands() -> list[bpy.types.Object]:
    """The armatures of the captured hands."""
    return module("scene.store").captured_hands(bpy.context.scene)


def hand(armature: bpy.types.Object) -> dict[str, Any]:
    """What there is of a captured hand."""
    found = module("scene.store").hand_of(armature)
    keys = module("scene.keys").read_pose_keys(found.rig)
    seen = found.track.detected
    pictures = found.camera.data.background_images if found.camera else ()
    return {
        "side": found.side,
        "frames": found.take.frame_numbers.tolist(),
        "detected": int(seen.sum()),
        "error": float(found.track.reprojection_error[seen].max()),
        "vertices": len(found.mesh.data.vertices),
        "bones": len(armature.pose.bones),
        "keys": sorted(set(keys.frames.tolist())),
        "pictures": [background(p) for p in pictures],
        "size": [found.take.width, found.take.height],
        "scene": scene(),
    }


def background(picture: bpy.types.CameraBackgroundImage) -> dict[str, Any]:
    """What a camera shows behind the hand."""
    shown = picture.clip if picture.source == "MOVIE_CLIP" else picture.image
    return {"name": shown.name, "size": list(shown.size)}


def scene() -> dict[str, Any]:
    """Frame rate, range and picture size."""
    now = bpy.context.scene
    return {
        "rate": now.render.fps / now.render.fps_base,
        "range": [now.frame_start, now.frame_end],
        "size": [now.render.resolution_x, now.render.resolution_y],
        "camera": now.camera.name if now.camera else None,
    }


def panels() -> list[str]:
    """What the sections of our tab say, one per registered section: its labels and buttons."""
    said = []
    for section in bpy.types.Panel.__subclasses__():
        if getattr(section, "bl_category", "") != "Hand Capture" or not section.is_registered:
            continue
        if hasattr(section, "poll") and not section.poll(bpy.context):
            continue
        page = _Page([])
        section.draw(_Drawn(section, page), bpy.context)
        said.append(" ".join([f"[{section.bl_label}]", *page.lines]))
    return said


class _Page:
    """In the place of a layout, which background mode does not have: notes what it is asked to show."""

    def __init__(self, lines: list[str]) -> None:
        object.__setattr__(self, "lines", lines)

    def __getattr__(self, name: str) -> Any:
        def shown(*_: Any, **words: Any) -> _Page:
            if text := words.get("text"):
                self.lines.append(text)
            return _Page(self.lines)

        return shown

    def __setattr__(self, name: str, value: Any) -> None:
        """Alignment and the like."""


class _Drawn:
    """In the place of a section that is drawn: its functions, and a layout."""

    def __init__(self, section: type, layout: _Page) -> None:
        self._section, self.layout = section, layout

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._section, name)
        return found.__get__(self) if callable(found) else found


def worker() -> dict[str, Any]:
    """The process that captures, as the system sees it."""
    process = module("session.shared_worker").current()
    if process is None or process.pid is None:
        return {}
    folder = Path("/proc") / str(process.pid)
    lines = (folder / "environ").read_bytes().decode().split("\0")
    variables = dict(line.split("=", 1) for line in lines if "=" in line)
    compiled = variables.get("PYTHONPYCACHEPREFIX")
    mapped = {line.split(maxsplit=5)[5] for line in (folder / "maps").read_text().splitlines() if "/" in line}
    return {
        "pid": process.pid,
        "command": (folder / "cmdline").read_bytes().decode().split("\0"),
        "variables": variables,
        "compiled": sum(1 for _ in Path(compiled).rglob("scipy/**/*.pyc")) if compiled else 0,
        "libraries": {
            name: sorted(path for path in mapped if f"/{name}/" in path and ".so" in path)[:1]
            for name in (*HEAVY, "numpy")
        },
    }


def loaded() -> dict[str, Any]:
    """What Blender's own process has loaded."""
    core = sys.modules.get("handfit_core")
    return {
        "heavy": [name for name in HEAVY if name in sys.modules],
        "handfit_core": getattr(core, "__file__", None),
        "addon": module().__file__,
        "from": sorted({str(Path(m.__file__)) for n, m in list(sys.modules.items()) if _ours(n, m)}),
    }


def _ours(name: str, found: Any) -> bool:
    return (ID in name or "handfit" in name) and bool(getattr(found, "__file__", None))


def alive(pid: int) -> bool:
    """Whether a process runs; one that has ended and was not asked about counts as gone."""
    try:
        return (Path("/proc") / str(pid) / "stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
