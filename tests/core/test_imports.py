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


ARROWS = {
    "doors": ("errors", "doors"),
    "geometry": ("errors", "geometry"),
    "media": ("errors", "doors", "files", "geometry", "media"),
    "detect": (
        *("detect", "doors", "errors", "files", "geometry", "hand_model", "media"),
        *("options", "registry", "skeleton"),
    ),
}
"""What the rooms at the beginning of the path may know of the core"""


@pytest.mark.parametrize("room", ARROWS)
def test_rooms_know_only_what_comes_before_them(room: str) -> None:
    known: set[str] = set()
    for path in (ROOT / "handfit_core" / room).rglob("*.py"):
        names = (m.split(".") for m in imported_modules(path))
        known |= {name[1] for name in names if name[0] == "handfit_core" and len(name) > 1}
    assert known <= set(ARROWS[room])


@pytest.mark.parametrize(
    ("word", "room"), [("JOINT_NAMES", "rigs"), ("bone_names", "rigs"), ("bpy.ops.export_", "exporters")]
)
def test_bones_and_formats_are_known_in_one_place(word: str, room: str) -> None:
    """Everything else asks a rig, or a format, whatever else is added to the two folders."""
    addon = ROOT / "blender_manient"
    knowing = {p.relative_to(addon).parts[0] for p in addon.rglob("*.py") if word in p.read_text("utf-8")}
    assert knowing == {room}


def test_light_half_is_light() -> None:
    code = (
        "import sys, handfit_core, handfit_core.take, handfit_core.hand_model, handfit_core.media.opening, "
        "handfit_core.solvers, handfit_core.pipeline, handfit_core.__main__\n"
        f"heavy = sorted(set({HEAVY!r}) & set(sys.modules))\n"
        "assert not heavy, heavy\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


def test_capturing_and_fitting_again_need_no_torch() -> None:
    """From pictures to a take, and from the take to a corrected range."""
    code = """
import sys
import numpy as np
from handfit_core import capture
from handfit_core.media.frame_range import FrameRange
from handfit_core.detect.keypoints import HandDetection
from handfit_core.edit import RefineHand, refit_each, refit_range, warm_up

take = capture("samples/rendered_hand/hand.%04d.jpg", frames=FrameRange(1, 6))
hand, = take.hands
points = np.concatenate([hand.keypoints_2d, hand.keypoints_depth[..., None]], axis=-1)
detections = tuple(HandDetection(hand.side, *one) for one in zip(hand.score, points, hand.world_landmarks))
pins = np.full((len(points), 21, 2), np.nan)
pins[2, 8] = hand.keypoints_2d[2, 8] + 10.0
rest = pins, hand.global_orient, hand.hand_pose, hand.transl, np.zeros(16, dtype=bool)
corrected = RefineHand(hand.side, hand.betas, take.intrinsics, detections, *rest)
warm_up()
for found in (refit_each(corrected), refit_range(corrected)):
    assert found.present.all()
assert "torch" not in sys.modules, "torch was imported"
"""
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
