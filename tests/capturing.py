"""Whether the Python that captures, $HANDFIT_PYTHON or this one, has what a capture needs."""

from __future__ import annotations

import os
import subprocess
import sys
from functools import cache

import pytest


@cache
def can_capture() -> bool:
    """Whether SciPy and the others can be imported there; takes some seconds, once."""
    python = os.environ.get("HANDFIT_PYTHON", sys.executable)
    code = "import cv2, mediapipe, scipy"
    return subprocess.run([python, "-c", code], capture_output=True, check=False).returncode == 0


needs_capture = pytest.mark.skipif(
    not can_capture(), reason="needs a Python with SciPy, OpenCV and MediaPipe in HANDFIT_PYTHON"
)
