"""Differences between Blender's versions are met in one module, common/blender_versions.py."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ONLY_HERE = ROOT / "blender_manient" / "common" / "blender_versions.py"
MODULES = sorted(path for folder in ("blender_manient", "scripts") for path in (ROOT / folder).rglob("*.py"))

ASKED_ELSEWHERE = {
    "details": "errors of ours",
    "manient": "whether the add-on is registered",
    "runs": "copies of the add-on",
    "command": "copies of the add-on",
    "_handle": "copies of the add-on",
    "__version__": "packages",
    "preferences": "an entry of Blender's that is not there while scripts register the add-on",
    "scenes": "bpy.data while Blender enables add-ons",
    "objects": "bpy.data while Blender enables add-ons",
    "register": "whether a part of the add-on adds more than its classes",
    "unregister": "whether a part of the add-on adds more than its classes",
    "fget": "whether a class has a property or a value",
    "materials": "kinds of objects",
    "animation_data": "kinds of data-blocks",
    "shape_keys": "kinds of objects' data",
    "mode": "kinds of editors",
    "asset": "a member of the context that only asset browsers have",
    "vrm_addon_extension": "data of another add-on",
}
"""What modules that know Blender may ask for by name, and why"""


def imported_packages(whole: ast.Module) -> set[str]:
    found = set()
    for node in ast.walk(whole):
        match node:
            case ast.Import(names=names):
                found.update(alias.name.partition(".")[0] for alias in names)
            case ast.ImportFrom(module=str(module), level=0):
                found.add(module.partition(".")[0])
    return found


def version_differences(source: str) -> Iterator[str]:
    """What of a module belongs into blender_versions.py."""
    whole = ast.parse(source)
    knows_blender = "bpy" in imported_packages(whole)
    for node in ast.walk(whole):
        match node:
            case ast.Attribute(value=ast.Attribute(attr="app"), attr="version" | "version_file"):
                yield ast.unparse(node)
            case ast.Attribute(attr="use_nodes"):
                yield ast.unparse(node)
            case ast.Constant(value=str(text)) if "io_scene_" in text:
                yield text
            case ast.Call(func=ast.Name(id="dir")) if "bpy" in ast.unparse(node):
                yield ast.unparse(node)
            case (
                ast.Call(func=ast.Name(id="hasattr"), args=[_, ast.Constant(value=name)])
                | ast.Call(func=ast.Name(id="getattr"), args=[_, ast.Constant(value=name), _])
            ) if knows_blender and name not in ASKED_ELSEWHERE:
                yield ast.unparse(node)


@pytest.mark.parametrize("path", [p for p in MODULES if p != ONLY_HERE], ids=lambda p: p.stem)
def test_no_other_module_asks_for_a_version(path: Path) -> None:
    assert list(version_differences(path.read_text(encoding="utf-8"))) == []


def test_what_is_looked_for_is_found_where_it_is() -> None:
    found = set(version_differences(ONLY_HERE.read_text(encoding="utf-8")))
    assert {"hasattr(action, 'slots')", "block.use_nodes"} <= found
    assert "getattr(user, 'action_slot', None)" in found
    assert list(version_differences("there = dir(bpy.ops.wm)")) == ["dir(bpy.ops.wm)"]
    assert list(version_differences("new = bpy.app.version >= (5, 0, 0)")) == ["bpy.app.version"]
    assert list(version_differences("import bpy\nnew = hasattr(bpy.types, 'x')")) == [
        "hasattr(bpy.types, 'x')"
    ]


def test_every_exception_is_needed() -> None:
    sources = [ast.parse(path.read_text(encoding="utf-8")) for path in MODULES]
    asked = set()
    for node in (node for source in sources for node in ast.walk(source)):
        match node:
            case ast.Call(func=ast.Name(id="hasattr" | "getattr"), args=[_, ast.Constant(value=name), *_]):
                asked.add(name)
    assert set(ASKED_ELSEWHERE) <= asked
