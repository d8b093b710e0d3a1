"""The manifest's permissions are exactly what the add-on and the core use."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
NETWORK = {
    *(
        "socket",
        "socketserver",
        "ssl",
        "ftplib",
        "smtplib",
        "imaplib",
        "poplib",
        "telnetlib",
        "xmlrpc",
        "http",
    ),
    *("urllib.request", "urllib3", "requests", "httpx", "aiohttp", "websockets", "webbrowser", "asyncio"),
}
SOUND = {"sounddevice", "pyaudio", "aud"}
PERMISSIONS = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))["permissions"]


def trees() -> Iterator[tuple[Path, ast.AST]]:
    for package in ("blender_manient", "handfit_core"):
        for path in sorted((ROOT / package).rglob("*.py")):
            yield path, ast.walk(ast.parse(path.read_text(encoding="utf-8")))


def modules(node: ast.AST) -> set[str]:
    """What an import statement names: the modules, and what could be modules in them."""
    if isinstance(node, ast.Import):
        return {alias.name for alias in node.names}
    if isinstance(node, ast.ImportFrom) and node.module and not node.level:
        return {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return set()


def imports_any_of(names: set[str]) -> list[str]:
    return [
        f"{path.relative_to(ROOT).as_posix()}: {module}"
        for path, nodes in trees()
        for node in nodes
        for module in sorted(modules(node))
        if any(f"{module}.".startswith(f"{name}.") for name in names)
    ]


def uses_attribute(name: str) -> list[str]:
    return [
        f"{path.name}:{node.lineno}"
        for path, nodes in trees()
        for node in nodes
        if isinstance(node, ast.Attribute) and node.attr == name
    ]


def test_reasons_are_as_blender_wants_them():
    for reason in PERMISSIONS.values():
        assert 0 < len(reason) <= 64
        assert not reason.endswith(".")
    assert set(PERMISSIONS) == {"files", "clipboard"}


def test_the_clipboard_is_used():
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
    assert uses_attribute("url_open") == []
    assert uses_attribute("url_open_preset") == []


def test_nothing_listens_or_looks():
    assert imports_any_of(SOUND) == []
    # OpenCV takes a number for a camera, a path for a file.
    numbers = [
        f"{path.name}:{node.lineno}"
        for path, nodes in trees()
        for node in nodes
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr == "VideoCapture"
        and (not node.args or isinstance(node.args[0], ast.Constant))
    ]
    assert numbers == []
    assert uses_attribute("VideoCapture")


@pytest.mark.parametrize("module", ["urllib.request", "http.client", "socket"])
def test_the_search_finds_what_it_looks_for(module):
    """A search that finds nothing could be a search that cannot find."""
    for text in (f"import {module}", f"from {module} import x"):
        names = modules(ast.parse(text).body[0])
        assert {name for name in names if name in NETWORK or name.split(".")[0] in NETWORK}
