"""The shared worker, and the folder for the takes that it writes."""

from __future__ import annotations

import os

import bpy
import pytest

import blender_manient
from blender_manient.common import preferences
from blender_manient.operators.capture import new_job
from blender_manient.panels.capture import MANIENT_PT_capture_advanced
from blender_manient.session import cache, shared_worker
from handfit_core.errors import OutputError
from tests.conftest import ROOT
from tests.drawn import drawn

from .conftest import READY

PEER = f"""{READY}
for line in sys.stdin:
    if answers:
        print(json.dumps({{"event": "done", "id": json.loads(line)["id"]}}), flush=True)
"""


def test_one_worker_until_the_preferences_change(registered):
    assert shared_worker.current() is None
    worker = shared_worker.worker()
    assert shared_worker.worker() is worker
    preferences.get().threads = 2
    other = shared_worker.worker()
    assert other is not worker
    assert shared_worker.current() is other


def test_a_busy_worker_is_not_replaced(registered, peer):
    preferences.get().python = peer(f"answers = True{PEER}")
    worker = shared_worker.worker()
    request = worker.submit("warm")
    preferences.get().threads = 2
    assert shared_worker.worker() is worker
    worker.wait(request, timeout=20)
    assert shared_worker.worker() is not worker
    assert not worker.alive


def test_unregister_ends_it_and_its_files(peer, tmp_path):
    blender_manient.register()
    preferences.get().cache_folder = str(tmp_path / "cache")
    preferences.get().python = peer(f"answers = False{PEER}")
    worker = shared_worker.worker()
    worker.submit("warm")
    pid = worker.pid
    assert pid is not None
    take = cache.temporary_take("a photo.jpg")
    take.write_bytes(b"x")
    blender_manient.unregister()
    with pytest.raises(ProcessLookupError):  # already: Blender may be about to remove the files that it runs
        os.kill(pid, 0)
    assert list((tmp_path / "cache").iterdir()) == []
    assert shared_worker.current() is None


def test_the_panel_offers_the_plug_ins_that_the_worker_tells_of(registered, peer):
    settings = bpy.context.scene.manient
    assert not {"solver", "detector"} & set(drawn(MANIENT_PT_capture_advanced).said.split())
    preferences.get().python = peer(f"answers = True{PEER}")
    worker = shared_worker.worker()
    worker.wait(worker.submit("warm"), timeout=20)
    assert {"solver", "detector"} <= set(drawn(MANIENT_PT_capture_advanced).said.split())
    assert [shared_worker.detectors(), shared_worker.solvers()] == [
        ["mediapipe", "bright-spot"],
        ["fast", "flat"],  # the paper's experiments are chosen as such
    ]
    settings.source = str(ROOT / "samples" / "rendered_hand" / "hand.0001.jpg")
    assert {"solver", "detector"}.isdisjoint(new_job(bpy.context, only_frame=False).options.to_message())
    settings.detector, settings.solver = "bright-spot", "flat"
    options = new_job(bpy.context, only_frame=False).options
    assert (options.detector, options.solver) == ("bright-spot", "flat")
    shared_worker.stop()
    assert {"solver", "detector"} <= set(drawn(MANIENT_PT_capture_advanced).said.split()), "to change back"


def test_takes_have_names_of_their_own(registered, tmp_path):
    first, second = cache.temporary_take("my clip.mp4"), cache.temporary_take("my clip.mp4")
    assert first != second
    assert first.parent.is_dir()
    assert first.name.endswith(".take.npz")
    assert cache.cache_folder() in first.parents


def test_a_full_disk_is_one_sentence(registered):
    with pytest.raises(OutputError, match=r"full.*MB free.*preferences"):
        cache.temporary_take(needed=1 << 60)


def test_a_folder_that_cannot_be_written_is_one_sentence(registered, tmp_path):
    (tmp_path / "file").write_text("in the way")
    preferences.get().cache_folder = str(tmp_path / "file")
    with pytest.raises(OutputError, match=r"cannot write here.*preferences"):
        cache.temporary_take()


def test_takes_of_a_crashed_blender_go(registered):
    folder = cache.cache_folder()
    old, recent = folder / "takes-old", folder / "takes-recent"
    for path in (old, recent):
        path.mkdir()
        (path / "a.take.npz").write_bytes(b"x")
    os.utime(old, (1, 1))
    cache.temporary_take()
    assert not old.exists()
    assert recent.exists()
