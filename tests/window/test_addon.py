"""The add-on in a window: it comes and goes, and imports takes."""

from __future__ import annotations

import pytest

from tests.window.blender_window import ROOT

TAKE = ROOT / "samples" / "rendered_hand" / "truth.take.npz"


@pytest.mark.usefixtures("screenshots")
def test_disabling_leaves_nothing_behind(blender):
    left = blender.play("addon.disabled_leaves_nothing", take=TAKE).value
    assert left == [{}, {}, {}]


def test_reloading_scripts_brings_everything_back_once(blender):
    before, after = blender.play("addon.survives_reloading_scripts", take=TAKE).value
    assert after == before


def test_the_folder_of_plug_ins_is_opened_from_the_preferences(blender, tmp_path):
    played = blender.play("addon.the_plug_in_folder_is_opened", desktop=tmp_path).value
    assert played == {"folders": ["exporters", "rigs"], "opened": True}


def test_a_take_is_imported_from_the_menu_and_undone_by_keys(blender):
    assert blender.play("import_take.through_the_file_browser", take=TAKE).value == [1, 0, 1]


def test_quitting_leaves_no_process(own_blender):
    own_blender.play("addon.survives_reloading_scripts", take=TAKE)
    assert own_blender.quit() == []
