"""The arrows of the architecture: what may import what, and what loads nothing heavy."""

import ast
import subprocess
import sys
from collections.abc import Iterable
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BLENDER = ("bpy", "bmesh", "mathutils", "bpy_extras", "gpu")
HEAVY = ("torch", "scipy", "cv2", "mediapipe", "av")
THREADED = ("threading", "_thread", "concurrent", "asyncio", "multiprocessing")


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {
    module_name(p): p for top in ("blender_manient", "handfit_core") for p in (ROOT / top).rglob("*.py")
}


@cache
def imported_modules(path: Path, *, everywhere: bool = True) -> set[str]:
    """Whole names of what a file imports, each module's own name where it is one of ours. `everywhere`: also
    inside functions, else only what is loaded with the file."""
    name, found = module_name(path), set()
    waiting: list[ast.AST] = [ast.parse(path.read_text(encoding="utf-8"))]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            package = name.split(".") if path.stem == "__init__" else name.split(".")[:-1]
            base = package[: len(package) - node.level + 1] if node.level else []
            whole = ".".join([*base, *([node.module] if node.module else [])])
            found.update(f"{whole}.{a.name}" if f"{whole}.{a.name}" in MODULES else whole for a in node.names)
        for_types = isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        if everywhere or not (isinstance(node, ast.FunctionDef | ast.Lambda) or for_types):
            waiting += ast.iter_child_nodes(node)
    return found


def local_imports(name: str, *, everywhere: bool) -> set[str]:
    """The modules of ours that one of ours imports."""
    return {m for m in imported_modules(MODULES[name], everywhere=everywhere) if m in MODULES} - {name}


def loaded_with(names: Iterable[str]) -> set[str]:
    """Modules of ours that are loaded together with these, themselves and their packages included."""
    loaded, waiting = set(), list(names)
    while waiting:
        name = waiting.pop()
        if name and name not in loaded:
            loaded.add(name)
            waiting += [name.rpartition(".")[0], *local_imports(name, everywhere=False)]
    return loaded


def imports_blender(name: str) -> bool:
    """Whether a module names Blender's modules, outside of functions."""
    return any(m.split(".")[0] in BLENDER for m in imported_modules(MODULES[name], everywhere=False))


def test_core_knows_nothing_of_blender():
    core = [path for name, path in MODULES.items() if name.startswith("handfit_core")]
    imported = {m.split(".")[0] for path in core for m in imported_modules(path)}
    assert imported & {*BLENDER, "blender_manient"} == set()


def test_no_module_imports_itself_through_others():
    """Also not inside functions, where a circle only comes to light when it is called."""
    graph = {name: local_imports(name, everywhere=True) for name in MODULES}
    TopologicalSorter(graph).prepare()  # raises CycleError with the circle


def test_blenders_process_loads_nothing_heavy_and_no_threads():
    """Blender up to 5.0 can crash when a thread runs Python while an operator runs."""
    loaded = loaded_with(name for name in MODULES if name.startswith("blender_manient"))
    for name in loaded - {"handfit_core.media.read_ahead"}:  # which the worker alone calls
        of_addon = name.startswith("blender_manient")
        for module in imported_modules(MODULES[name], everywhere=of_addon):
            assert module.split(".")[0] not in (*HEAVY, *THREADED), name


ASSEMBLIES = ("modules", "batch.order", "batch.run", "batch.slot", "exporters", "exporters.take")
PURE = ("common.wording", "batch.arguments", "batch.console", "batch.commands")
"""Modules of the add-on that work without Blender"""


def test_modules_that_name_no_blender_need_none():
    """But those that only put parts together which need it."""
    pure = [name for name in MODULES if name.startswith("blender_manient.") and not imports_blender(name)]
    behind = {name for name in pure if any(map(imports_blender, loaded_with([name])))}
    assert behind <= {f"blender_manient.{name}" for name in ASSEMBLIES}


FLOORS = {
    "handfit_core": (
        "common",
        "geometry",
        "media hand_model",
        "detect",
        "fit",
        "take paper",
        "retarget",
        "edit interchange",
        "capturing",
        "worker evaluate",
        "tasks",
        "__main__",
    ),
    "blender_manient": (
        "common",
        "rigs",
        "scene",
        "exporters",
        "session",
        "operators",
        "panels",
        "batch",
        "command modules unusable",
        "registration",
    ),
}
"""Folders and single modules of each package, from the bottom up: each may import the floors below"""


def room_of(name: str) -> str:
    """The room of a module; the package's own __init__, which opens the front door, has none."""
    return name.partition(".")[2].partition(".")[0]


@pytest.mark.parametrize("package", FLOORS)
def test_no_arrow_leads_up(package):
    floor = {room: at for at, line in enumerate(FLOORS[package]) for room in line.split()}
    names = [name for name in MODULES if name.startswith(f"{package}.")]
    assert {room_of(name) for name in names} == set(floor), "FLOORS lists every room, and no other"
    found = []
    for name in names:
        for other in local_imports(name, everywhere=True):
            low, high = room_of(name), room_of(other)
            if other.split(".")[0] == package and low != high and floor.get(high, 99) >= floor[low]:
                found.append(f"{name} imports {other}: {high or package} is not below {low}")
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("word", "room"), [("JOINT_NAMES", "rigs"), ("bone_names", "rigs"), ("export_scene.", "exporters")]
)
def test_bones_and_formats_are_known_in_one_place(word, room):
    """Everything else asks a rig, or a format, whatever else is added to the two folders."""
    addon = ROOT / "blender_manient"
    knowing = {p.relative_to(addon).parts[0] for p in addon.rglob("*.py") if word in p.read_text("utf-8")}
    assert knowing == {room}


@pytest.mark.parametrize(
    "code",
    [
        "sys.modules['bpy'] = sys.modules['mathutils'] = None; import "
        + ", ".join(f"blender_manient.{name}" for name in PURE),
        "import handfit_core.take, handfit_core.hand_model, handfit_core.media.opening, "
        "handfit_core.fit.solvers, handfit_core.capturing.pipeline, handfit_core.__main__; "
        f"assert not set({HEAVY!r}) & set(sys.modules)",
        # Or the worker could not tell NumPy's OpenBLAS how many threads it may have.
        "import handfit_core; assert 'numpy' not in sys.modules; handfit_core.Take",
    ],
    ids=["the add-on's pure modules need no Blender", "the light half is light", "without NumPy"],
)
def test_loads(code):
    subprocess.run([sys.executable, "-c", f"import sys; {code}"], check=True, cwd=ROOT)


def test_capturing_and_fitting_again_need_neither_torch_nor_arms():
    """From pictures to a take, and from the take to a corrected range."""
    code = """
import sys
import numpy as np
from handfit_core import capture
from handfit_core.media.frame_range import FrameRange
from handfit_core.edit import RefineHand, refit_each, refit_range, warm_up

take = capture("samples/rendered_hand/hand.%04d.jpg", frames=FrameRange(1, 6))
hand, = take.hands
pins = np.full((len(hand.detected), 21, 2), np.nan)
pins[2, 8] = hand.keypoints_2d[2, 8] + 10.0
rest = take.intrinsics, hand.detections, pins, np.zeros(16, dtype=bool)
corrected = RefineHand(hand.side, hand.betas, *hand.pose, *rest)
warm_up()
for found in (refit_each(corrected), refit_range(corrected)):
    assert found.present.all()
for name in ("torch", "handfit_core.capturing.arms", "handfit_core.detect.bodies", "handfit_core.fit.arms"):
    assert name not in sys.modules, name
"""
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
