"""Each reader takes its own files, and no other reader takes them before it."""

from __future__ import annotations

import gzip
import io
import pickle
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest

from handfit_core.common.errors import InputError
from handfit_core.interchange.document import Document
from handfit_core.interchange.readers import READERS, recognised
from handfit_core.interchange.writers import WRITERS
from tests.conftest import ROOT
from tests.core.interchange.every_format import keypoint_files, other_files
from tests.core.interchange.known_hands import read
from tests.torch_files import Name, older_torch, torch_zip


def formats_table() -> list[str]:
    """The lines of docs/interchange.md's table."""
    rows = ["| format | read | write | what is assumed | tried with |", "|---|---|---|---|---|"]
    readers, writers = READERS.built_in(), WRITERS.built_in()
    for name in [*readers, *(name for name in writers if name not in {"take", *readers})]:
        reader, writer = readers.get(name), writers.get(name)
        told = (reader.title, reader.assumed, reader.met or "by description") if reader else ("", "", "")
        title, assumed, met = told if reader or not writer else (writer.title, "", "")
        written = f"`{writer.endings[0]}`" if writer else ""
        rows.append(f"| {title} | {f'`{name}`' if reader else ''} | {written} | {assumed} | {met} |")
    return rows


def test_the_pages_table_is_the_codes() -> None:
    page = (ROOT / "docs" / "interchange.md").read_text(encoding="utf-8")
    assert [line for line in page.splitlines() if line.startswith("|")] == formats_table()
    assert len(page.replace("|", " ").split()) <= 1500


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
    """Those of arrays and of MediaPipe take whatever has 21 points, and are asked when all others said no."""
    *others, arrays, last = READERS.all()
    assert (arrays, last) == ("arrays", "mediapipe")
    for kind, paths in files.items():
        for path in paths:
            takers = [name for name in others if READERS.get(name).recognises(Document(path))]
            assert takers == [kind] * (kind not in (arrays, last)), path.name


def workbook() -> bytes:
    with zipfile.ZipFile(stream := io.BytesIO(), "w") as archive:
        archive.writestr(zipfile.ZipInfo("[Content_Types].xml"), "<Types/>")
    return stream.getvalue()


@pytest.mark.parametrize(
    ("name", "content", "found"),
    [
        ("a.csv", b"", "an empty file"),
        ("a.csv", b"[]", "JSON with a list of 0"),
        ("a.csv", b"a,b\n1,2\n", "a table with the columns a, b"),
        ("a.csv", b"\0\1\2", "a text, and no table"),
        ("a.csv", b"Format Version,1.23,Take Name,a\n", "Motive's table; write its markers as .trc"),
        ("a.fbx", b"; FBX 7.3.0 project file", "an FBX; import it in Blender and export its hands as BVH"),
        ("a.xlsx", workbook(), "a spreadsheet or another document; save its table as CSV"),
        ("a.txt", b"%PDF", "a text, .* it begins with '%PDF'"),
        ("a.json", b'{"landmarks": ["x"]}', "JSON with landmarks"),
        ("a.json", b'{"landmarks": [\n1,', "damaged JSON: it breaks off, or has .* in line 2"),
        ("a.json", b'{"a": 1}\n{"a": 2}\n', "lines of JSON with a"),
        ("a.jsonl", b'{"a": 1}\n{"a" 2}\n{"a": 1}\n', "lines of JSON, of which line 2 is damaged"),
        ("a.jsonl", b'{"hand_poses": {"0": {"joint_angles": [0.1]}}}\n', "UmeTrack's joints .HOT3D"),
        ("a.npz", b"PK\3\4", "a zip archive, or a damaged .npz"),
        ("a.pkl", b"\x80\x02cposix\nsystem\n.", "a pickle that .* could run programs"),
        ("a.pt", torch_zip({"weights": np.ones(3)}), "PyTorch's file with weights"),
        ("a.pt", torch_zip(np.ones((3, 2))), "PyTorch's file with an array of the shape 3x2"),
        ("a.pt", torch_zip([np.ones(3)], byteorder=b"big"), "PyTorch's file that has its bytes in an order"),
        (
            "a.pt",
            torch_zip([np.ones(3)], **{"data/0": bytes(8)}),
            "PyTorch's file that has a tensor with more",
        ),
        ("a.pt", torch_zip(Name("os", "system")), "PyTorch's file that asks to run os.system"),
        ("a.pth", older_torch({"weights": np.ones(3)}), "a pickle with weights"),
        ("a.pkl", zlib.compress(pickle.dumps([1, 2])), "a pickle with a list of 2"),
        ("a.pkl", gzip.compress(b"\x80" + bytes(1 << 29)), "a pickle that .* more memory than such a file"),
        ("a.gz", gzip.compress(b"text", mtime=0), "a gzip archive; unpack it first"),
        ("wham_output.pkl", pickle.dumps({0: {"pose_world": 0, "trans_world": 0}}), "a body of SMPL without"),
        ("a.npz", b"\x89HDF\r\n", "HDF5"),
        ("a.json", b'{"root_orient": [0], "pose_body": [0]}', "a body of SMPL without hands"),
    ],
)
def test_a_file_of_no_known_format_is_described(
    tmp_path: Path, name: str, content: bytes, found: str
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(
        InputError, match=f"no hands of a layout that is known are in it: it is .*{found}"
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
