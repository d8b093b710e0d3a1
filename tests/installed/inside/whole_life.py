"""The extension from its installation to its end, in a Blender that has nothing else; asserts as it goes."""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import shutil
import socket
import sys
import time
from pathlib import Path
from types import ModuleType
from typing import Any

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))

from drawn import drawn
from traces import traces

REPOSITORY = "user_default"
NAME = f"bl_ext.{REPOSITORY}.manient"
PROFILE = Path(os.environ["BLENDER_USER_RESOURCES"]) / "extensions"
HEAVY = ("scipy", "cv2", "mediapipe", "av")
"""What captures, and must never be loaded by Blender's own process"""
OPEN_HAND_VERTICES = 1810
LAST = 40
"""frame of the video up to which it is captured"""


def main() -> None:
    """Stage by stage."""
    asked = json.loads(Path(sys.argv[-1]).read_text(encoding="utf-8"))
    nothing_but_blender_is_in_reach(asked)
    before = traces()
    install(asked["zip"])
    panels_say()
    check_finds_all_well()
    photo(asked["photo"])
    video(asked["video"])
    worker_has_what_blender_unpacked()
    refitted()
    exported(Path(asked["made"]))
    blender_stays_light()
    gone("disabled", bpy.ops.preferences.addon_disable, before, module=NAME)
    finished(bpy.ops.preferences.addon_enable, module=NAME)
    empty_file()
    photo(asked["photo"])
    repositories = [repo.module for repo in bpy.context.preferences.extensions.repos]
    index = repositories.index(REPOSITORY)
    gone("uninstalled", bpy.ops.extensions.package_uninstall, before, repo_index=index, pkg_id="manient")
    assert enabled() == []
    if bpy.app.version < (5, 0):
        # As a Python module 4.2 crashes at its end after any export to glTF, and 4.5 may hang there.
        shutil.rmtree(bpy.app.tempdir, ignore_errors=True)
        sys.stdout.flush()
        os._exit(0)


def nothing_but_blender_is_in_reach(asked: dict[str, Any]) -> None:
    """No network, no module that only the zip may bring, no setting of this machine, no checkout."""
    assert [name for _, name in socket.if_nameindex()] == ["lo"]
    try:
        socket.create_connection(("192.0.2.1", 80), timeout=2.0)
        raise AssertionError("the network is there")
    except OSError:
        pass
    for name in (*HEAVY, "handfit_core", "blender_manient"):
        assert importlib.util.find_spec(name) is None, name
    assert set(os.environ) <= set(asked["variables"]), sorted(os.environ)
    environment = Path(sys.executable).parents[1]
    for path in map(Path, sys.path):
        assert path.is_relative_to(environment) or not path.is_relative_to(asked["root"]), path


def install(file: str) -> None:
    """Install a zip and enable it, as dropping it onto Blender's window does."""
    import addon_utils  # which Blender brings: bpy must be imported before

    if not addon_utils.check("bl_pkg")[1]:
        addon_utils.enable("bl_pkg", default_set=True)
    install_files = bpy.ops.extensions.package_install_files
    finished(install_files, filepath=file, repo=REPOSITORY, enable_on_install=True)
    assert enabled() == [NAME]


def panels_say() -> None:
    """The sections of our tab say what to do first."""
    said = {}
    for section in bpy.types.Panel.__subclasses__():
        if getattr(section, "bl_category", "") == "Hand Capture" and section.is_registered:
            said[section.bl_label] = drawn(section).said
    assert said.keys() == {"Capture", "Advanced", "Live"}
    assert said["Capture"].startswith("Choose a photo or a clip "), said
    assert said["Capture"].endswith(" Capture"), said


def check_finds_all_well() -> None:
    """Check Installation."""
    finished(bpy.ops.manient.check_installation)
    report = bpy.data.texts["Hand Capture Check"].as_string()
    assert report.startswith("Everything works\n"), report
    assert all(f"\n{name} " in report for name in HEAVY), report


def photo(source: str) -> None:
    """A photo becomes a hand in its picture."""
    found, keys = captured(source)
    track, scene = found.track, bpy.context.scene
    assert (found.side, found.take.frame_numbers.tolist(), track.detected.sum()) == ("left", [1], 1)
    assert 0.5 < track.reprojection_error.max() < 15.0  # pixels, in a picture of 640
    assert len(found.mesh.data.vertices) == OPEN_HAND_VERTICES
    assert (len(hand().pose.bones), keys) == (16, [1.0])
    assert behind(found) == ("thumb_up.jpg", 640, 521)
    assert (scene.render.resolution_x, scene.render.resolution_y) == (640, 521)
    assert scene.camera is not None


def video(source: str) -> None:
    """A range of a video becomes keys in a scene of its rate."""
    empty_file()
    found, keys = captured(source, use_frames=True, first_frame=1, last_frame=LAST)
    track, scene, frames = found.track, bpy.context.scene, list(range(1, LAST + 1))
    assert (found.side, found.take.frame_numbers.tolist(), keys) == ("right", frames, frames)
    assert track.detected.all()
    assert (
        0.5 < track.reprojection_error.max() < 40.0
    )  # pixels, of the worst frame in a picture of 620 x 1080
    assert scene.render.fps / scene.render.fps_base == 25.0
    assert (scene.frame_start, scene.frame_end) == (1, LAST)
    assert behind(found) == ("asl_hand.mp4", 620, 1080)


def behind(found: Any) -> tuple[str, int, int]:
    """What a hand's camera shows behind it, and its size."""
    (picture,) = found.camera.data.background_images
    shown = picture.clip if picture.source == "MOVIE_CLIP" else picture.image
    return (shown.name, *shown.size)


def captured(source: str, **settings: Any) -> tuple[Any, list[float]]:
    """Capture as the panel does; the one hand, and the frames with keys."""
    panel = bpy.context.scene.manient
    panel.source = source
    for name, value in settings.items():
        setattr(panel, name, value)
    finished(bpy.ops.manient.capture)
    found = module("scene.store").hand_of(hand())
    return found, sorted(set(module("scene.keys").read_pose_keys(found.rig).frames.tolist()))


def refitted() -> None:
    """Ten frames once more, with a point put elsewhere."""
    bpy.context.scene.frame_set(12)
    before = [bone.matrix.copy() for bone in hand().pose.bones]
    refiner = module("session.refiner").Refiner(hand())
    x, y = refiner.keyed_poses([refiner.row_at(12)]).landmarks[0][8] + [30.0, -20.0]
    finished(bpy.ops.manient.move_keypoint, hand=hand().name, frame=12, keypoint=8, x=x, y=y)
    finished(bpy.ops.manient.refit_range, scope="CUSTOM", first=7, last=17)
    bpy.context.scene.frame_set(12)
    now = [bone.matrix.translation for bone in hand().pose.bones]
    moved = [(there - then.translation).length for there, then in zip(now, before, strict=True)]
    assert 0.002 < max(moved) < 0.1  # metres


def exported(folder: Path) -> None:
    """Files for other programs; that these read the same motion is tested in tests/blender."""
    for kind in ("fbx", "glb"):
        path = folder / f"hand.{kind}"
        finished(bpy.ops.manient.export_hand, filepath=str(path), file_format=kind)
        assert path.stat().st_size > 50_000
        assert b"MANO" not in path.read_bytes()


def worker_has_what_blender_unpacked() -> None:
    """The process that captures, as the system sees it. What it compiles goes with the extension, and does
    not lie beside what Blender has unpacked."""
    folder = Path("/proc") / str(worker())
    assert (folder / "cmdline").read_bytes().decode().split("\0")[0] == sys.executable
    lines = (folder / "environ").read_bytes().decode().split("\0")
    variables = dict(line.split("=", 1) for line in lines if "=" in line)
    compiled = Path(variables["PYTHONPYCACHEPREFIX"])
    assert compiled.is_relative_to(PROFILE / ".user" / REPOSITORY / "manient"), compiled
    assert len(list(compiled.rglob("scipy/**/*.pyc"))) > 100
    assert not list((PROFILE / ".local").rglob("scipy/**/*.pyc"))
    mapped = {line.split(maxsplit=5)[5] for line in (folder / "maps").read_text().splitlines() if "/" in line}
    for name in (*HEAVY, "numpy"):
        loaded = [path for path in mapped if f"/{name}/" in path and ".so" in path]
        home = Path(sys.executable).parents[1] if name == "numpy" else PROFILE / ".local"
        assert loaded, name
        assert all(Path(path).is_relative_to(home) for path in loaded), loaded


def blender_stays_light() -> None:
    """Blender's own process has loaded nothing heavy, and all of ours from the profile."""
    assert [name for name in HEAVY if name in sys.modules] == []
    assert Path(module().__file__) == PROFILE / REPOSITORY / "manient" / "__init__.py"
    assert Path(sys.modules["handfit_core"].__file__).is_relative_to(PROFILE / ".local")
    ours = {n: m for n, m in sys.modules.items() if "manient" in n or "handfit" in n}
    files = [Path(m.__file__) for m in ours.values() if getattr(m, "__file__", None)]
    assert [file for file in files if not file.is_relative_to(PROFILE)] == []


def gone(how: str, operator: Any, before: dict[str, list[str]], **arguments: Any) -> None:
    """Nothing is left in Blender, and no worker, once the add-on is disabled or uninstalled."""
    process = worker()
    finished(operator, **arguments)
    time.sleep(0.5)  # the worker is killed while it gives back memory
    assert traces() == before, how
    stat = Path("/proc") / str(process) / "stat"
    assert not stat.exists() or stat.read_text().rpartition(")")[2].split()[0] == "Z", how


def worker() -> int:
    """The process that captures."""
    return module("session.shared_worker").current().pid


def finished(operator: Any, **arguments: Any) -> None:
    """Run an operator, which must end well."""
    assert operator(**arguments) == {"FINISHED"}, operator


def module(name: str = "") -> ModuleType:
    """The installed add-on, or a module of it."""
    return importlib.import_module(".".join(filter(None, (NAME, name))))


def enabled() -> list[str]:
    """Names of our add-ons that are enabled."""
    return [name for name in bpy.context.preferences.addons.keys() if "manient" in name]  # noqa: SIM118


def empty_file() -> None:
    """Another file, with nothing in it; preferences stay."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)


def hand() -> bpy.types.Object:
    """The armature of the one captured hand, made active."""
    (found,) = module("scene.store").captured_hands(bpy.context.scene)
    bpy.context.view_layer.objects.active = found
    return found


main()
