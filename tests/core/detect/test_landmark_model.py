import struct
import zipfile
from pathlib import Path

import pytest

from handfit_core.detect import landmark_model
from handfit_core.errors import LandmarkModelError


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HANDFIT_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("HANDFIT_LANDMARK_MODEL", raising=False)
    return tmp_path / "cache"


def test_missing_file_says_what_to_do(empty_cache: Path) -> None:
    with pytest.raises(LandmarkModelError, match=r"fetch_landmark_model.py"):
        landmark_model.landmark_model_path()
    with pytest.raises(LandmarkModelError, match=r"no such landmark model"):
        landmark_model.landmark_model_path(empty_cache / "x.task")


def test_order_of_places(empty_cache: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    cached = empty_cache / landmark_model.FILE_NAME
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
        for i, (_, member) in enumerate(landmark_model._ENTRIES):
            wheel.writestr(member, bytes([i]) * (1001 + i))
    return path


def test_entries_are_stored_aligned_and_reproducible(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wheel = imitation_wheel(tmp_path / "a.whl")
    import hashlib

    monkeypatch.setattr(landmark_model, "WHEEL_SHA256", hashlib.sha256(wheel.read_bytes()).hexdigest())
    task = landmark_model.assemble(wheel, tmp_path / "one.task")
    again = landmark_model.assemble(wheel, tmp_path / "two.task")
    assert task.read_bytes() == again.read_bytes()
    data = task.read_bytes()
    with zipfile.ZipFile(task) as archive:
        assert [i.filename for i in archive.infolist()] == [name for name, _ in landmark_model._ENTRIES]
        for i, info in enumerate(archive.infolist()):
            assert info.compress_type == zipfile.ZIP_STORED
            name_length, extra_length = struct.unpack_from("<HH", data, info.header_offset + 26)
            start = info.header_offset + 30 + name_length + extra_length
            assert start % 4 == 0
            assert data[start : start + 1001 + i] == bytes([i]) * (1001 + i)


def test_damaged_file_is_one_line(tmp_path: Path) -> None:
    from handfit_core.detect.detector import DetectorSettings
    from handfit_core.detect.mediapipe_tasks import MediaPipeHands

    broken = tmp_path / "broken.task"
    broken.write_bytes(b"PK nonsense")
    with pytest.raises(LandmarkModelError, match="assemble it again") as caught:
        MediaPipeHands(DetectorSettings(landmark_model=broken))
    assert "\n" not in str(caught.value)
