"""The manifest's permissions are exactly what the add-on and the core use."""

from __future__ import annotations

import ast
import re
import tomllib
from functools import cache

import pytest

from tests.conftest import ROOT

NETWORK = set(
    "socket socketserver ssl ftplib smtplib imaplib poplib telnetlib xmlrpc http urllib.request urllib3 "
    "requests httpx aiohttp websockets webbrowser asyncio".split()
)
SOUND = {"sounddevice", "pyaudio", "aud"}


@cache
def nodes() -> list[tuple[str, ast.AST]]:
    """All that stands in the code, with the names of its files."""
    paths = sorted(
        p for package in ("blender_manient", "handfit_core") for p in (ROOT / package).rglob("*.py")
    )
    trees = (
        (path.relative_to(ROOT).as_posix(), ast.parse(path.read_text(encoding="utf-8"))) for path in paths
    )
    return [(name, node) for name, tree in trees for node in ast.walk(tree)]


def modules(node: ast.AST) -> set[str]:
    """What an import statement names: the modules, and what could be modules in them."""
    if isinstance(node, ast.Import):
        return {alias.name for alias in node.names}
    if isinstance(node, ast.ImportFrom) and node.module and not node.level:
        return {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return set()


def imports_any_of(names: set[str]) -> list[str]:
    found = [(file, module) for file, node in nodes() for module in sorted(modules(node))]
    return [f"{file}: {m}" for file, m in found if any(f"{m}.".startswith(f"{name}.") for name in names)]


def uses_attribute(name: str) -> bool:
    return any(isinstance(node, ast.Attribute) and node.attr == name for _, node in nodes())


def test_reasons_are_as_blender_wants_them():
    permissions = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))["permissions"]
    assert set(permissions) == {"files", "clipboard"}
    for reason in permissions.values():
        assert 0 < len(reason) <= 64
        assert not reason.endswith(".")
    assert uses_attribute("clipboard")


def test_nothing_in_the_zip_talks_to_the_network():
    """Only `send` does, which a checkout has: see test_core_wheel for what is in the zip. Blender and the
    worker hold a pair of sockets that were connected when they were made."""
    assert imports_any_of(NETWORK) == [
        "handfit_core/interchange/send.py: socket",
        "handfit_core/worker/process.py: socket",
    ]
    worker = (ROOT / "handfit_core" / "worker" / "process.py").read_text(encoding="utf-8")
    assert not re.search(r"\b(bind|listen|connect|create_connection|create_server)\(", worker)
    assert imports_any_of({"handfit_core.interchange.send"}) == [
        "handfit_core/__main__.py: handfit_core.interchange.send",
        "handfit_core/__main__.py: handfit_core.interchange.send.add_send_command",
    ]
    assert not uses_attribute("url_open")
    assert not uses_attribute("url_open_preset")


def test_nothing_listens_or_looks():
    """OpenCV takes a number for a camera, a path for a file."""
    assert imports_any_of(SOUND) == []
    calls = [node for _, node in nodes() if isinstance(node, ast.Call)]
    videos = [call for call in calls if ast.unparse(call.func).endswith("VideoCapture")]
    assert videos
    assert not [call for call in videos if not call.args or isinstance(call.args[0], ast.Constant)]


@pytest.mark.parametrize("module", ["urllib.request", "http.client", "socket"])
def test_the_search_finds_what_it_looks_for(module):
    for text in (f"import {module}", f"from {module} import x"):
        names = modules(ast.parse(text).body[0])
        assert {name for name in names if name in NETWORK or name.split(".")[0] in NETWORK}
