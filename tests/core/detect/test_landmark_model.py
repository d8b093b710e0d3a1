import hashlib
import io
import logging
import struct
import tarfile
import zipfile
from dataclasses import replace
from pathlib import Path

import pytest

from handfit_core.detect import landmark_model
from handfit_core.detect.landmark_model import is_calibrated
from handfit_core.errors import LandmarkModelError


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HANDFIT_CACHE", str(tmp_path / "cache"))
    for name in (landmark_model.TASK.variable, landmark_model.NETWORK_2020.variable):
        monkeypatch.delenv(name, raising=False)
    return tmp_path / "cache"


def test_missing_file_says_what_to_do(empty_cache: Path) -> None:
    with pytest.raises(LandmarkModelError, match=r"fetch_landmark_model.py"):
        landmark_model.landmark_model_path()
    with pytest.raises(LandmarkModelError, match=r"no such landmark model"):
        landmark_model.landmark_model_path(empty_cache / "x.task")


def test_order_of_places(empty_cache: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    cached = empty_cache / landmark_model.TASK.name
    cached.parent.mkdir(parents=True)
    cached.write_bytes(b"a")
    assert landmark_model.landmark_model_path() == cached
    named = tmp_path / "named.task"
    named.write_bytes(b"b")
    monkeypatch.setenv("HANDFIT_LANDMARK_MODEL", str(named))
    assert landmark_model.landmark_model_path() == named
    assert landmark_model.landmark_model_path(cached) == cached


def test_another_wheel_is_refused(tmp_path: Path) -> None:
    wheel = tmp_path / "mediapipe.whl"
    wheel.write_bytes(b"something else")
    with pytest.raises(LandmarkModelError, match="sha256"):
        landmark_model.assemble(wheel, tmp_path / "out.task")
    assert not (tmp_path / "out.task").exists()
    with pytest.raises(LandmarkModelError, match="cannot be read"):
        landmark_model.assemble(tmp_path / "gone.whl", tmp_path / "out.task")


def imitation_wheel(path: Path) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as wheel:
        for i, (_, member) in enumerate(landmark_model.TASK.entries):
            wheel.writestr(member, bytes([i]) * (1001 + i))
    return path


def test_entries_are_stored_aligned_and_reproducible(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wheel = imitation_wheel(tmp_path / "a.whl")
    monkeypatch.setattr(
        landmark_model,
        "TASK",
        replace(landmark_model.TASK, wheel_sha256=hashlib.sha256(wheel.read_bytes()).hexdigest()),
    )
    task = landmark_model.assemble(wheel, tmp_path / "one.task")
    again = landmark_model.assemble(wheel, tmp_path / "two.task")
    assert task.read_bytes() == again.read_bytes()
    data = task.read_bytes()
    with zipfile.ZipFile(task) as archive:
        assert [i.filename for i in archive.infolist()] == [name for name, _ in landmark_model.TASK.entries]
        for i, info in enumerate(archive.infolist()):
            assert info.compress_type == zipfile.ZIP_STORED
            name_length, extra_length = struct.unpack_from("<HH", data, info.header_offset + 26)
            start = info.header_offset + 30 + name_length + extra_length
            assert start % 4 == 0
            assert data[start : start + 1001 + i] == bytes([i]) * (1001 + i)


def test_networks_are_known_by_their_bytes(landmark_model: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(landmark_model) as task:
        networks = {name: task.read(name) for name in task.namelist()}
    palms, hand = networks

    def zipped(changed: dict[str, bytes]) -> Path:
        with zipfile.ZipFile(path := tmp_path / "other.task", "w", zipfile.ZIP_DEFLATED) as task:
            for name, content in changed.items():
                task.writestr(name, content)
        return path

    assert is_calibrated(landmark_model)
    assert is_calibrated(zipped(networks | {"more.txt": b"more"}))
    assert not is_calibrated(zipped(networks | {hand: networks[hand][:-1] + b"!"}))
    assert not is_calibrated(zipped({palms: networks[hand], hand: networks[palms]}))
    assert not is_calibrated(zipped({hand: networks[hand]}))
    (damaged := tmp_path / "damaged.task").write_bytes(landmark_model.read_bytes()[:100_000])
    assert not is_calibrated(damaged)


def test_damaged_file_is_one_line(tmp_path: Path) -> None:
    from handfit_core.detect.detector import DetectorSettings
    from handfit_core.detect.mediapipe_tasks import MediaPipeHands

    broken = tmp_path / "broken.task"
    broken.write_bytes(b"PK nonsense")
    with pytest.raises(LandmarkModelError, match="assemble it again") as caught:
        MediaPipeHands(DetectorSettings(landmark_model=broken))
    assert "\n" not in str(caught.value)


def imitation_package(path: Path, content: bytes, member: str = landmark_model.NETWORK_2020.member) -> Path:
    """A .tgz as npm makes it, whose packed assets are so many zeros as the network has before it, then
    `content`."""
    data = bytes(landmark_model.NETWORK_2020.within.start) + content
    with tarfile.open(path, "w:gz", compresslevel=1) as package:
        info = tarfile.TarInfo(member)
        info.size = len(data)
        package.addfile(info, io.BytesIO(data))
    return path


def test_the_network_of_2020_is_cut_out_of_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    network = b"n" * len(landmark_model.NETWORK_2020.within)
    monkeypatch.setattr(
        landmark_model,
        "NETWORK_2020",
        replace(landmark_model.NETWORK_2020, within_sha256=hashlib.sha256(network).hexdigest()),
    )
    monkeypatch.setattr(landmark_model, "with_image_metadata", lambda found, *_: b"metadata" + found)
    package = imitation_package(tmp_path / "hands.tgz", network + b"what comes after it")
    made = landmark_model.assemble_2020(package, tmp_path / "new" / "network.tflite")
    assert made.read_bytes() == b"metadata" + network


def test_another_package_is_refused(tmp_path: Path) -> None:
    good = imitation_package(tmp_path / "hands.tgz", b"another version")
    torn = tmp_path / "torn.tgz"
    torn.write_bytes(good.read_bytes()[:2000])
    text = tmp_path / "text.tgz"
    text.write_bytes(b"<html>not found</html>")
    of_another = imitation_package(tmp_path / "another.tgz", b"", member="package/index.js")
    for package, said in (
        (good, "sha256 is .* download it again"),
        (torn, "cannot be read as npm's @mediapipe/hands"),
        (text, "cannot be read as npm's @mediapipe/hands"),
        (tmp_path / "gone.tgz", "cannot be read as .*No such file"),
        (tmp_path, "cannot be read as "),
        (of_another, r"this is not npm's @mediapipe/hands 0\.1\.1606863095"),
    ):
        with pytest.raises(LandmarkModelError, match=said) as caught:
            landmark_model.assemble_2020(package, tmp_path / "out.tflite")
        assert "\n" not in str(caught.value)
    assert not (tmp_path / "out.tflite").exists()


def test_where_the_network_of_2020_is_sought(
    empty_cache: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    assert landmark_model.landmarks_2020_path() is None
    monkeypatch.setattr(
        landmark_model,
        "NETWORK_2020",
        replace(landmark_model.NETWORK_2020, sha256=hashlib.sha256(b"network").hexdigest()),
    )
    empty_cache.mkdir()
    for path in (landmark_model.cached_path_2020(), empty_cache / "named"):
        path.write_bytes(b"network")
    assert landmark_model.landmarks_2020_path() == landmark_model.cached_path_2020()
    monkeypatch.setenv("HANDFIT_LANDMARKS_2020", str(empty_cache / "named"))
    assert landmark_model.landmarks_2020_path() == empty_cache / "named"
    monkeypatch.setenv("HANDFIT_LANDMARKS_2020", "none")
    assert landmark_model.landmarks_2020_path() is None
    assert not caplog.records


@pytest.mark.parametrize("kind", ["damaged", "of another version", "a folder", "named in vain"])
def test_a_network_of_2020_that_is_not_whole_is_one_warning(
    kind: str, empty_cache: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    path = landmark_model.cached_path_2020()
    path.parent.mkdir(parents=True)
    if kind in ("a folder", "named in vain"):
        path = empty_cache / "named"
        monkeypatch.setenv("HANDFIT_LANDMARKS_2020", str(path))
    if kind == "a folder":
        path.mkdir()
    elif kind != "named in vain":
        path.write_bytes(b"" if kind == "damaged" else b"TFL3" * 1000)
    assert landmark_model.landmarks_2020_path() is None
    assert landmark_model.landmarks_2020_path() is None
    (record,) = caplog.records
    assert record.levelno == logging.WARNING
    said = record.getMessage()
    assert said.startswith(f"{path}: it ")
    assert "fetch_landmark_model.py" in said
    assert "\n" not in said


def test_the_fingerprint_names_the_network_of_2020(
    empty_cache: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    pytest.importorskip("mediapipe")
    first = tmp_path / "hand_landmarker.task"
    first.write_bytes(b"both networks")
    without = landmark_model.fingerprint(first)
    monkeypatch.setattr(
        landmark_model,
        "NETWORK_2020",
        replace(landmark_model.NETWORK_2020, sha256=hashlib.sha256(b"network").hexdigest()),
    )
    empty_cache.mkdir()
    landmark_model.cached_path_2020().write_bytes(b"network")
    assert landmark_model.fingerprint(first) not in ("", without)
    monkeypatch.setenv("HANDFIT_LANDMARKS_2020", "none")
    assert landmark_model.fingerprint(first) == without
