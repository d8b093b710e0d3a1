"""What is chosen once: preferences, MANO's files, the cache, the worker, and the options of a capture."""

from __future__ import annotations

import argparse
import os
import shutil
import time

import bpy
import numpy as np
import pytest

import blender_manient
from blender_manient.batch.arguments import add_arguments
from blender_manient.common import preferences
from blender_manient.operators import housekeeping
from blender_manient.operators.base import finish
from blender_manient.operators.capture import new_request
from blender_manient.panels.advanced import MANIENT_PT_advanced
from blender_manient.session import cache, details, shared_worker
from handfit_core.capturing.options import OPTIONS, CaptureOptions
from handfit_core.common.errors import HandfitError, OutputError
from tests.conftest import ROOT
from tests.drawn import drawn
from tests.waiting import alive, pid_of, wait_for

from .conftest import READY, write_png


@pytest.fixture
def entry():
    """The add-on's entry in Blender's preferences, as after enabling it."""
    addon = bpy.context.preferences.addons.new()
    addon.module = preferences.ADDON
    blender_manient.register()
    yield addon
    blender_manient.unregister()
    for left in [a for a in bpy.context.preferences.addons if a.module == preferences.ADDON]:
        bpy.context.preferences.addons.remove(left)


def test_the_default_quality_is_for_scenes_without_one(entry):
    bpy.context.scene.manient.preset = "PAPER"
    other = bpy.data.scenes.new("Other")
    entry.preferences.default_preset = "DRAFT"
    assert bpy.context.scene.manient.preset == "PAPER"
    assert other.manient.preset == "DRAFT"
    bpy.ops.wm.read_homefile(use_empty=True)
    assert bpy.context.scene.manient.preset == "DRAFT"


def test_the_defaults_are_those_of_the_entry_and_end_with_the_addon(entry):
    defaults = vars(preferences._defaults())
    names = {p.identifier for p in entry.preferences.bl_rna.properties} - {"rna_type", "bl_idname"}
    assert {name: getattr(entry.preferences, name) for name in names} == defaults
    assert type(entry.preferences).bl_idname == "blender_manient"
    entry.preferences.python = "/my/python"
    assert preferences.get(bpy.context).python == "/my/python"
    bpy.context.preferences.addons.remove(entry)
    preferences.get().threads = 5
    blender_manient.unregister()
    assert preferences.get().threads == 0
    blender_manient.register()


# MANO


def checked(path) -> list[tuple[bool, str]]:
    assert bpy.ops.manient.check_mano(path=str(path)) == {"FINISHED"}
    return [(r.ok, r.sentence) for r in housekeeping.results(str(path))]


def test_mano_files_are_checked_side_by_side(registered, imitation_mano, tmp_path):
    with pytest.raises(RuntimeError, match="No MANO files are chosen"):
        bpy.ops.manient.check_mano()
    good = checked(imitation_mano)
    assert [ok for ok, _ in good] == [True, True]
    assert "778 vertices" in good[0][1]
    for side in ("RIGHT", "LEFT"):
        shutil.copy(imitation_mano / "MANO_RIGHT.npz", tmp_path / f"MANO_{side}.npz")
    wrong, right = sorted(checked(tmp_path))
    assert (wrong[0], right[0]) == (False, True)
    assert "this is a right hand" in wrong[1]
    for name in ("MANO_RIGHT.npz", "MANO_LEFT.npz"):
        (tmp_path / name).unlink()
    (tmp_path / "MANO_LEFT.pkl").write_text("no model")
    results = checked(tmp_path)
    assert [ok for ok, _ in results] == [False, False]
    for said in ("MANO_LEFT.pkl", "has no MANO_RIGHT"):
        assert any(said in sentence for _, sentence in results)
    assert not any("Traceback" in sentence for _, sentence in results)
    bpy.context.scene.manient.model_path = str(imitation_mano)
    bpy.ops.manient.check_mano()
    assert housekeeping.results(str(imitation_mano))
    assert not housekeeping.results(str(tmp_path)), "of another path nothing is said"


# The cache


def test_the_cache_is_ours_in_the_chosen_folder_or_in_the_users(registered, tmp_path, monkeypatch):
    assert cache.cache_folder() == tmp_path / "cache" / "manient"
    assert cache.cache_folder().is_dir()
    preferences.get().cache_folder = ""
    monkeypatch.setenv("HANDFIT_CACHE", str(tmp_path / "of the user"))
    assert cache.cache_folder() == tmp_path / "of the user" / "manient"


def test_clear_removes_only_what_is_ours_and_what_no_file_shows(registered, tmp_path, monkeypatch):
    monkeypatch.setenv("HANDFIT_CACHE", str(tmp_path / "core"))
    plates = tmp_path / "core" / "plates"
    plates.mkdir(parents=True)
    (plates / "copy.jpg").write_bytes(b"x" * 300)
    chosen = tmp_path / "cache"
    chosen.mkdir()
    (chosen / "thesis.txt").write_text("years of work")
    cache.temporary_take().write_bytes(b"x" * 1000)
    (cache.cache_folder() / "still.png").write_bytes(b"x" * 500)
    assert cache.shown_size() == 1800
    shared_worker.worker().submit("check")
    assert not bpy.ops.manient.clear_cache.poll()
    shared_worker.stop()
    assert bpy.ops.manient.clear_cache() == {"FINISHED"}
    assert (chosen / "thesis.txt").exists()
    assert cache.shown_size() == 0
    assert not cache.folder_path().exists()
    assert not plates.exists()
    assert cache.temporary_take().parent.is_dir()  # it comes back when it is needed
    shown = write_png(cache.cache_folder() / "shown.png", np.ones((4, 4, 4), dtype=np.float32))
    bpy.data.images.load(str(shown))
    (cache.cache_folder() / "other.png").write_bytes(b"x")
    assert cache.clear() == (1, 1)
    assert [path.name for path in cache.cache_folder().iterdir()] == ["shown.png"]


# The worker that all share, and the takes that it writes


PEER = f"""{READY}
for line in sys.stdin:
    if answers:
        print(json.dumps({{"event": "done", "id": json.loads(line)["id"]}}), flush=True)
"""


def test_one_worker_until_the_preferences_change_and_it_is_free(registered, peer):
    assert shared_worker.current() is None
    preferences.get().python = peer(f"answers = True{PEER}")
    worker = shared_worker.worker()
    request = worker.submit("warm")
    preferences.get().threads = 2
    assert shared_worker.worker() is worker
    wait_for(worker, request, timeout=20)
    other = shared_worker.worker()
    assert other is not worker
    assert shared_worker.current() is other
    assert not alive(worker)


TELLS = f"""{READY}
for line in sys.stdin:
    asked = json.loads(line)
    told = [dict(event="warning", message="it is dark", offer="")]
    told += [dict(event="progress", stage="detect", view=1, done=2, total=8)]
    told += [dict(event="warning", message="another hand is likely", offer="find_hands")]
    told += [dict(event="done", said=5)] if asked["request"] == "probe" else []
    why = dict(event="error", message="no room", details="Traceback")
    told += [why | dict(type=asked["request"])] if asked["request"][0].isupper() else []
    for event in told if "id" in asked else ():
        print(json.dumps({{"id": asked["id"], **event}}), flush=True)
"""


def test_a_request_tells_how_far_it_is_and_is_cancelled_where_nobody_waits(registered, peer):
    preferences.get().python = peer(TELLS)
    abandoned = shared_worker.ask("capture", "Looking")
    while not next(abandoned).offer:
        time.sleep(0.005)
    abandoned.close()
    assert not shared_worker.worker().busy
    asking, told, answer = shared_worker.ask("probe", "Looking"), [], None
    while answer is None:
        try:
            told.append(next(asking))
        except StopIteration as stop:
            answer = stop.value
    assert answer["said"] == 5
    assert (str(told[0]), told[0].stage_text()) == ("Looking  0 s", "Looking")
    assert told[-1].warnings == ("another hand is likely", "it is dark"), "that with an offer is the first"
    assert (told[-1].offer, told[-1].part, str(told[-1])) == ("find_hands", 0.25, "Looking  2/8")
    assert told[-1].stage_text(views=2) == "Finding hands, view 2  2/8"
    for kind, is_written in (("Cancelled", False), ("OutputError", True)):
        with pytest.raises(HandfitError, match="no room"):
            finish(shared_worker.ask(kind, "Looking"))
        assert (details.local_text(details.TEXT_NAME) is not None) == is_written


def test_unregister_ends_it_and_its_files(peer, tmp_path):
    blender_manient.register()
    preferences.get().cache_folder = str(tmp_path / "cache")
    preferences.get().python = peer(f"answers = False{PEER}")
    worker = shared_worker.worker()
    worker.submit("warm")
    pid = pid_of(worker)
    take = cache.temporary_take("a photo.jpg")
    take.write_bytes(b"x")
    blender_manient.unregister()
    with pytest.raises(ProcessLookupError):  # already: Blender may be about to remove the files that it runs
        os.kill(pid, 0)
    assert list((tmp_path / "cache").iterdir()) == []
    assert shared_worker.current() is None


def test_the_panel_offers_the_plug_ins_that_the_worker_tells_of(registered, peer):
    settings = bpy.context.scene.manient
    assert not {"solver", "detector"} & set(drawn(MANIENT_PT_advanced).said.split())
    preferences.get().python = peer(f"answers = True{PEER}")
    worker = shared_worker.worker()
    wait_for(worker, worker.submit("warm"), timeout=20)
    assert {"solver", "detector"} <= set(drawn(MANIENT_PT_advanced).said.split())
    assert [shared_worker.detectors(), shared_worker.solvers()] == [
        ["mediapipe", "bright-spot"],
        ["fast", "flat"],  # the paper's experiments are chosen as such
    ]
    settings.source = str(ROOT / "samples" / "rendered_hand" / "hand.0001.jpg")
    assert {"solver", "detector"}.isdisjoint(new_request(bpy.context, only_frame=False).options.to_message())
    settings.detector, settings.solver = "bright-spot", "flat"
    options = new_request(bpy.context, only_frame=False).options
    assert (options.detector, options.solver) == ("bright-spot", "flat")
    shared_worker.stop()
    assert {"solver", "detector"} <= set(drawn(MANIENT_PT_advanced).said.split()), "to change back"


def test_takes_have_names_of_their_own_and_those_of_a_crashed_blender_go(registered):
    folder = cache.cache_folder()
    old, recent = folder / "takes-old", folder / "takes-recent"
    for path in (old, recent):
        path.mkdir()
        (path / "a.take.npz").write_bytes(b"x")
    os.utime(old, (1, 1))
    first, second = cache.temporary_take("my clip.mp4"), cache.temporary_take("my clip.mp4")
    assert first != second
    assert first.name.endswith(".take.npz")
    assert folder in first.parents
    assert (first.parent.is_dir(), old.exists(), recent.exists()) == (True, False, True)


def test_no_room_or_no_folder_is_one_sentence(registered, tmp_path):
    with pytest.raises(OutputError, match=r"full.*MB free.*preferences"):
        cache.temporary_take(needed=1 << 60)
    (tmp_path / "file").write_text("in the way")
    preferences.get().cache_folder = str(tmp_path / "file")
    with pytest.raises(OutputError, match=r"cannot write here.*preferences"):
        cache.temporary_take()


# The options of a capture against the core's table


@pytest.mark.parametrize(("name", "units"), [("smoothing", 1.0), ("threshold", 1.0), ("hand_length", 100.0)])
def test_what_a_property_takes_its_option_takes(registered, name, units):
    settings, option = bpy.context.scene.manient, OPTIONS[name]
    shown = settings.bl_rna.properties[name]
    for value in (shown.hard_min, shown.hard_max):
        setattr(settings, name, value)
        assert option.least <= option.read(getattr(settings, name) / units) <= option.most


def test_the_panel_has_the_hands_to_choose_from_and_a_batch_every_option(registered):
    shown = bpy.context.scene.manient.bl_rna.properties["hands"]
    assert [item.identifier for item in shown.enum_items] == list(OPTIONS["hands"].choices())
    assert shown.default == CaptureOptions.hands
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    assert {option.flag for option in OPTIONS.values()} <= set(parser._option_string_actions)
