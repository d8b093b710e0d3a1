"""Which Python captures, and what it gets: Blender's own everything, one of the user's handfit_core only."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
import venv
from pathlib import Path

import numpy as np
import pytest

import handfit_core
from handfit_core.common.errors import InputError
from handfit_core.worker import interpreter
from handfit_core.worker.client import Worker
from handfit_core.worker.events import WorkerError
from handfit_core.worker.interpreter import (
    EXIT_UNFIT,
    find_python,
    is_current_interpreter,
    worker_command,
    worker_environment,
)
from tests.conftest import ROOT
from tests.waiting import stopping, wait_for

LAUNCHER = ROOT / "handfit_core" / "worker" / "launch.py"


@pytest.fixture(scope="module")
def bare_python(tmp_path_factory) -> str:
    """A Python without any packages, in a folder whose name has spaces and more than ASCII."""
    folder = tmp_path_factory.mktemp("python") / "mein Python für Hände"
    venv.create(folder, with_pip=False)
    return str(folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python"))


@pytest.fixture
def own_python(bare_python) -> str:
    """The same with the packages of the environment that runs the tests."""
    code = "import sysconfig; print(sysconfig.get_path('purelib'))"
    found = subprocess.run([bare_python, "-c", code], capture_output=True, text=True, check=True)
    path = Path(found.stdout.strip()) / "others.pth"
    path.write_text(str(Path(np.__file__).parents[1]), encoding="utf-8")
    return bare_python


@pytest.fixture
def shared_folder(tmp_path, monkeypatch) -> Path:
    """handfit_core as Blender unpacks it, among packages that are for another Python."""
    folder = tmp_path / "geteilte Pakete é"
    for name in ("numpy", "torch", "scipy", "cv2", "mediapipe"):
        (folder / name).mkdir(parents=True)
        (folder / name / "__init__.py").write_text(f"raise ImportError('{name} of another Python')\n")
    (folder / "handfit_core").symlink_to(ROOT / "handfit_core", target_is_directory=True)
    monkeypatch.setattr(interpreter, "_core_folder", lambda: folder / "handfit_core")
    return folder


def test_a_python_without_packages_is_one_sentence(bare_python):
    said = r"Hände.*' cannot capture \(No module named .*\); choose a Python that has .* in \$HANDFIT_PYTHON"
    with stopping(Worker(bare_python)) as worker, pytest.raises(WorkerError, match=said):
        wait_for(worker, worker.submit("check"), timeout=60)


def test_blenders_own_python_by_other_names(bare_python):
    assert is_current_interpreter(sys.executable)
    assert is_current_interpreter(os.path.relpath(sys.executable))
    # The same program behind a link, with packages of its own.
    assert not is_current_interpreter(bare_python)
    assert not is_current_interpreter("/nowhere/python")


def test_choice_of_the_interpreter(monkeypatch, tmp_path):
    """As it is typed and copied."""
    monkeypatch.delenv("HANDFIT_PYTHON", raising=False)
    assert find_python() == sys.executable
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    for typed in (f'"{sys.executable}"', f"  '{sys.executable}'", f" {sys.executable} "):
        monkeypatch.setenv("HANDFIT_PYTHON", typed)
        assert find_python() == find_python(typed) == sys.executable
    monkeypatch.setenv("HANDFIT_PYTHON", "~/python")
    assert Path(find_python()) == tmp_path / "python"
    assert find_python("python3") == "python3"


def test_only_blenders_own_python_is_told_of_blenders_packages(monkeypatch, bare_python):
    monkeypatch.setenv("PYTHONHOME", "/blender/python")
    monkeypatch.setenv("PYTHONPATH", "/blender/scripts")
    environment = worker_environment(sys.executable)
    assert "PYTHONHOME" not in environment
    assert (Path(environment["PYTHONPATH"]) / "handfit_core").is_dir()
    assert "PYTHONPATH" not in worker_environment(bare_python)


def test_only_handfit_core_comes_from_the_shared_folder(shared_folder, own_python):
    """The others would fail to import there; the add-on's own modules beside the launcher stay out, too."""
    with stopping(Worker(own_python)) as worker:
        done = wait_for(worker, worker.submit("check"), timeout=120)
    assert "mein Python für Hände" in done["versions"].splitlines()[1]
    assert f"numpy {np.__version__}" in done["versions"]


def test_a_worker_of_the_users_own_python_starts_others_like_itself(monkeypatch):
    monkeypatch.setattr(handfit_core, "brought_by_launcher", True, raising=False)
    assert "PYTHONPATH" not in worker_environment(sys.executable)
    assert "launch.py" in worker_command(sys.executable)[-2]


def test_nothing_comes_from_the_folder_in_which_blender_was_started(tmp_path, monkeypatch):
    (tmp_path / "handfit_core").mkdir()
    (tmp_path / "handfit_core" / "__init__.py").write_text("raise ImportError('somebody else')\n")
    monkeypatch.chdir(tmp_path)
    with stopping(Worker()) as worker, pytest.raises(InputError, match=r"nowhere\.jpg"):
        wait_for(worker, worker.submit("probe", input=[str(tmp_path / "nowhere.jpg")]), timeout=60)


def test_an_old_python_can_read_the_launcher_and_says_its_version():
    ast.parse(LAUNCHER.read_text(encoding="utf-8"), feature_version=(3, 6))
    code = (
        "import sys, runpy; sys.version_info = (3, 9, 1); sys.argv = ['launch.py', 'worker'];"
        f"runpy.run_path({str(LAUNCHER)!r}, run_name='__main__')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == EXIT_UNFIT
    assert "capturing needs 3.11 or newer" in done.stderr
