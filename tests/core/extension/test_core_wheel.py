"""What may go into handfit_core's wheel, and what a zip of it is made of."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from handfit_core.detect import landmark_model
from handfit_core.errors import LandmarkModelError
from scripts.extension import core_wheel as module
from scripts.extension.core_wheel import BESIDE, core_wheel, source_files
from scripts.extension.staging import ROOT, extension_tool, fix, run_tool
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


def test_what_python_and_the_desktop_leave_behind_is_passed_over_and_what_only_checkouts_have_stays(checkout):
    before = source_files(checkout)
    (checkout / "handfit_core" / ".DS_Store").touch()
    (checkout / "handfit_core" / "__pycache__").mkdir(exist_ok=True)
    (checkout / "handfit_core" / "__pycache__" / "x.cpython-311.pyc").touch()
    assert source_files(checkout) == before
    assert {"handfit_core/take.py", "handfit_core/py.typed"} <= set(before)
    assert "handfit_core/hand_model/data/open_hand_right.npz" in before
    assert not [name for name in before if "/evaluate/" in name or name.endswith("/send.py")]


@pytest.fixture
def old_cache(tmp_path, monkeypatch):
    """With a setuptools that is none, and with the first landmark model alone."""
    monkeypatch.setenv("HANDFIT_CACHE", str(tmp_path))
    monkeypatch.setattr(module, "fetched", lambda _: [tmp_path / "setuptools.whl"])
    landmark_model.cached_path().write_bytes(b"first")
    monkeypatch.setattr(module, "LANDMARK_MODEL_SHA256", hashlib.sha256(b"first").hexdigest())
    return tmp_path


@pytest.mark.parametrize("before", [None, b"damaged"])
def test_without_the_network_of_2020_there_is_no_wheel(old_cache, checkout, monkeypatch, before):
    def assemble_2020(path: Path) -> None:
        raise LandmarkModelError("it could not be downloaded")

    second = landmark_model.cached_path_2020()
    if before:
        second.write_bytes(before)
    monkeypatch.setattr(module, "assemble_2020", assemble_2020)
    with pytest.raises(LandmarkModelError, match="could not be downloaded"):
        core_wheel(old_cache, checkout)
    monkeypatch.setattr(module, "assemble_2020", lambda path: path.write_bytes(b"of another version"))
    with pytest.raises(BuildError, match=r"2020\.tflite: this was assembled to other bytes"):
        core_wheel(old_cache, checkout)
    assert not list(old_cache.glob("*.whl"))


def test_order_times_and_modes_do_not_matter(tmp_path):
    content = {"b.py": b"b" * 1000, "a.py": b"a", "wheels/x.whl": b"wheel" * 1000}
    fixed = []
    for number, names in enumerate((["b.py", "a.py", "wheels/x.whl"], ["wheels/x.whl", "a.py", "b.py"])):
        folder = tmp_path / str(number)
        (folder / "wheels").mkdir(parents=True)
        with zipfile.ZipFile(folder / "made.zip", "w") as archive:
            for name in names:
                (folder / name).write_bytes(content[name])
                (folder / name).chmod(0o600 if number else 0o755)
                os.utime(folder / name, (1e9 + 1e6 * number,) * 2)
                kind = zipfile.ZIP_STORED if name.endswith(".whl") else zipfile.ZIP_DEFLATED
                archive.write(folder / name, name, kind)
        fix(folder / "made.zip")
        fixed.append(folder / "made.zip")
    assert fixed[0].read_bytes() == fixed[1].read_bytes()
    with zipfile.ZipFile(fixed[0]) as archive:
        assert {name: archive.read(name) for name in archive.namelist()} == content
        # Compressed bytes would depend on the zlib of the Python at work.
        assert {entry.compress_type for entry in archive.infolist()} == {zipfile.ZIP_STORED}


@pytest.mark.skipif(shutil.which("false") is None, reason="there is no program `false` here")
def test_a_program_that_is_no_blender_is_one_sentence(tmp_path):
    with pytest.raises(BuildError, match=r"refused .*--command extension build\):\nit ended with 1 and said"):
        run_tool(extension_tool("false"), "build")
    nothing = tmp_path / "blender.exe"
    nothing.write_bytes(b"not a program")
    nothing.chmod(0o755)
    with pytest.raises(BuildError, match=r"blender\.exe: this cannot be run .*--blender"):
        run_tool(extension_tool(str(nothing)), "build")
    with pytest.raises(BuildError, match="there is no such Blender"):
        extension_tool(str(tmp_path / "gone"))


@pytest.mark.parametrize("script", ["build_extension", "lock_wheels", "fetch_landmark_model"])
def test_a_python_without_packages_is_one_sentence(script):
    """As the system's own is: -S leaves out what is installed."""
    path = Path(ROOT) / "scripts" / f"{script}.py"
    done = subprocess.run([sys.executable, "-S", str(path)], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.startswith(f"error: {sys.executable} has no numpy; run `")
    assert done.stderr.count("\n") == 1
