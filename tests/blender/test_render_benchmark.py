"""The rendered benchmark's pictures show what its labels say."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy", reason="needs one of the bpy wheels")

from handfit_core.evaluate.datasets import plain  # noqa: E402
from handfit_core.hand_model import axes, load_model  # noqa: E402
from scripts.benchmark import drawing  # noqa: E402
from scripts.benchmark.clips import clip_shot  # noqa: E402
from scripts.benchmark.scene import build_scene  # noqa: E402
from scripts.benchmark.shots import Shot  # noqa: E402
from scripts.benchmark.stills import still_shot  # noqa: E402
from scripts.render_benchmark import main  # noqa: E402

from .conftest import evaluated_vertices, joint_heads  # noqa: E402

SIZE = 96
TINY = f"--stills 1 --clips 1 --pairs 1 --frames 2 --seed 3 --size {SIZE} --samples 1".split()
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


def two_handed() -> Shot:
    """The first still with both hands."""
    return next(s for s in (still_shot(0, i, SIZE) for i in range(100)) if len(s.hands) == 2)


def test_index_lists_every_picture_with_its_labels(rendered: Path) -> None:
    index = json.loads((rendered / "index.json").read_text(encoding="utf-8"))
    assert index["fps"] == 25.0
    pairs = [f"pairs/clip0_{view}/{number:04d}.jpg" for view in "ab" for number in (1, 2)]
    assert sorted(p["file"] for p in index["pictures"]) == ALL
    assert sorted(jpegs(rendered)) == [*ALL[:2], *pairs, ALL[2]]
    assert [clip["clip"] for clip in json.loads((rendered / "pairs/gt.json").read_bytes())] == ["clip0"]
    assert [p.get("clip") for p in index["pictures"]] == [None, "00", "00"]
    assert [p["time"] for p in index["pictures"]] == [0.0, 0.0, 0.04]
    found = plain.read(rendered)
    assert (len(found.entries), found.problems) == (3, ())
    assert all(hand.mesh for entry in found.entries for hand in entry.read_labels().hands)
    for picture in index["pictures"]:
        for hand in picture["hands"]:
            joints, mano = np.array(hand["joints_3d_mm"]), hand["mano"]
            projected = joints @ np.array(picture["K"]).T
            keypoints = projected[:, :2] / projected[:, 2:]
            np.testing.assert_allclose(keypoints, hand["keypoints_2d_px"], atol=1e-3)
            model = load_model(None, hand["hand"])
            assert mano["digest"] == model.digest
            parameters = [np.array(mano[n]) for n in ("betas", "global_orient", "hand_pose", "transl")]
            np.testing.assert_allclose(model.keypoints(*parameters) * 1000, joints, atol=1e-4)


@pytest.mark.parametrize("shot", [two_handed(), CLIP], ids=["two hands", "clip"])
def test_blender_holds_the_hands_where_the_labels_say(shot: Shot) -> None:
    """Clips blur about the labelled moment."""
    built, render = build_scene(shot, 1), bpy.context.scene.render
    if shot is CLIP:
        assert render.use_motion_blur
        assert (render.motion_blur_shutter, render.motion_blur_position) == (0.5, "CENTER")
    for row in range(shot.lead, shot.lead + len(shot.files)):
        bpy.context.scene.frame_set(row)
        for hand, rig in zip(shot.hands, built.hands, strict=True):
            model = load_model(None, hand.side)
            posed = model.posed(hand.betas, hand.global_orient[row], hand.hand_pose[row], hand.transl[row])
            found = evaluated_vertices(rig.mesh) @ axes.WORLD_FROM_CAMERA
            np.testing.assert_allclose(found, posed.vertices, atol=1e-5)
            heads = joint_heads(rig.armature, hand.side) @ axes.WORLD_FROM_CAMERA
            np.testing.assert_allclose(heads, posed.joints, atol=1e-5)
            labels = hand.keypoints()[row]
            np.testing.assert_allclose(labels, posed.keypoints, atol=1e-5)


def test_an_interrupted_run_goes_on_and_same_seed_is_same_bytes(
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
    (first,) = jpegs(tmp_path)
    assert first == "stills/00000.jpg"
    assert len(json.loads((tmp_path / "index.json").read_text(encoding="utf-8"))["pictures"]) == 1
    monkeypatch.undo()
    kept = (tmp_path / first).stat().st_mtime_ns
    assert main([str(tmp_path), *TINY]) == 0
    assert (tmp_path / first).stat().st_mtime_ns == kept
    assert jpegs(tmp_path) == jpegs(rendered)
    assert (tmp_path / "index.json").read_bytes() == (rendered / "index.json").read_bytes()


@pytest.mark.parametrize(
    ("wrong", "said"), [("--size 8", "--size"), ("--samples 0", "--samples"), ("--seed 4", "another folder")]
)
def test_wrong_or_other_options_are_told(rendered: Path, capsys, wrong: str, said: str) -> None:
    before = jpegs(rendered)
    assert main([str(rendered), *TINY, *wrong.split()]) == 2
    assert said in capsys.readouterr().err
    assert jpegs(rendered) == before
