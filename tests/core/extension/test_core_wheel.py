from __future__ import annotations

import shutil

import pytest

from scripts.extension.core_wheel import BESIDE, ROOT, core_wheel, data_files, source_files
from scripts.extension.errors import BuildError


@pytest.fixture
def checkout(tmp_path):
    """The core's source, as a clone has it."""
    root = tmp_path / "checkout"
    shutil.copytree(ROOT / "handfit_core", root / "handfit_core", ignore=shutil.ignore_patterns("*.task"))
    for name in BESIDE:
        shutil.copy(ROOT / name, root)
    return root


@pytest.mark.parametrize(
    "name",
    [
        "hand_model/data/MANO_RIGHT.pkl",
        "hand_model/data/MANO-RIGHT.npz",
        "hand_model/data/right.npz",
        "detect/data/notes.txt",
        "detect/data/second.task",
        "hand_model/chain.py.orig",
    ],
)
def test_what_is_not_the_cores_does_not_go_into_the_zip(checkout, tmp_path, name):
    (checkout / "handfit_core" / name).write_bytes(b"")
    with pytest.raises(BuildError, match=rf"^handfit_core/{name}: .*must not go into the zip"):
        core_wheel(tmp_path, checkout)
    assert not list(tmp_path.glob("*.whl"))


def test_what_python_and_the_desktop_leave_behind_is_passed_over(checkout):
    before = source_files(checkout)
    (checkout / "handfit_core" / ".DS_Store").touch()
    (checkout / "handfit_core" / "__pycache__").mkdir(exist_ok=True)
    (checkout / "handfit_core" / "__pycache__" / "x.cpython-311.pyc").touch()
    assert source_files(checkout) == before
    assert "handfit_core/hand_model/chain.py" in before
    assert "handfit_core/hand_model/data/open_hand_right.npz" in before


def test_every_listed_file_is_there_but_for_the_landmark_model(checkout):
    absent = {name for name in data_files(checkout) if not (checkout / name).is_file()}
    assert absent == {"handfit_core/detect/data/hand_landmarker.task"}
