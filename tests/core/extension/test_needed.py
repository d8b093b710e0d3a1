from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.parametrize("script", ["build_extension", "lock_wheels", "fetch_landmark_model"])
def test_a_python_without_packages_is_one_sentence(script):
    """As the system's own is: -S leaves out what is installed."""
    done = subprocess.run(
        [sys.executable, "-S", str(ROOT / "scripts" / f"{script}.py")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert done.stderr.startswith(f"error: {sys.executable} has no numpy; run `")
    assert done.stderr.count("\n") == 1
