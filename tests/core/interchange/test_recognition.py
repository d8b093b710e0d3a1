"""Each reader of keypoints takes its own files, and no other reader takes them before it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from handfit_core.errors import HandfitError
from handfit_core.interchange.document import Document
from handfit_core.interchange.opening import read_recording
from handfit_core.interchange.readers import READERS, recognised
from handfit_core.interchange.writers import writer_for
from handfit_core.options import CaptureOptions
from tests.core.interchange import (
    test_apple_vision,
    test_freemocap,
    test_mediapipe,
    test_mmpose,
    test_openpose,
)
from tests.told import told


def _files(folder: Path) -> dict[str, list[Path]]:
    """Files of every reader of keypoints, by its name."""
    found: dict[str, list[Path]] = {}

    def saved(name: str, kind: str, content: object) -> None:
        path = folder / name
        path.write_text(json.dumps(content) if not isinstance(content, str) else content)
        found.setdefault(kind, []).append(path)

    take = told().take
    for name, kind in (
        ("a.points.json", "points"),
        ("a.points.csv", "points-table"),
        ("a.mediapipe.json", "mediapipe"),
    ):
        writer_for(folder / name).write(take, folder / name)
        found.setdefault(kind, []).append(folder / name)
    saved("b.json", "openpose", {"people": [test_openpose.person(0)]})
    found["openpose"].append(test_openpose.folder(folder / "openpose", [[], [test_openpose.person(0)]]))
    saved("c.json", "mmpose", [{"frame_id": 0, "instances": [test_mmpose.instance(0)]}])
    saved("d.json", "mmpose", {"meta_info": {}, "instance_info": [test_mmpose.instance(0)]})
    hand = {"keypoints": told().pixels["left"][0].tolist(), "keypoint_scores": [0.8] * 21}
    saved("e.json", "mmpose", [hand])
    np.save(folder / "mediapipe_left_hand_3d_xyz.npy", test_freemocap.in_room("left"))
    found["freemocap"] = [folder / "mediapipe_left_hand_3d_xyz.npy"]
    names = [f"left_hand_{name.lower()}" for name in test_mediapipe.NAMES]
    found["freemocap"].append(test_freemocap.rows_of(names, test_freemocap.in_room("left"), folder / "f.csv"))
    apple = dict(zip(test_apple_vision.CODES, test_apple_vision.normalised("left", 0).tolist(), strict=True))
    saved("g.json", "apple-vision", {"chirality": "left", **apple})
    saved(
        "h.csv",
        "apple-vision",
        _line([f"{n}_{c}" for n in test_apple_vision.NAMES for c in "xy"], apple.values()),
    )
    for i, layout in enumerate(test_mediapipe.LAYOUTS):
        saved(f"mediapipe{i}.json", "mediapipe", [layout(0)])
    saved("i.csv", "mediapipe", _line(test_mediapipe.wide(0), test_mediapipe.landmarks("left", 0)))
    sides = [f"{name}_{axis}" for name in names for axis in "xyz"]
    saved("j.csv", "mediapipe", _line(sides, test_mediapipe.landmarks("left", 0)))
    return found


def _line(header: list[str], rows: object) -> str:
    return ",".join(header) + "\n" + ",".join(str(cell) for row in rows for cell in row)  # type: ignore[attr-defined]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Path]]:
    return _files(tmp_path_factory.mktemp("formats"))


def test_every_file_is_recognised_by_its_reader(files: dict[str, list[Path]]) -> None:
    for kind, paths in files.items():
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
