"""The landmark models' files: where they are sought, how they are assembled, and what is said of others."""

import hashlib
import io
import logging
import struct
import tarfile
import zipfile
from dataclasses import replace

import pytest

from handfit_core.common.errors import LandmarkModelError
from handfit_core.detect import landmark_model as module
from handfit_core.detect.detector import DetectorSettings
from handfit_core.detect.landmark_model import NETWORK_2020, TASK
from handfit_core.detect.mediapipe_tasks import MediaPipeHands
from handfit_core.detect.networks import Networks


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache, and a network of 2020 that is the bytes `network`."""
    monkeypatch.setenv("HANDFIT_CACHE", str(tmp_path / "cache"))
    for name in (TASK.variable, NETWORK_2020.variable):
        monkeypatch.delenv(name, raising=False)
    digest = hashlib.sha256(b"network").hexdigest()
    monkeypatch.setattr(module, "NETWORK_2020", replace(NETWORK_2020, sha256=digest))
    (tmp_path / "cache").mkdir()
    return tmp_path / "cache"


def test_order_of_places(cache, monkeypatch, tmp_path):
    with pytest.raises(LandmarkModelError, match=r"fetch_landmark_model.py"):
        module.landmark_model_path()
    with pytest.raises(LandmarkModelError, match=r"no such landmark model"):
        module.landmark_model_path(cache / "x.task")
    cached, named = cache / TASK.name, tmp_path / "named.task"
    for path in (cached, named):
        path.write_bytes(b"a")
    assert module.landmark_model_path() == cached
    monkeypatch.setenv("HANDFIT_LANDMARK_MODEL", str(named))
    assert module.landmark_model_path() == named
    assert module.landmark_model_path(cached) == cached


def test_entries_are_stored_aligned_and_reproducible(tmp_path, monkeypatch):
    wheel = tmp_path / "a.whl"
    with zipfile.ZipFile(wheel, "w", zipfile.ZIP_DEFLATED) as archive:
        for i, (_, member) in enumerate(TASK.entries):
            archive.writestr(member, bytes([i]) * (1001 + i))
    with pytest.raises(LandmarkModelError, match="sha256"):
        module.assemble(wheel, tmp_path / "out.task")
    assert not (tmp_path / "out.task").exists()
    with pytest.raises(LandmarkModelError, match="cannot be read"):
        module.assemble(tmp_path / "gone.whl", tmp_path / "out.task")
    digest = hashlib.sha256(wheel.read_bytes()).hexdigest()
    monkeypatch.setattr(module, "TASK", replace(TASK, wheel_sha256=digest))
    task = module.assemble(wheel, tmp_path / "one.task")
    data = task.read_bytes()
    assert data == module.assemble(wheel, tmp_path / "two.task").read_bytes()
    with zipfile.ZipFile(task) as archive:
        assert [i.filename for i in archive.infolist()] == [name for name, _ in TASK.entries]
        for i, info in enumerate(archive.infolist()):
            assert info.compress_type == zipfile.ZIP_STORED
            start = info.header_offset + 30 + sum(struct.unpack_from("<HH", data, info.header_offset + 26))
            assert start % 4 == 0
            assert data[start : start + 1001 + i] == bytes([i]) * (1001 + i)


def test_networks_are_known_by_their_bytes(landmark_model, tmp_path):
    with zipfile.ZipFile(landmark_model) as task:
        networks = {name: task.read(name) for name in task.namelist()}
    palms, hand = networks
    path = tmp_path / "other.task"
    for changed, calibrated in (
        (networks | {"more.txt": b"more"}, True),
        (networks | {hand: networks[hand][:-1] + b"!"}, False),
        ({palms: networks[hand], hand: networks[palms]}, False),
        ({hand: networks[hand]}, False),
    ):
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as task:
            for name, content in changed.items():
                task.writestr(name, content)
        assert module.is_calibrated(path) == calibrated
    assert module.is_calibrated(landmark_model)
    path.write_bytes(landmark_model.read_bytes()[:100_000])
    assert not module.is_calibrated(path)


@pytest.mark.parametrize("content", [b"", bytes(100_000)], ids=["empty", "zeros"])
def test_damaged_files_are_one_line(content, tmp_path):
    path = tmp_path / "damaged.task"
    path.write_bytes(content)
    for opened in (Networks, lambda path: MediaPipeHands(DetectorSettings(landmark_model=path))):
        with pytest.raises(LandmarkModelError, match=r"damaged\.task: .* --force") as caught:
            opened(path)
        assert "\n" not in str(caught.value)


def package(path, content, member=NETWORK_2020.member):
    """A .tgz as npm makes it, whose packed assets are so many zeros as the network has before it, then
    `content`."""
    data = bytes(NETWORK_2020.within.start) + content
    with tarfile.open(path, "w:gz", compresslevel=1) as archive:
        info = tarfile.TarInfo(member)
        info.size = len(data)
        archive.addfile(info, io.BytesIO(data))
    return path


def test_the_network_of_2020_is_cut_out_of_the_package(tmp_path, monkeypatch):
    network = b"n" * len(NETWORK_2020.within)
    digest = hashlib.sha256(network).hexdigest()
    monkeypatch.setattr(module, "NETWORK_2020", replace(NETWORK_2020, within_sha256=digest))
    monkeypatch.setattr(module, "with_image_metadata", lambda found, *_: b"metadata" + found)
    good = package(tmp_path / "hands.tgz", network + b"what comes after it")
    made = module.assemble_2020(good, tmp_path / "new" / "network.tflite")
    assert made.read_bytes() == b"metadata" + network


def test_another_package_is_refused(tmp_path):
    good = package(tmp_path / "hands.tgz", b"another version")
    torn = tmp_path / "torn.tgz"
    torn.write_bytes(good.read_bytes()[:2000])
    of_another = package(tmp_path / "another.tgz", b"", member="package/index.js")
    for path, said in (
        (good, "sha256 is .* download it again"),
        (torn, "cannot be read as npm's @mediapipe/hands"),
        (tmp_path / "gone.tgz", "cannot be read as .*No such file"),
        (of_another, r"this is not npm's @mediapipe/hands 0\.1\.1606863095"),
    ):
        with pytest.raises(LandmarkModelError, match=said) as caught:
            module.assemble_2020(path, tmp_path / "out.tflite")
        assert "\n" not in str(caught.value)
    assert not (tmp_path / "out.tflite").exists()


def test_where_the_network_of_2020_is_sought(cache, monkeypatch, caplog, tmp_path):
    """The model's fingerprint names it where it is there."""
    first = tmp_path / "hand_landmarker.task"
    first.write_bytes(b"both networks")
    assert module.landmarks_2020_path() is None
    without = module.fingerprint(first)
    for path in (module.cached_path(module.NETWORK_2020.name), cache / "named"):
        path.write_bytes(b"network")
    assert module.landmarks_2020_path() == module.cached_path(module.NETWORK_2020.name)
    assert module.fingerprint(first) not in ("", without)
    monkeypatch.setenv("HANDFIT_LANDMARKS_2020", str(cache / "named"))
    assert module.landmarks_2020_path() == cache / "named"
    monkeypatch.setenv("HANDFIT_LANDMARKS_2020", "none")
    assert module.landmarks_2020_path() is None
    assert module.fingerprint(first) == without
    assert not caplog.records


@pytest.mark.parametrize("kind", ["of another version", "a folder"])
def test_a_network_of_2020_that_is_not_whole_is_one_warning(kind, cache, monkeypatch, caplog):
    path = module.cached_path(module.NETWORK_2020.name)
    if kind == "a folder":
        path = cache / "named"
        monkeypatch.setenv("HANDFIT_LANDMARKS_2020", str(path))
        path.mkdir()
    else:
        path.write_bytes(b"TFL3" * 1000)
    assert [module.landmarks_2020_path(), module.landmarks_2020_path()] == [None, None]
    (record,) = caplog.records
    assert record.levelno == logging.WARNING
    said = record.getMessage()
    assert said.startswith(f"{path}: it ")
    assert "fetch_landmark_model.py" in said
    assert "\n" not in said
