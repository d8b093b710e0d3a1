"""The arrows of the architecture: what may import what, and what loads nothing heavy."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
HEAVY = ("torch", "scipy", "cv2", "mediapipe")
THREADED = ("threading", "_thread", "concurrent", "asyncio", "multiprocessing")


def imported_modules(path: Path) -> set[str]:
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            found.add(node.module)
    return found


@pytest.mark.parametrize("path", sorted((ROOT / "handfit_core").rglob("*.py")), ids=lambda p: p.stem)
def test_core_knows_nothing_of_blender(path: Path) -> None:
    for module in imported_modules(path):
        assert module.split(".")[0] not in ("bpy", "bmesh", "mathutils", "bpy_extras", "blender_manient")


@pytest.mark.parametrize("path", sorted((ROOT / "blender_manient").rglob("*.py")), ids=lambda p: p.stem)
def test_addon_imports_nothing_heavy(path: Path) -> None:
    for module in imported_modules(path):
        assert module.split(".")[0] not in HEAVY


@pytest.mark.parametrize("path", sorted((ROOT / "blender_manient").rglob("*.py")), ids=lambda p: p.stem)
def test_addon_has_no_threads(path: Path) -> None:
    """Blender up to 5.0 can crash when a thread runs Python while an operator runs."""
    for module in imported_modules(path):
        assert module.split(".")[0] not in THREADED


def test_light_half_is_light() -> None:
    code = (
        "import sys, handfit_core, handfit_core.take, handfit_core.hand_model, handfit_core.media.opening, "
        "handfit_core.solvers, handfit_core.pipeline, handfit_core.__main__\n"
        f"heavy = sorted(set({HEAVY!r}) & set(sys.modules))\n"
        "assert not heavy, heavy\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
