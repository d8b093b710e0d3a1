"""What may go into handfit_core's wheel, and what a zip of it is made of."""

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from scripts.extension.core_wheel import BESIDE, core_wheel, source_files
from scripts.extension.staging import ROOT, fix
from scripts.extension.wheels import BuildError


@pytest.fixture
def checkout(tmp_path):
    """The core's source, as a clone has it."""
    root = tmp_path / "checkout"
    shutil.copytree(
        ROOT / "handfit_core", root / "handfit_core", ignore=shutil.ignore_patterns("*.task", "*.tflite")
    )
    for name in BESIDE:
        shutil.copy(ROOT / name, root)
    return root


MANO = "hand_model/data/MANO_RIGHT.pkl", "hand_model/data/MANO-RIGHT.npz"


@pytest.mark.parametrize("name", [*MANO, "detect/data/notes.txt", "detect/data/second.task", "take.py.orig"])
def test_what_is_not_the_cores_does_not_go_into_the_zip(checkout, tmp_path, name):
    (checkout / "handfit_core" / name).write_bytes(b"")
    with pytest.raises(BuildError, match=rf"^handfit_core/{name}: .*must not go into the zip"):
        core_wheel(tmp_path, checkout)
    assert not list(tmp_path.glob("*.whl"))


def test_ignores_caches(checkout):
    before = source_files(checkout)
    (checkout / "handfit_core" / ".DS_Store").touch()
    (checkout / "handfit_core" / "__pycache__").mkdir(exist_ok=True)
    (checkout / "handfit_core" / "__pycache__" / "x.cpython-311.pyc").touch()
    assert source_files(checkout) == before
    assert {"handfit_core/take/take.py", "handfit_core/py.typed"} <= set(before)
    assert "handfit_core/hand_model/data/open_hand_right.npz" in before
    assert not [name for name in before if "/evaluate/" in name or name.endswith("/send.py")]


def test_order_times_and_modes_do_not_matter(tmp_path):
    content = {"b.py": b"b" * 1000, "a.py": b"a", "wheels/x.whl": b"wheel" * 1000}
    fixed = []
    for number, names in enumerate((list(content), sorted(content, reverse=True))):
        path = tmp_path / f"{number}.zip"
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name in names:
                entry = zipfile.ZipInfo(name, (2001 + number, 9, 9, 1, 46, 40))
                entry.external_attr = (0o600 if number else 0o755) << 16
                archive.writestr(entry, content[name])
        fix(path)
        fixed.append(path.read_bytes())
    assert fixed[0] == fixed[1]
    with zipfile.ZipFile(path) as archive:
        assert {name: archive.read(name) for name in archive.namelist()} == content
        # Compressed bytes would depend on the zlib of the Python at work.
        assert {entry.compress_type for entry in archive.infolist()} == {zipfile.ZIP_STORED}


@pytest.mark.parametrize("script", ["build_extension", "lock_wheels", "fetch_landmark_model"])
def test_a_python_without_packages_is_one_sentence(script):
    """As the system's own is: -S leaves out what is installed."""
    path = Path(ROOT) / "scripts" / f"{script}.py"
    done = subprocess.run([sys.executable, "-S", str(path)], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.startswith(f"error: {sys.executable} has no numpy; run `")
    assert done.stderr.count("\n") == 1
