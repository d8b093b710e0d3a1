"""The rendered benchmark's pictures show what its labels say."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs one of the bpy wheels")

from blender_manient.rigs.captured_hand import bone_names  # noqa: E402
from handfit_core.evaluate.datasets import plain  # noqa: E402
from handfit_core.hand_model import axes, load_model  # noqa: E402
from handfit_core.skeleton import KEYPOINT_SOURCE, NUM_JOINTS  # noqa: E402
from scripts.benchmark import drawing  # noqa: E402
from scripts.benchmark.clips import clip_shot  # noqa: E402
from scripts.benchmark.scene import build_scene  # noqa: E402
from scripts.benchmark.shots import Shot  # noqa: E402
from scripts.benchmark.stills import still_shot  # noqa: E402
from scripts.render_benchmark import main  # noqa: E402

SIZE = 96
TINY = f"--stills 1 --clips 1 --frames 2 --seed 3 --size {SIZE} --samples 1".split()
CLIP = clip_shot(0, 3, 4, SIZE)
ALL = ["clips/00/0000.jpg", "clips/00/0001.jpg", "stills/00000.jpg"]


@pytest.fixture(scope="module")
def rendered(tmp_path_factory) -> Path:
    """Three tiny pictures, made as a user makes them."""
    folder = tmp_path_factory.mktemp("benchmark")
    assert main([str(folder), *TINY]) == 0
    return folder


def jpegs(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.glob("**/*.jpg"))}


def to_camera(points: np.ndarray) -> np.ndarray:
    return points @ axes.WORLD_FROM_CAMERA


def drawn_vertices(rig) -> np.ndarray:
    """(V, 3) of the mesh as Blender evaluates it now, camera frame."""
    made = rig.mesh.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return to_camera(np.array([made.matrix_world @ vertex.co for vertex in made.data.vertices]))


def two_handed() -> Shot:
    """The first still with both hands."""
    return next(s for s in (still_shot(0, i, SIZE) for i in range(100)) if len(s.hands) == 2)


def test_index_lists_every_picture_with_its_labels(rendered: Path) -> None:
    index = json.loads((rendered / "index.json").read_text(encoding="utf-8"))
    assert index["fps"] == 25.0
    assert sorted(p["file"] for p in index["pictures"]) == ALL == sorted(jpegs(rendered))
    assert [p.get("clip") for p in index["pictures"]] == [None, "00", "00"]
    assert [p["time"] for p in index["pictures"]] == [0.0, 0.0, 0.04]
    found = plain.read(rendered)
    assert (len(found.entries), found.problems) == (3, ())
    assert all(hand.mesh for entry in found.entries for hand in entry.read_labels().hands)
    for picture in index["pictures"]:
        k = np.array(picture["K"])
        for hand in picture["hands"]:
            joints = np.array(hand["joints_3d_mm"])
            homogeneous = joints @ k.T
            np.testing.assert_allclose(
                homogeneous[:, :2] / homogeneous[:, 2:], hand["keypoints_2d_px"], atol=1e-3
            )
            model, mano = load_model(None, hand["hand"]), hand["mano"]
            assert mano["digest"] == model.digest
            parameters = [np.array(mano[n]) for n in ("betas", "global_orient", "hand_pose", "transl")]
            np.testing.assert_allclose(model.keypoints(*parameters) * 1000, joints, atol=1e-4)


@pytest.mark.parametrize("shot", [two_handed(), CLIP], ids=["two hands", "clip"])
def test_blender_holds_the_hands_where_the_labels_say(shot: Shot) -> None:
    built = build_scene(shot, 1)
    for picture in range(len(shot.files)):
        row = picture + shot.lead
        bpy.context.scene.frame_set(row)
        for hand, rig in zip(shot.hands, built.hands, strict=True):
            model = load_model(None, hand.side)
            expected = model.posed(hand.betas, hand.global_orient[row], hand.hand_pose[row], hand.transl[row])
            np.testing.assert_allclose(drawn_vertices(rig), expected.vertices, atol=1e-5)
            bones = rig.armature.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones
            heads = to_camera(np.array([bones[n].head for n in bone_names(hand.side)]))
            joints = hand.keypoints()[row]
            for keypoint, source in enumerate(KEYPOINT_SOURCE):
                if source < NUM_JOINTS:
                    np.testing.assert_allclose(heads[source], joints[keypoint], atol=1e-5)


def test_the_camera_projects_as_the_labels_do() -> None:
    """The hands' silhouette, rendered over nothing, spans what the labels' mesh projects to."""
    shot = two_handed()
    built = build_scene(shot, 1)
    scene = bpy.context.scene
    for thing in list(scene.collection.all_objects):
        if thing.type == "MESH" and thing not in [rig.mesh for rig in built.hands]:
            bpy.data.objects.remove(thing)
    scene.render.film_transparent = True
    scene.render.image_settings.color_mode = "RGBA"
    scene.cycles.samples = 16
    scene.cycles.use_denoising = False
    built.camera.data.dof.use_dof = False
    path = Path(bpy.app.tempdir) / "silhouette.png"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path))
    alpha = np.array(image.pixels[:]).reshape(SIZE, SIZE, 4)[::-1, :, 3]
    rows, columns = np.nonzero(alpha > 0.4)
    posed = [
        load_model(None, h.side).posed(h.betas, h.global_orient[0], h.hand_pose[0], h.transl[0])
        for h in shot.hands
    ]
    pixels = shot.camera.project(np.concatenate([hand.vertices for hand in posed]))
    low, high = np.maximum(pixels.min(axis=0), 0), np.minimum(pixels.max(axis=0), SIZE)
    assert np.ptp(rows) > SIZE // 5
    # The last row and column end one pixel further.
    np.testing.assert_allclose([columns.min(), rows.min()], low, atol=1.5)
    np.testing.assert_allclose([columns.max() + 1, rows.max() + 1], high, atol=1.5)


def test_clips_blur_about_the_labelled_moment() -> None:
    build_scene(CLIP, 1)
    render = bpy.context.scene.render
    assert render.use_motion_blur
    assert render.motion_blur_shutter == 0.5
    assert render.motion_blur_position == "CENTER"


def test_same_seed_same_bytes(rendered: Path, tmp_path: Path) -> None:
    assert main([str(tmp_path), *TINY]) == 0
    assert jpegs(tmp_path) == jpegs(rendered)
    assert (tmp_path / "index.json").read_bytes() == (rendered / "index.json").read_bytes()


def test_pictures_that_are_there_are_kept(rendered: Path) -> None:
    before = {p: p.stat().st_mtime_ns for p in rendered.glob("**/*.jpg")}
    lost = rendered / "stills" / "00000.jpg"
    content = lost.read_bytes()
    lost.unlink()
    assert main([str(rendered), *TINY]) == 0
    after = {p: p.stat().st_mtime_ns for p in rendered.glob("**/*.jpg")}
    assert {p for p in before if before[p] != after[p]} == {lost}
    assert lost.read_bytes() == content


def test_an_interrupted_run_keeps_what_is_done_and_goes_on(
    rendered: Path, tmp_path, monkeypatch, capsys
) -> None:
    draw = drawing.draw

    def draw_then_ctrl_c(*args) -> None:
        draw(*args)
        signal.raise_signal(signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    monkeypatch.setattr(drawing, "draw", draw_then_ctrl_c)
    assert main([str(tmp_path), *TINY]) == 130
    assert signal.getsignal(signal.SIGINT) is before
    assert "stopped" in capsys.readouterr().out
    assert list(jpegs(tmp_path)) == ["stills/00000.jpg"]
    assert len(json.loads((tmp_path / "index.json").read_text(encoding="utf-8"))["pictures"]) == 1
    monkeypatch.undo()
    assert main([str(tmp_path), *TINY]) == 0
    assert jpegs(tmp_path) == jpegs(rendered)


def test_refuses_other_settings(rendered: Path, capsys) -> None:
    before = jpegs(rendered)
    assert main([str(rendered), *TINY, "--seed", "4"]) == 2
    assert "choose another folder" in capsys.readouterr().err
    assert jpegs(rendered) == before


@pytest.mark.parametrize("wrong", [["--size", "8"], ["--samples", "0"]])
def test_wrong_options_are_told(tmp_path: Path, capsys, wrong: list[str]) -> None:
    assert main([str(tmp_path), *TINY, *wrong]) == 2
    assert wrong[0] in capsys.readouterr().err
    assert jpegs(tmp_path) == {}
