"""Each reader takes its own files, and no other reader takes them before it."""

from __future__ import annotations

from pathlib import Path

import pytest

from handfit_core.common.errors import InputError
from handfit_core.interchange.document import Document
from handfit_core.interchange.readers import READERS, recognised
from tests.core.interchange.every_format import keypoint_files, other_files
from tests.core.interchange.known_hands import read


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
    *others, last = READERS.all()
    assert last == "mediapipe"
    for kind, paths in files.items():
        for path in paths:
            takers = [name for name in others if READERS.get(name).recognises(Document(path))]
            assert takers == ([] if kind == "mediapipe" else [kind]), path.name


@pytest.mark.parametrize(
    ("name", "content"),
    [
        *(("a.csv", text) for text in (b"", b"a,b\n1,2\n", b"\0\1\2")),
        ("a.json", b'{"landmarks": ["x"]}'),
        ("a.npz", b"PK\3\4"),
        ("a.pkl", b"\x80\x02cposix\nsystem\n."),
    ],
)
def test_a_file_of_no_known_format_is_described(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(
        InputError, match=r"no hands or keypoints of a program that is known \(.*Points"
    ) as said:
        read(tmp_path / name)
    assert "\n" not in str(said.value)


@pytest.mark.parametrize(
    ("name", "content"),
    [("a.json", b"[" + b"{}," * 5_000_000 + b"{}]"), ("a.csv", b"frame,x\n" + b"1,2\n" * 10_000_000)],
    ids=["JSON", "CSV"],
)
def test_texts_that_would_fill_the_memory_are_refused(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match="too large to be read at once; cut it into parts"):
        read(tmp_path / name)
