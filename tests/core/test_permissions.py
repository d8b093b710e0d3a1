"""The manifest's permissions are exactly what the add-on and the core use."""

import ast
import re
import tomllib

from tests.conftest import ROOT
from tests.core.test_imports import MODULES, imported_modules

NETWORK = set(
    "socket socketserver ssl ftplib smtplib imaplib poplib telnetlib xmlrpc http urllib urllib3 requests "
    "httpx aiohttp websockets webbrowser asyncio".split()
)
SOUND = {"sounddevice", "pyaudio", "aud"}
NODES = [node for path in MODULES.values() for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))]


def importers(names: set[str]) -> set[str]:
    """The modules of ours that import any of those packages."""
    found = {name: imported_modules(path) - {"urllib.parse"} for name, path in MODULES.items()}
    return {name for name, modules in found.items() if names & {m.partition(".")[0] for m in modules}}


def uses_attribute(name: str) -> bool:
    return any(isinstance(node, ast.Attribute) and node.attr == name for node in NODES)


def test_reasons_are_as_blender_wants_them():
    permissions = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))["permissions"]
    assert set(permissions) == {"files", "clipboard", "camera", "network"}
    for reason in permissions.values():
        assert 0 < len(reason) <= 64
        assert not reason.endswith(".")
    assert uses_attribute("clipboard")


def test_nothing_in_the_zip_talks_to_the_network():
    """Only `send` does, which a checkout has: see test_core_wheel for what is in the zip. Blender and the
    worker hold a pair of sockets that were connected when they were made."""
    send, worker = "handfit_core.capturing.live.send", "handfit_core.worker.process"
    assert importers(NETWORK) == {send, worker}
    text = MODULES[worker].read_text(encoding="utf-8")
    assert not re.search(r"\b(bind|listen|connect|create_connection|create_server)\(", text)
    assert {name for name, path in MODULES.items() if send in imported_modules(path)} == {
        "handfit_core.__main__"
    }
    assert not uses_attribute("url_open")
    assert not uses_attribute("url_open_preset")


def test_nothing_listens_and_only_live_runs_look():
    """OpenCV takes a number for a camera, a path for a file."""
    assert importers(SOUND) == set()
    live = {name for name, path in MODULES.items() if "handfit_core.media.camera" in imported_modules(path)}
    assert live == {"handfit_core.capturing.live.streaming"}
    calls = [node for node in NODES if isinstance(node, ast.Call)]
    videos = [call for call in calls if ast.unparse(call.func).endswith("VideoCapture")]
    assert videos
    assert not [call for call in videos if not call.args or isinstance(call.args[0], ast.Constant)]
