"""Each reader of keypoints takes its own files, and no other reader takes them before it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from handfit_core.errors import HandfitError, InputError
from handfit_core.interchange.document import Document
from handfit_core.interchange.opening import read_recording
from handfit_core.interchange.readers import READERS, recognised
from handfit_core.options import CaptureOptions
from tests.core.interchange.every_format import keypoint_files, other_files


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Path]]:
    return keypoint_files(tmp_path_factory.mktemp("formats"))


def test_every_file_is_recognised_by_its_reader(files: dict[str, list[Path]], tmp_path: Path) -> None:
    every = files | other_files(tmp_path)
    assert set(every) == set(READERS.built_in())
    for kind, paths in every.items():
        for path in paths:
            assert recognised(Document(path))[0] == kind, path.name


def test_no_reader_but_the_last_takes_anothers_file(files: dict[str, list[Path]]) -> None:
    """MediaPipe's takes whatever names 21 points, and is asked when all others have said no."""
    readers = READERS.all()
    assert list(readers)[-1] == "mediapipe"
    for kind, paths in files.items():
        for path in paths:
            others = [
                n for n, reader in readers.items() if n != "mediapipe" and reader.recognises(Document(path))
            ]
            assert others == ([] if kind == "mediapipe" else [kind]), path.name


@pytest.mark.parametrize(
    ("name", "content"),
    [("a.json", b"[" + b"{}," * 5_000_000 + b"{}]"), ("a.csv", b"frame,x\n" + b"1,2\n" * 10_000_000)],
)
def test_texts_that_would_fill_the_memory_are_refused(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match="too large to be read at once; cut it into parts"):
        read_recording(tmp_path / name, CaptureOptions())


def test_no_such_users_folder_is_a_name() -> None:
    with pytest.raises(InputError, match="no such file or folder"):
        read_recording("~nobody-of-that-name/a.json", CaptureOptions())


def test_damaged_files_are_refused_in_one_sentence(files: dict[str, list[Path]], tmp_path: Path) -> None:
    """Bytes cut off, taken out and changed at random places, each time the same ones."""
    rng = np.random.default_rng(19)
    said = []
    for paths in files.values():
        for path in filter(Path.is_file, paths):
            content = path.read_bytes()
            for i in range(12):
                at = int(rng.integers(len(content)))
                length = int(rng.integers(1, 40))
                filling = (
                    b"",
                    b"9e999",
                    b"null",
                    b"[[",
                    b'"x"',
                    b"-1e308",
                    b"NaN",
                    b",,,",
                    b"{}",
                    rng.bytes(8),
                )
                middle = filling[i % len(filling)]
                damaged = content[:at] if i == 11 else content[:at] + middle + content[at + length :]
                other = tmp_path / path.name
                other.write_bytes(damaged)
                try:
                    read_recording(other, CaptureOptions())
                except HandfitError as error:
                    said.append(str(error))
    assert len(said) > 50
    assert not any("\n" in sentence for sentence in said)
