"""The panel Character in the window: recognised, changed by mouse, applied, undone, saved."""

from __future__ import annotations

import json

import numpy as np

from handfit_core.interchange.writers import writer_for
from handfit_core.take import Take

FRAMES = 100


def test_motion_on_a_rigify_character(blender, make_long_take, tmp_path):
    seen = blender.play(
        "character.applied", take=make_long_take(FRAMES), blend=tmp_path / "character.blend", timeout=400
    ).value
    own, other = "f_ring.03.L", "f_pinky.02.L"
    assert seen["recognised"] == ["DEF-hand.L", own]
    assert seen["changed"] == other
    keyed = [f"{name}.0{i}.{s}" for s in "LR" for name in NAMES for i in (1, 2, 3)]
    assert seen["keyed"] == sorted(set(keyed) - {own})
    # The clip of 25 frames per second is retimed to the scene's 24.
    keys = 4 * (1 + (FRAMES - 1) * 24 // 25) * len(seen["keyed"])
    # Applied; two undos, of the motion and of the table; two redos; saved and opened again.
    assert seen["keys"] == [keys, 0, 0, 0, keys, keys]
    assert seen["kept"] == [own, other, other, own, other, other, other]
    applied, opened = seen["pose"]
    assert applied == opened
    assert min(applied[1:]) > 0.1


def test_a_bodys_hands_go_onto_a_rigify_character_and_out_to_avatars(blender, make_long_take, tmp_path):
    source, vrma, fbx = (tmp_path / f"walk.{ending}" for ending in ("smplx.npz", "vrma", "fbx"))
    writer_for(source).write(Take.load(make_long_take(FRAMES)), source)
    seen = blender.play("character.of_another_program", source=source, vrma=vrma, fbx=fbx, timeout=400).value
    assert [(hand["side"], hand["frames"], hand["detected"]) for hand in seen["captured"]] == [
        ("left", FRAMES, FRAMES),
        ("right", FRAMES, FRAMES),
    ]
    assert seen["keys"] == 4 * FRAMES * 30
    assert min(seen["turns"][1:]) > 0.05
    content = vrma.read_bytes()
    assert content[:4] == b"glTF"
    assert b"VRMC_vrm_animation" in content
    content = fbx.read_bytes()
    assert b"DEF-f_index.01.L" in content
    assert b"ORG-" not in content


def test_what_keeps_a_character_from_motion_is_said(blender, make_long_take, tmp_path):
    preset = tmp_path / "rigify.json"
    edited, mirrored = blender.play(
        "character.refused", take=make_long_take(FRAMES), preset=preset, timeout=400
    ).value
    assert "This character is in Edit Mode: leave it first" in edited[0]
    assert "This character has a negative scale" in mirrored[0]
    assert edited[1] == mirrored[1] == 0
    assert [hand["side"] for hand in json.loads(preset.read_text(encoding="utf-8"))] == ["left", "right"]


def test_a_hands_travel_and_offset_are_changed_after_its_motion_was_applied(blender, make_long_take):
    seen = blender.play("character.moved", take=make_long_take(FRAMES), timeout=400).value
    assert seen["marked"] == 30
    assert seen["active"] == "rig left hand offset"
    whole, half, dragged, undone, redone = (np.array(places) for places in seen["places"])
    assert np.abs(whole - whole[0]).max() > 0.01
    np.testing.assert_allclose(half - half[0], 0.5 * (whole - whole[0]), atol=1e-3)
    np.testing.assert_allclose(half[0], whole[0], atol=1e-3)
    np.testing.assert_allclose(dragged, half + [0.3, 0.0, 0.0], atol=1e-3)
    np.testing.assert_allclose(undone, half, atol=1e-3)
    np.testing.assert_allclose(redone, dragged, atol=1e-3)


def test_a_character_follows_a_drag_by_the_live_link(blender, make_clip):
    played = blender.play("character.linked", source=make_clip(60), timeout=300).value
    assert played["trouble"] is None
    assert played["behind"] < 0.02
    assert {28, 30, 32} <= set(played["moved"]) <= {28, 30, 32}
    assert played["off"] < 1e-3


NAMES = ("thumb", "f_index", "f_middle", "f_ring", "f_pinky")
