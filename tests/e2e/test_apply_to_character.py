"""A batch whose takes go onto a character, as its users run it; results are looked at by other processes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("bpy", reason="needs one of the bpy wheels")

from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.media.source import Source
from handfit_core.skeleton import FINGER_JOINTS, FINGERS, PARENTS, SIDES, Side
from handfit_core.take import Take
from tests.core.interchange.humanoids import Played, named
from tests.takes import take_of, track_of

from .character_child import bone_names

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "scripts" / "batch_fit.py"
CHILD = Path(__file__).with_name("character_child.py")
NUMBERS = np.arange(3, 11)
UNSEEN = 4
"""Row in which the right hand was not detected"""


@pytest.fixture
def hero(in_blender, tmp_path) -> Path:
    path = tmp_path / "characters" / "hero.blend"
    path.parent.mkdir()
    done = in_blender(CHILD, "make", path)
    assert path.is_file(), done.stdout + done.stderr
    return path


@pytest.fixture
def look(in_blender):
    """look(result) -> what a fresh Blender finds in it in the take's frames."""

    def found(path: Path, fps: int = 30) -> dict:
        done = in_blender(CHILD, "look", path, fps, *NUMBERS)
        told = [line for line in done.stdout.splitlines() if line.startswith("FOUND")]
        assert told, done.stdout + done.stderr
        return json.loads(told[0].removeprefix("FOUND"))

    return found


def take(sides: tuple[Side, ...] = SIDES, **fields) -> Take:
    """Hands whose fingers all move, each in its own way; the right one is not seen in one frame."""
    camera, rng = Intrinsics.assumed(320, 240), np.random.default_rng(3)
    rows = np.linspace(0.0, 1.0, len(NUMBERS))
    tracks = []
    for side in sides:
        orient = rng.normal(size=3) * (0.5 + rows[:, None])
        pose = rng.normal(scale=0.3, size=45) * rows[:, None] + rng.normal(scale=0.2, size=45)
        place = np.array([0.0, 0.0, 0.6]) + 0.1 * rows[:, None]
        detected = np.ones(len(rows), dtype=bool)
        detected[UNSEEN] = side == "left"
        blank = {}
        if side == "right":
            blank = {"detected": detected, "score": np.where(detected, 0.9, 0.0)}
        tracks.append(track_of(side, orient, pose, place, camera, **blank))
    source = Source("video", ("/nowhere/clip.mp4",))
    return take_of(tracks, camera, 320, 240, source=source, fps=30.0, frame_numbers=NUMBERS, **fields)


def report(folder: Path) -> list[dict]:
    return json.loads((folder / "report.json").read_text(encoding="utf-8"))["inputs"]


def _palm(points: np.ndarray) -> np.ndarray:
    along = points[4] - points[0]
    along /= np.linalg.norm(along)
    toward = points[1] - points[7]
    toward = toward - along * (along @ toward)
    toward /= np.linalg.norm(toward)
    return np.stack([along, toward, np.cross(along, toward)], axis=-1)


def _directions(points: np.ndarray) -> np.ndarray:
    """(10, 3) where two segments of each finger point, in the axes of their palm, from joints (16, 3)."""
    found = []
    for finger in FINGERS:
        first, second, third = FINGER_JOINTS[finger]
        for a, b in ((first, second), (second, third)):
            found.append((points[b] - points[a]) @ _palm(points))
    return np.array(found) / np.linalg.norm(found, axis=-1, keepdims=True)


def captured(of: Take, number: int, row: int) -> np.ndarray:
    """(10, 3) as `_directions`: what a hand of a take does, by its rotations alone."""
    track = of.hands[number]
    joints = load_model("open-hand", track.side).shaped(track.betas).joints
    turns = np.concatenate([np.eye(3)[None], rotvec_to_rotmat(track.hand_pose[row].reshape(15, 3))])
    points = joints.copy()
    for joint in range(1, 16):
        above = PARENTS[joint]
        points[joint] = points[above] + turns[above] @ (joints[joint] - joints[above])
        turns[joint] = turns[above] @ turns[joint]
    return _directions(points)


def character(found: dict, side: Side, frame: int) -> np.ndarray:
    """(10, 3) as `_directions`: what a character's hand does."""
    heads = found["shown"][str(frame)]["heads"]
    heads = {name.replace(":", "_"): head for name, head in heads.items()}  # USD has no colons
    return _directions(np.array([heads[bone_names(side)[joint].replace(":", "_")] for joint in range(16)]))


def worst(a: np.ndarray, b: np.ndarray) -> float:
    """degrees"""
    return float(np.degrees(np.arccos(np.clip(np.sum(a * b, axis=-1), -1.0, 1.0))).max())


def seen(side: Side) -> list[int]:
    """Rows in which a hand was detected."""
    return [row for row in range(len(NUMBERS)) if side == "left" or row != UNSEEN]


def test_a_character_comes_out_with_the_motion(request, in_blender, hero, look, tmp_path):
    clip, before = take(), hero.read_bytes()
    endings = [".blend", ".glb", ".fbx", ".bvh"]
    if "wheel" in request.node.name:  # Debian's build has neither
        endings += [".usdc", ".abc"]
    clip.save(tmp_path / "clip.take.npz")
    out = tmp_path / "out"
    formats = ",".join([*(ending[1:] for ending in endings), "vrma"]).replace("usdc", "usd")
    options = ("--apply-to", hero, "--format", formats, "--no-contacts", "--no-sheet")
    done = in_blender(SCRIPT, "clip.take.npz", "-o", out, *options)
    assert done.returncode == 0, done.stdout + done.stderr
    (entry,) = report(out)
    assert entry["status"] == "ok"
    assert entry["warnings"] == []
    rig = {"rig": "Mixamo", "bones": 15, "frames": 8, "tips_apart": 0.0}
    hands = [{"side": side, "captured": number, **rig} for number, side in enumerate(SIDES, start=1)]
    assert entry["character"] == {"armature": "Hero", "hands": hands}
    files = ["clip.take.npz", *(f"clip{ending}" for ending in [*endings, ".vrma"])]
    assert entry["files"] == [f"clip/{name}" for name in files]
    assert sorted(p.name for p in (out / "clip").iterdir()) == sorted(
        [*files, "clip.json", "clip.export.json"]
    )
    assert hero.read_bytes() == before

    blend = look(out / "clip" / "clip.blend")
    assert blend["range"] == [3, 10, 30.0]
    assert blend["objects"] == ["Cage", "Eye", "Hero", "Place", "Prop", "Skin"]
    assert blend["armatures"] == 1, "nothing of the captured hands is in it"
    assert blend["texts"] == ["kept.txt"], "all of the character's file is"
    assert len(blend["tracks"]) == 1, "its own action goes on below the new one"
    played = Played((out / "clip" / "clip.vrma").read_bytes())
    for number, side in enumerate(SIDES):
        for row in seen(side):
            points = named(played.places(row / 30.0), side)[:16]
            assert worst(_directions(points), captured(clip, number, row)) < 0.1, (".vrma", side, row)
    for ending in endings:
        found = look(out / "clip" / f"clip{ending}")
        if ending != ".abc":  # the skin alone
            for number, side in enumerate(SIDES):
                for row in seen(side):
                    error = worst(character(found, side, NUMBERS[row]), captured(clip, number, row))
                    assert error < 0.1, (ending, side, row)
        if ending in (".blend", ".bvh"):
            continue
        assert any("Eye" in name for name in found["objects"]), (ending, found["objects"])
        assert not {"Cage", "Prop"} & set(found["objects"])
        for frame in map(str, NUMBERS):
            ours, theirs = (
                np.array(blend["shown"][frame]["points"]),
                np.array(found["shown"][frame]["points"]),
            )
            apart = np.linalg.norm(ours[:, None] - theirs[None], axis=-1)
            assert apart.min(axis=1).max() < 1e-4, f"it nods and stands as in the .blend ({ending}, {frame})"
