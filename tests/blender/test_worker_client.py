"""The child process: its messages, its errors, its deaths. Children here are stand-ins."""

from __future__ import annotations

import json
import os
import stat
import sys
import time
from pathlib import Path

import pytest

from blender_manient.worker_client import (
    CaptureOptions,
    WorkerError,
    capture_in_child,
    child_environment,
    find_python,
)
from handfit_core.errors import InputError, NoHandFoundError

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="stand-ins are scripts with a #! line")


@pytest.fixture
def child(tmp_path):
    """child(code) -> path of an interpreter that runs `code` whatever it is asked to run."""

    def make(code: str) -> str:
        path = tmp_path / "python-stand-in"
        path.write_text(f"#!{sys.executable}\nimport json, os, sys, time\n{code}\n")
        path.chmod(path.stat().st_mode | stat.S_IXUSR)
        return str(path)

    return make


def capture(python: str, tmp_path: Path, **options) -> None:
    capture_in_child(["a b.jpg"], tmp_path / "out.npz", python=python, **options)


def test_progress_and_warnings_arrive(child, tmp_path):
    python = child(
        "print('some library says hello')\n"
        'print(\'{"event": "progress", "stage": "detect", "done": 3, "total": 30}\')\n'
        'print(\'{"event": "warning", "message": "dark"}\')\n'
        'print(\'{"event": "done"}\')'
    )
    progress, warnings = [], []
    capture(python, tmp_path, on_progress=lambda *p: progress.append(p), on_warning=warnings.append)
    assert progress == [("detect", 3, 30)]
    assert warnings == ["dark"]


def test_the_command_line(child, tmp_path):
    python = child(f"open({str(tmp_path / 'argv')!r}, 'w').write(json.dumps(sys.argv[1:]))")
    options = CaptureOptions(frames="-200", hands="left", model="/my hands", debug=True)
    capture(python, tmp_path, options=options)
    argv = json.loads((tmp_path / "argv").read_text())
    assert argv[:4] == ["-u", "-m", "handfit_core", "capture"]
    assert argv[4:8] == ["-o", str(tmp_path / "out.npz"), "--progress", "json"]
    assert argv[8:] == ["--frames=-200", "--hands=left", "--model=/my hands", "--debug", "--", "a b.jpg"]


def test_smoothing_and_plain_detection():
    assert CaptureOptions().arguments() == []
    assert CaptureOptions(smoothing=0.0).arguments() == ["--smoothing=0.0"]  # 0 is not "as the core likes"
    both = CaptureOptions(smoothing=2.5, plain_detection=True).arguments()
    assert both == ["--smoothing=2.5", "--plain-detection"]


def test_the_core_understands_all_options():
    """The one command line in two places."""
    from handfit_core.__main__ import _parser

    options = CaptureOptions(
        frames="1-9",
        hands="left",
        solver="fast",
        model="/m",
        threshold=0.3,
        intrinsics="1,1,1,1",
        landmark_model="/l",
        smoothing=0.0,
        plain_detection=True,
        debug=True,
    )
    args = _parser().parse_args(["capture", "-o", "out.npz", *options.arguments(), "--", "a.jpg"])
    assert (args.smoothing, args.plain_detection, args.threshold) == (0.0, True, 0.3)
    plain = _parser().parse_args(["capture", "-o", "out.npz", "a.jpg"])
    assert (plain.smoothing, plain.plain_detection) == (1.0, False)


@pytest.mark.parametrize("kind", [NoHandFoundError, InputError])
def test_errors_are_raised_as_what_they_were(child, tmp_path, kind):
    event = f'{{"event": "error", "type": "{kind.__name__}", "message": "what and why"}}'
    with pytest.raises(kind, match="what and why"):
        capture(child(f"print('{event}'); sys.exit(1)"), tmp_path)


def test_a_missing_module_names_the_remedy(child, tmp_path):
    python = child("sys.stderr.write(\"ModuleNotFoundError: No module named 'torch'\\n\"); sys.exit(1)")
    with pytest.raises(WorkerError, match=r"No module named 'torch'.*HANDFIT_PYTHON"):
        capture(python, tmp_path)


def test_a_missing_interpreter_is_one_sentence(tmp_path):
    with pytest.raises(WorkerError, match=r"nowhere.*HANDFIT_PYTHON"):
        capture(str(tmp_path / "nowhere"), tmp_path)


def test_a_crash_quotes_the_last_words(child, tmp_path):
    python = child("sys.stderr.write('out of paper\\n\\n'); sys.stderr.flush(); os.abort()")
    with pytest.raises(WorkerError, match=r"SIGABRT.*out of paper"):
        capture(python, tmp_path)


def test_much_stderr_does_not_block(child, tmp_path):
    capture(child("sys.stderr.write('x' * 5_000_000)"), tmp_path)


def test_timeout_ends_the_child(child, tmp_path):
    started = time.monotonic()
    with pytest.raises(WorkerError, match="longer than 1 seconds"):
        capture(child("time.sleep(60)"), tmp_path, timeout=1.0)
    assert time.monotonic() - started < 20


def test_interrupt_ends_the_child(child, tmp_path):
    pid_file = tmp_path / "pid"
    python = child(
        f"open({str(pid_file)!r}, 'w').write(str(os.getpid()))\n"
        'print(\'{"event": "progress", "stage": "fit"}\', flush=True)\ntime.sleep(60)'
    )

    def interrupt(*_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        capture(python, tmp_path, on_progress=interrupt)
    with pytest.raises(ProcessLookupError):
        os.kill(int(pid_file.read_text()), 0)


def test_blenders_python_settings_stay_out(monkeypatch):
    monkeypatch.setenv("PYTHONHOME", "/blender/python")
    monkeypatch.setenv("PYTHONPATH", "/blender/scripts")
    environment = child_environment()
    assert "PYTHONHOME" not in environment
    assert (Path(environment["PYTHONPATH"]) / "handfit_core").is_dir()


def test_choice_of_the_interpreter(monkeypatch):
    monkeypatch.delenv("HANDFIT_PYTHON", raising=False)
    assert find_python() == sys.executable
    monkeypatch.setenv("HANDFIT_PYTHON", "/env/python")
    assert find_python() == "/env/python"
    assert find_python("/my/python") == "/my/python"
