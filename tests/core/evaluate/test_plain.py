"""The plain folder form: what docs/data-sets.md promises, and what is wrong with an index named."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.common.errors import DatasetError
from handfit_core.evaluate.datasets import open_dataset
from handfit_core.evaluate.datasets.plain import save_index
from handfit_core.evaluate.rows import label_pixels
from handfit_core.hand_model import load_model
from tests.core.evaluate.dataset_files import K, hand, labels_of, pixels, reason, touch, write_json


def item(file: str = "a.jpg", seed: int = 0, **changes: Any) -> dict[str, Any]:
    points = hand(seed)
    whole = {
        "file": file,
        "hand": "left",
        "joints_3d_mm": (1000 * points).tolist(),
        "keypoints_2d_px": pixels(points).tolist(),
        "K": K,
    }
    return {key: value for key, value in (whole | changes).items() if value is not ...}


def write(root: Path, *items: Any, **whole: Any) -> Path:
    touch(*(root / i["file"] for i in items if isinstance(i, dict) and isinstance(i.get("file"), str)))
    write_json(root / "index.json", whole | {"pictures": list(items)} if whole else list(items))
    return root


def test_the_short_form(tmp_path: Path) -> None:
    dataset = open_dataset(write(tmp_path, item("b.jpg", 1), item("a.jpg", 2, hand=None)))
    assert (dataset.kind, dataset.name, dataset.problems) == ("plain", tmp_path.name, ())
    found = [(e.name, e.picture, e.clip, e.time) for e in dataset.entries]
    assert found == [(name, tmp_path / name, None, 0.0) for name in ("b.jpg", "a.jpg")]
    labels = dataset.entries[0].read_labels()
    (label,) = labels.hands
    assert label.side == "left"
    assert label.mesh is None
    np.testing.assert_allclose(label.joints_3d, hand(1), atol=1e-12)
    np.testing.assert_allclose(label.keypoints_2d, pixels(hand(1)), atol=1e-12)
    assert labels.intrinsics is not None
    assert labels.intrinsics.fx == 500.0
    assert dataset.entries[1].read_labels().hands[0].side is None


def test_the_long_form(tmp_path: Path) -> None:
    one, two = item(seed=1), item(seed=2, hand="right")
    hands = [{key: one[key] for key in ("hand", "joints_3d_mm")}, {"keypoints_2d_px": two["keypoints_2d_px"]}]
    both = {"file": "sub/c.png", "hands": hands, "K": K, "tags": {"pose": "fist", "prop": 3}}
    empty = {"file": "empty.png", "hands": [], "K": K}
    dataset = open_dataset(write(tmp_path, both, empty, name="Mine", notes=["Exact."], fps=50))
    assert (dataset.name, dataset.notes) == ("Mine", ("Exact.",))
    assert dataset.entries[0].tags == {"pose": "fist", "prop": "3"}
    labels = dataset.entries[0].read_labels()
    first, second = labels.hands
    # Joints and a camera give pixels; pixels alone give no joints.
    np.testing.assert_allclose(label_pixels(first, labels.intrinsics), pixels(hand(1)), atol=1e-9)
    assert second.side is None
    np.testing.assert_allclose(second.keypoints_2d, pixels(hand(2)), atol=1e-9)
    assert np.isnan(second.joints_3d).all()
    # A picture that shows no hand is a label too.
    assert dataset.entries[1].read_labels().hands == ()


def test_clips_stand_together_in_time(tmp_path: Path) -> None:
    items = [
        item("w0.png", clip="wave"),
        item("still.png"),
        item("p0.png", clip="point", time=0.5),
        item("w1.png", clip="wave"),
        item("p1.png", clip="point", time=0.25),
        item("gone.png", clip="wave"),
        item("w3.png", clip="wave"),
    ]
    root = write(tmp_path, *items, fps=10)
    (root / "gone.png").unlink()
    dataset = open_dataset(root)
    assert [(e.name, e.clip, e.time) for e in dataset.entries] == [
        ("w0.png", "wave", 0.0),
        ("w1.png", "wave", 0.1),
        ("w3.png", "wave", pytest.approx(0.3)),
        ("still.png", None, 0.0),
        ("p1.png", "point", 0.25),
        ("p0.png", "point", 0.5),
    ]
    default = open_dataset(write(tmp_path / "b", item("0.png", clip="c"), item("1.png", clip="c")))
    assert default.entries[1].time == 1 / 25


def test_missing_points_stay_missing(tmp_path: Path) -> None:
    gaps = item()
    gaps["joints_3d_mm"][4] = None
    gaps["joints_3d_mm"][8] = [1.0, None, 400.0]
    gaps["joints_3d_mm"][12] = [float("nan")] * 3
    gaps["keypoints_2d_px"][20] = None
    (label,) = open_dataset(write(tmp_path, gaps)).entries[0].read_labels().hands
    assert np.flatnonzero(np.isnan(label.joints_3d).all(axis=1)).tolist() == [4, 8, 12]
    assert np.flatnonzero(np.isnan(label.keypoints_2d).all(axis=1)).tolist() == [20]
    assert np.isnan(label.joints_3d).sum() == 9


def test_everything_that_cannot_be_used_is_reported(tmp_path: Path) -> None:
    items = [
        item("good.png"),
        item("gone.png"),
        item("good.png", 1),
        {"file": "bare.png", "K": K},
        item("no_camera.png", K=...),
        item("late.png", time="soon"),
        "a.jpg",
        {"hand": "left"},
    ]
    root = write(tmp_path / "set", *items)
    (root / "gone.png").unlink()
    touch(tmp_path / "outside.png")
    write_json(root / "index.json", [*items, item("../outside.png"), item(str(tmp_path / "outside.png"))])
    dataset = open_dataset(root)
    assert [e.name for e in dataset.entries] == ["good.png", "no_camera.png"]
    assert [(p.kind, Path(p.where).name.split(" (")[0]) for p in dataset.problems] == [
        ("picture missing", "gone.png"),
        ("listed twice", "good.png"),
        ("picture without a label", "bare.png"),
        ("camera (K) missing", "no_camera.png"),
        *(("index entry that cannot be read", f"index.json: picture {n}") for n in (6, 7, 8)),
        ("file outside the folder", "outside.png"),
        ("file outside the folder", "outside.png"),
    ]
    no_camera = dataset.entries[1].read_labels()
    assert no_camera.intrinsics is None
    np.testing.assert_allclose(no_camera.hands[0].keypoints_2d, pixels(hand()), atol=1e-9)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"hand": "Left"}, "hand is 'Left'; expected left, right or null"),
        ({"joints_3d_mm": [[1, 2, 3]] * 20}, "joints_3d_mm has shape (20, 3), expected (21, 3)"),
        ({"K": [[1, 2], [3, 4]]}, "K has shape (2, 2), expected (3, 3)"),
    ],
)
def test_a_damaged_label_is_told_when_read(tmp_path: Path, changes: dict[str, Any], says: str) -> None:
    entries = open_dataset(write(tmp_path, item("bad.png", **changes), item("good.png"))).entries
    assert entries[1].read_labels().hands
    assert says in reason(entries[0])


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("[{", "damaged, not readable as JSON"),
        ("7", "holds no list of pictures"),
    ],
)
def test_a_damaged_index(tmp_path: Path, content: str, says: str) -> None:
    (tmp_path / "index.json").write_text(content)
    with pytest.raises(DatasetError, match=says):
        open_dataset(tmp_path)


# Meshes


@pytest.mark.parametrize("side", ["left", "right"])
def test_parameters_of_the_open_hand_are_a_mesh(tmp_path: Path, side: Any) -> None:
    model = load_model(None, side)
    rng = np.random.default_rng(0)
    pose = {
        "betas": rng.normal(size=10),
        "global_orient": rng.normal(size=3),
        "hand_pose": 0.2 * rng.normal(size=45),
        "transl": np.array([0.0, 0.0, 0.5]),
    }
    posed = model.posed(**pose)
    entry = item(hand=side, joints_3d_mm=1000 * posed.keypoints, keypoints_2d_px=...)
    entry["mano"] = {"model": "open-hand", "digest": model.digest} | pose
    touch(tmp_path / "a.jpg")
    save_index(tmp_path, [entry], name="Rendered", notes=["Exact."], fps=25)
    dataset = open_dataset(tmp_path)
    assert (dataset.name, dataset.notes, dataset.problems) == ("Rendered", ("Exact.",), ())
    label, points = labels_of(dataset.entries[0])
    assert label.mesh is not None
    assert label.mesh.digests == {load_model(None, "left").digest, load_model(None, "right").digest}
    np.testing.assert_allclose(label.mesh.vertices(), posed.vertices, atol=1e-12)
    np.testing.assert_allclose(label.joints_3d, posed.keypoints, atol=1e-12)
    np.testing.assert_allclose(points, pixels(posed.keypoints), atol=1e-6)


@pytest.mark.parametrize("changes", [{"digest": "another"}, {"digest": ...}, {"model": "MANO_RIGHT"}])
def test_meshes_of_other_models_are_reported_and_left_out(tmp_path: Path, changes: dict[str, Any]) -> None:
    mano = {"model": "open-hand", "digest": load_model(None, "right").digest, "betas": [0] * 10} | changes
    mano = {key: value for key, value in mano.items() if value is not ...}
    dataset = open_dataset(write(tmp_path, item(hand="right", mano=mano)))
    assert [(p.kind, p.where) for p in dataset.problems] == [
        ("mesh of another hand model: not scored", "a.jpg")
    ]
    (label,) = dataset.entries[0].read_labels().hands
    assert label.mesh is None
    assert np.isfinite(label.joints_3d).all()


# Writing


def test_what_is_saved_reads_the_same(tmp_path: Path) -> None:
    joints = 1000 * hand()
    joints[3] = np.nan
    touch(tmp_path / "set" / "a.jpg")
    entry = item(clip="c", time=np.float64(0.5), joints_3d_mm=joints, keypoints_2d_px=...)
    path = save_index(tmp_path / "set", [entry], name="Müller's hands", notes=(), fps=30)
    assert "NaN" not in path.read_text(encoding="utf-8")
    dataset = open_dataset(tmp_path / "set")
    assert (dataset.name, dataset.entries[0].time) == ("Müller's hands", 0.5)
    np.testing.assert_allclose(dataset.entries[0].read_labels().hands[0].joints_3d, joints / 1000, atol=1e-12)
