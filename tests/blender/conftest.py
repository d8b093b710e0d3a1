"""Synthetic takes: plausible poses of a model, seen by a known camera, with everything a take has."""

from __future__ import annotations

import atexit
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs one of the bpy wheels")

import blender_manient  # noqa: E402
from blender_manient.common import preferences  # noqa: E402
from blender_manient.common.blender_versions import channels, first_slot  # noqa: E402
from blender_manient.rigs.captured_hand import bone_names  # noqa: E402
from blender_manient.scene.build import BuiltTake, build_take  # noqa: E402
from blender_manient.scene.store import CapturedHand, hand_of  # noqa: E402
from handfit_core.common.skeleton import FINGER_JOINTS, SIDES, Side  # noqa: E402
from handfit_core.common.version import __version__  # noqa: E402
from handfit_core.geometry.camera import Intrinsics  # noqa: E402
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat  # noqa: E402
from handfit_core.hand_model import HandModel, load_model, save_model_npz  # noqa: E402
from handfit_core.hand_model.forearm import with_wrist  # noqa: E402
from handfit_core.media.source import Source  # noqa: E402
from handfit_core.take import HandTrack, Take  # noqa: E402
from tests.imitation_mano import imitation_model  # noqa: E402
from tests.takes import found  # noqa: E402

FRAMES = np.array([3, 4, 5, 6, 7, 8, 12, 13, 14, 16, 17, 18])
"""Not consecutive, not from 1"""
UNSEEN = 4
"""Row in which no hand was detected"""
WIDTH, HEIGHT = 160, 120
OFF_CENTRE = Intrinsics(fx=210.0, fy=180.0, cx=70.0, cy=66.0)
"""fx != fy, and the principal point well off the middle"""


GENERATE = """
import os, sys, traceback
import bpy
import addon_utils  # which is there once bpy is
try:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    addon_utils.enable("rigify", default_set=True, persistent=True)  # only after the reset: else it breaks
    bpy.ops.object.armature_human_metarig_add()
    metarig = bpy.context.object
    metarig.pose.bones["f_index.01.L"].rigify_parameters.make_extra_ik_control = True
    import rigify.generate
    rigify.generate.generate_rig(bpy.context, metarig)
    bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1])
    code = 0
except BaseException:
    traceback.print_exc()
    code = 1
sys.stdout.flush()
sys.stderr.flush()
os._exit(code)  # a bpy that has seen an error may hang as it ends
"""


@pytest.fixture(autouse=True)
def empty_file():
    """Every test starts from an empty file and from factory preferences, which are slow to reset."""
    preferences = bpy.context.preferences
    if preferences.is_dirty:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        preferences.is_dirty = False
    else:
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)


@pytest.fixture
def registered(empty_file, tmp_path, monkeypatch):
    """The add-on, with its temporary files, and what it keeps, in folders of the test's."""
    monkeypatch.setenv("HANDFIT_DATA", str(tmp_path / "data"))
    blender_manient.register()
    preferences.get().cache_folder = str(tmp_path / "cache")
    yield
    blender_manient.unregister()


@pytest.fixture
def peer(tmp_path):
    """peer(code) -> an interpreter that runs this code, whatever it is asked to run."""
    if sys.platform == "win32":
        pytest.skip("misbehaving peers are scripts with a #! line")

    def make(code: str) -> str:
        path = tmp_path / "peer"
        connected = (
            "c = socket.socket(fileno=int(os.environ['HANDFIT_CONNECTION']))\n"
            "sys.stdin, sys.stdout = c.makefile('r'), c.makefile('w')\n"
        )
        path.write_text(f"#!{sys.executable}\nimport json, os, signal, socket, sys, time\n{connected}{code}")
        path.chmod(0o755)
        return str(path)

    return make


READY = f"""
ready = {{"event": "ready", "version": {__version__!r}, "pid": 1, "python": "3"}}
ready |= {{"detectors": ["mediapipe", "bright-spot"], "solvers": ["fast", "paper-a", "flat"]}}
print(json.dumps(ready), flush=True)
"""
"""What a peer says first, with plug-ins"""


@dataclass(frozen=True)
class Made:
    """A take and what it must look like in the camera frame, computed by the core."""

    take: Take
    vertices: dict[Side, np.ndarray]
    """side -> (T, V, 3) metres"""
    joints: dict[Side, np.ndarray]
    """side -> (T, 16, 3) metres"""

    @property
    def seen(self) -> list[tuple[int, int]]:
        """(row, frame number) of each frame with a detection."""
        rows = np.flatnonzero(self.take.hands[0].detected)
        return [(int(row), int(self.take.frame_numbers[row])) for row in rows]


@pytest.fixture(scope="session")
def picture(tmp_path_factory) -> Path:
    """A picture in which every pixel is different."""
    rows = np.zeros((HEIGHT, WIDTH, 4), dtype=np.float32)
    rows[..., 0] = np.linspace(0, 1, WIDTH)[None, :]
    rows[..., 1] = np.linspace(0, 1, HEIGHT)[:, None]
    rows[..., 2] = 0.25
    rows[..., 3] = 1.0
    return write_png(tmp_path_factory.mktemp("picture") / "photo of a hand.png", rows)


def write_png(path: Path, rows: np.ndarray) -> Path:
    """Write rows (H, W, 4) of values 0..1, the first row on top."""
    height, width = rows.shape[:2]
    image = bpy.data.images.new(path.stem, width, height, alpha=True)
    image.pixels.foreach_set(np.ascontiguousarray(rows[::-1], dtype=np.float32).ravel())
    image.filepath_raw = str(path)
    image.file_format = "PNG"
    image.save()
    bpy.data.images.remove(image)
    return path


def movie(path: Path, size: tuple[int, int] = (WIDTH, HEIGHT), rate: float = 30.0) -> Source:
    """A clip of 40 frames; frame n is as grey as 6 n, and black in its left tenth."""
    cv2 = pytest.importorskip("cv2")
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), rate, size)
    for number in range(1, 41):
        picture = np.full((*size[::-1], 3), number * 6, dtype=np.uint8)
        picture[:, : size[0] // 10] = 0
        writer.write(picture)
    writer.release()
    return Source("video", (str(path),))


@pytest.fixture(scope="session")
def imitation_mano(tmp_path_factory) -> Path:
    """A folder with an imitation of both MANO files: pose blend shapes, no UVs, triangles."""
    folder = tmp_path_factory.mktemp("mano")
    for side in SIDES:
        save_model_npz(imitation_model(side), folder / f"MANO_{side.upper()}.npz")
    return folder


@pytest.fixture(params=("open-hand", "imitation-mano"))
def model(request) -> str:
    """What a take names as its model: without and with pose blend shapes."""
    if request.param == "open-hand":
        return request.param
    return str(request.getfixturevalue("imitation_mano"))


@pytest.fixture(scope="session")
def generated(tmp_path_factory) -> Path:
    """A .blend with Rigify's human and the rig that this Blender's Rigify makes of it. The left index finger
    has IK, too. The processes of pytest-xdist share it: the first one to ask makes it."""
    folder = tmp_path_factory.getbasetemp()
    folder = folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder
    path, lock = folder / "rig.blend", folder / "rig.lock"
    try:
        lock.touch(exist_ok=False)
    except FileExistsError:
        end = time.monotonic() + 600
        while not path.exists() and time.monotonic() < end:
            time.sleep(0.2)
    else:
        command = [sys.executable, "-c", GENERATE, str(folder / "being made.blend")]
        done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
        assert done.returncode == 0, done.stderr[-3000:]
        (folder / "being made.blend").rename(path)
    return path


@pytest.fixture
def make_take(picture):
    """make_take(sides=..., model=..., **fields of Take) -> Made"""

    def make(sides: tuple[Side, ...] = SIDES, model: str = "open-hand", seed: int = 1, **fields) -> Made:
        rng = np.random.default_rng(seed)
        frames = fields.get("frame_numbers", FRAMES)
        intrinsics = fields.get("intrinsics", OFF_CENTRE)
        tracks, vertices, joints, digests = [], {}, {}, {}
        for side in sides:
            hand = built_model(model, side)
            track, posed = _track(hand, side, len(frames), intrinsics, rng)
            tracks.append(track)
            vertices[side], joints[side] = posed.vertices, posed.joints
            digests[side] = load_model(model, side).digest
        values = {
            "source": Source("photo", (str(picture),)),
            "fps": 30.0,
            "frame_numbers": frames,
            "width": WIDTH,
            "height": HEIGHT,
            "intrinsics": intrinsics,
            "solver": "paper-a",
            "model": model,
            "model_digests": digests,
            "hands": tuple(tracks),
        }
        return Made(Take(**{**values, **fields}), vertices, joints)

    return make


@pytest.fixture
def made(make_take) -> Made:
    """A take of one right hand."""
    return make_take(sides=("right",))


@pytest.fixture
def built(made) -> BuiltTake:
    """That hand, in a file of its own."""
    return build_take(made.take)


@pytest.fixture
def armature(built):
    """Its armature, active and selected."""
    return chosen(built.hands[0].armature)


@pytest.fixture
def hand(armature, registered) -> CapturedHand:
    """That hand with its take, active and selected."""
    return hand_of(armature)


def chosen(obj: bpy.types.Object) -> bpy.types.Object:
    """Make an object the only selected and the active one."""
    for other in bpy.context.selected_objects:
        other.select_set(False)
    bpy.context.view_layer.objects.active = obj
    obj.select_set(True)
    return obj


def built_model(model: str, side: Side) -> HandModel:
    """The model with the cap that hands are built with."""
    return with_wrist(load_model(model, side), "cap")


def _track(hand, side: Side, count: int, intrinsics: Intrinsics, rng: np.random.Generator):
    """A hand that turns through more than a full circle while its fingers open and close."""
    t = np.linspace(0.0, 1.0, count)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    turns = rotvec_to_rotmat(axis * (t[:, None] * 2.6 * np.pi))
    start = rotvec_to_rotmat(rng.normal(size=3))
    global_orient = rotmat_to_rotvec(turns @ start)

    sign = 1.0 if side == "right" else -1.0
    hand_pose = np.zeros((count, 15, 3))
    for finger, chain in FINGER_JOINTS.items():
        for i, joint in enumerate(chain):
            most = 0.5 if finger == "thumb" else (1.3, 1.5, 0.9)[i]
            bend = most * (0.5 + 0.5 * np.sin(2 * np.pi * (t + rng.uniform())))
            hand_pose[:, joint - 1, 2] = sign * bend
            if i == 0:
                hand_pose[:, joint - 1, 1] = rng.uniform(-0.25, 0.25)
                hand_pose[:, joint - 1, 0] = rng.uniform(-0.1, 0.1)
    hand_pose = hand_pose.reshape(count, 45)
    transl = np.stack([0.08 * np.sin(5 * t) * sign, 0.05 * np.cos(4 * t), 0.5 + 0.2 * t], axis=-1)
    betas = rng.normal(size=10)
    posed = hand.posed(betas, global_orient, hand_pose, transl)
    keypoints = intrinsics.project(posed.keypoints)
    noise = rng.normal(scale=0.7, size=keypoints.shape)

    detected = np.ones(count, dtype=bool)
    if count > UNSEEN:
        detected[UNSEEN] = False
    nan = np.where(detected, 1.0, np.nan)
    track = HandTrack(
        side=side,
        betas=betas,
        global_orient=global_orient * nan[:, None],
        hand_pose=hand_pose * nan[:, None],
        transl=transl * nan[:, None],
        joints_3d=posed.keypoints * nan[:, None, None],
        reprojection_error=np.linalg.norm(noise, axis=-1).mean(axis=-1) * nan,
        detections=found(side, keypoints + noise, detected),
    )
    return track, posed


def world(points: np.ndarray) -> np.ndarray:
    """Camera frame to Blender's world, written out: the capture camera looks along +Y, up is +Z."""
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)


def evaluated_vertices(obj) -> np.ndarray:
    """(V, 3) world positions after shape keys and modifiers, at the scene's current frame."""
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    points = np.empty((len(mesh.vertices), 3), dtype=np.float32)
    mesh.vertices.foreach_get("co", points.ravel())
    evaluated.to_mesh_clear()
    matrix = np.array(evaluated.matrix_world)
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def action_curves(action: bpy.types.Action) -> list[bpy.types.FCurve]:
    """All curves of an action, whose first slot is its only one."""
    return list(channels(action, first_slot(action)).fcurves)


def joint_heads(armature, side: Side) -> np.ndarray:
    """(16, 3) world positions of the bones' heads, at the scene's current frame."""
    armature = armature.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return np.array([armature.matrix_world @ armature.pose.bones[name].head for name in bone_names(side)])


def shown_bones(armature, frame: int | None = None):
    """The pose bones as they are shown, on a frame or now."""
    if frame is not None:
        bpy.context.scene.frame_set(int(frame))
    return armature.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones


def blocks() -> dict[str, list[str]]:
    """Names of all data-blocks of the file, by kind."""
    kinds = "objects collections armatures meshes actions cameras images lights materials scenes shape_keys"
    return {kind: sorted(getattr(bpy.data, kind).keys()) for kind in kinds.split()}


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """End before bpy does: as a module it crashes (4.2) or hangs (4.5) there once files were exported."""
    atexit.register(_end, session)


def _end(session: pytest.Session) -> None:
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(int(session.exitstatus))
