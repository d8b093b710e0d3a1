"""Preferences: their defaults, the entry in Blender's own preferences, MANO's check, the cache."""

from __future__ import annotations

import shutil
from dataclasses import replace

import bpy
import numpy as np
import pytest

import blender_manient
from blender_manient.common import preferences
from blender_manient.operators import housekeeping
from blender_manient.panels.refine import MANIENT_PT_refine
from blender_manient.scene.build import build_take
from blender_manient.session import cache
from tests.blender.conftest import FRAMES, write_png
from tests.drawn import drawn


@pytest.fixture
def entry():
    """The add-on's entry in Blender's preferences, as after enabling it."""
    addon = bpy.context.preferences.addons.new()
    addon.module = preferences.ADDON
    blender_manient.register()
    yield addon
    blender_manient.unregister()
    bpy.context.preferences.addons.remove(addon)


def test_without_an_entry_the_defaults(registered):
    chosen = preferences.get()
    assert (chosen.mano_folder, chosen.python, chosen.threads) == ("", "", 0)
    assert (chosen.default_preset, chosen.drop_captures) == ("STANDARD", True)


def test_the_defaults_are_those_of_the_entry(entry):
    fields = {
        p.identifier
        for p in entry.preferences.bl_rna.properties
        if p.identifier not in ("rna_type", "bl_idname")
    }
    assert preferences.get() == entry.preferences
    assert fields == set(vars(preferences._defaults()))
    for name, value in vars(preferences._defaults()).items():
        assert getattr(entry.preferences, name) == value, name


def test_what_was_set_without_an_entry_ends_with_the_addon():
    blender_manient.register()
    preferences.get().threads = 5
    blender_manient.unregister()
    assert preferences.get().threads == 0


def test_the_entry_is_found_by_the_name_of_the_addon(entry):
    entry.preferences.python = "/my/python"
    assert preferences.get(bpy.context).python == "/my/python"
    assert type(entry.preferences).bl_idname == "blender_manient"


def test_the_default_quality_is_for_scenes_without_one(entry):
    bpy.context.scene.manient.preset = "PAPER"
    other = bpy.data.scenes.new("Other")
    entry.preferences.default_preset = "DRAFT"
    assert bpy.context.scene.manient.preset == "PAPER"
    assert other.manient.preset == "DRAFT"
    bpy.ops.wm.read_homefile(use_empty=True)
    assert bpy.context.scene.manient.preset == "DRAFT"


def test_how_opaque_the_hand_is_can_be_set_where_keypoints_are_edited(entry, make_take):
    take = make_take(sides=("right",)).take
    detected = {"keypoints_depth": np.zeros((len(FRAMES), 21)), "world_landmarks": take.hands[0].joints_3d}
    take = replace(take, hands=(replace(take.hands[0], **detected),))
    bpy.context.view_layer.objects.active = build_take(take).hands[0].armature
    assert "hand_opacity" in drawn(MANIENT_PT_refine).said
    assert 0.0 < entry.preferences.hand_opacity < 1.0, "the hand starts see-through"


# MANO


def checked(path) -> list[tuple[bool, str]]:
    assert bpy.ops.manient.check_mano(path=str(path)) == {"FINISHED"}
    return [(r.ok, r.sentence) for r in housekeeping.results(str(path))]


def test_good_files(registered, imitation_mano):
    results = checked(imitation_mano)
    assert [ok for ok, _ in results] == [True, True]
    assert "778 vertices" in results[0][1]


def test_the_wrong_side_is_named(registered, imitation_mano, tmp_path):
    shutil.copy(imitation_mano / "MANO_RIGHT.npz", tmp_path / "MANO_RIGHT.npz")
    shutil.copy(imitation_mano / "MANO_RIGHT.npz", tmp_path / "MANO_LEFT.npz")
    results = dict(zip(("right", "left"), sorted(checked(tmp_path), reverse=True), strict=True))
    assert results["right"][0]
    assert not results["left"][0]
    assert "this is a right hand" in results["left"][1]


def test_a_damaged_and_a_missing_file_are_named(registered, tmp_path):
    (tmp_path / "MANO_LEFT.pkl").write_text("no model")
    sentences = [sentence for ok, sentence in checked(tmp_path) if not ok]
    assert len(sentences) == 2
    assert any("MANO_LEFT.pkl" in s for s in sentences)
    assert any("has no MANO_RIGHT" in s for s in sentences)
    assert all("Traceback" not in s for s in sentences)


def test_the_paths_that_are_checked_by_themselves(registered, imitation_mano, tmp_path):
    with pytest.raises(RuntimeError, match="No MANO files are chosen"):
        bpy.ops.manient.check_mano()
    preferences.get().mano_folder = str(tmp_path)
    bpy.ops.manient.check_mano()
    assert housekeeping.results(str(tmp_path))
    bpy.context.scene.manient.model_path = str(imitation_mano)
    bpy.ops.manient.check_mano()
    assert housekeeping.results(str(imitation_mano))
    assert not housekeeping.results(str(tmp_path))  # of another path nothing is said


# The cache


def test_the_chosen_folder_gets_one_of_ours(registered, tmp_path):
    assert cache.cache_folder() == tmp_path / "cache" / "manient"
    assert cache.cache_folder().is_dir()


def test_without_a_choice_it_lies_in_the_users_cache(registered, tmp_path, monkeypatch):
    preferences.get().cache_folder = ""
    monkeypatch.setenv("HANDFIT_CACHE", str(tmp_path / "of the user"))
    assert cache.cache_folder() == tmp_path / "of the user" / "manient"


def test_clear_removes_only_what_is_ours(registered, tmp_path):
    chosen = tmp_path / "cache"
    chosen.mkdir()
    (chosen / "thesis.txt").write_text("years of work")
    take = cache.temporary_take()
    take.write_bytes(b"x" * 1000)
    (cache.cache_folder() / "still.png").write_bytes(b"x" * 500)
    assert cache.measure(cache.folder_path()) == 1500
    assert bpy.ops.manient.clear_cache() == {"FINISHED"}
    assert (chosen / "thesis.txt").exists()
    assert cache.measure(cache.folder_path()) == 0
    assert not cache.folder_path().exists()
    assert cache.temporary_take().parent.is_dir()  # it comes back when it is needed


def test_clear_keeps_pictures_that_the_file_shows(registered, picture):
    shown = write_png(cache.cache_folder() / "shown.png", np.ones((4, 4, 4), dtype=np.float32))
    bpy.data.images.load(str(shown))
    (cache.cache_folder() / "other.png").write_bytes(b"x")
    assert cache.clear() == (1, 1)
    assert [p.name for p in cache.cache_folder().iterdir()] == ["shown.png"]


def test_no_clearing_while_the_worker_writes(registered):
    from blender_manient.session import shared_worker

    shared_worker.worker().submit("check")
    assert not bpy.ops.manient.clear_cache.poll()
    shared_worker.stop()
    assert bpy.ops.manient.clear_cache.poll()


def test_the_size_that_is_shown(registered):
    for name in "abc":
        (cache.cache_folder() / f"{name}.png").write_bytes(b"x" * 500)
    assert cache.shown_size() == 1500
    bpy.ops.manient.clear_cache()
    assert cache.shown_size() == 0, "the old number is not shown any more"
