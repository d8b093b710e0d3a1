"""Differences between Blender's versions are met in one module of the add-on."""

import ast
from collections.abc import Iterator

from tests.conftest import ROOT

ONLY_HERE = ROOT / "blender_manient" / "common" / "blender_versions.py"
SOURCES = {
    path: path.read_text(encoding="utf-8")
    for folder in ("blender_manient", "scripts")
    for path in (ROOT / folder).rglob("*.py")
}

ASKED_ELSEWHERE = {
    "errors of ours": "details __notes__",
    "whether the add-on is registered": "manient",
    "copies of the add-on": "_registered",
    "packages": "__version__",
    "an entry of Blender's that is not there while scripts register the add-on": "preferences",
    "bpy.data while Blender enables add-ons": "scenes objects",
    "whether a part of the add-on adds more than its classes": "register unregister",
    "whether a class has a property or a value": "fget",
    "kinds of objects, of their data and of data-blocks": "materials shape_keys animation_data",
    "kinds of editors": "mode",
    "a member of the context that only asset browsers have": "asset",
    "data of another add-on": "vrm_addon_extension",
}
"""Why modules that know Blender may ask for something by name, and what"""
ALLOWED = {name for names in ASKED_ELSEWHERE.values() for name in names.split()}


def version_differences(source: str) -> Iterator[str]:
    """What of a module belongs into blender_versions.py."""
    whole = ast.parse(source)
    imports = (n for n in ast.walk(whole) if isinstance(n, ast.Import))
    knows_blender = any(alias.name.startswith("bpy") for n in imports for alias in n.names)
    for node in ast.walk(whole):
        match node:
            case (
                ast.Attribute(value=ast.Attribute(attr="app"), attr="version" | "version_file")
                | ast.Attribute(attr="use_nodes")
            ):
                yield ast.unparse(node)
            case ast.Constant(value=str(text)) if "io_scene_" in text:
                yield text
            case ast.Call(func=ast.Name(id="dir")) if "bpy" in ast.unparse(node):
                yield ast.unparse(node)
            case (
                ast.Call(func=ast.Name(id="hasattr"), args=[_, ast.Constant(value=name)])
                | ast.Call(func=ast.Name(id="getattr"), args=[_, ast.Constant(value=name), _])
            ) if knows_blender and name not in ALLOWED:
                yield ast.unparse(node)


def test_no_other_module_asks_for_a_version():
    found = {
        path.stem: list(version_differences(text)) for path, text in SOURCES.items() if path != ONLY_HERE
    }
    assert {stem: asked for stem, asked in found.items() if asked} == {}


def test_what_is_looked_for_is_found_where_it_is():
    found = set(version_differences(SOURCES[ONLY_HERE]))
    assert {"hasattr(action, 'slots')", "block.use_nodes", "getattr(user, 'action_slot', None)"} <= found
    for line in ("dir(bpy.ops.wm)", "bpy.app.version", "hasattr(bpy.types, 'x')"):
        assert list(version_differences(f"import bpy\n{line}")) == [line]


def test_every_exception_is_needed() -> None:
    assert [name for name in ALLOWED if not any(f'"{name}"' in text for text in SOURCES.values())] == []
