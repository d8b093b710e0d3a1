"""What a timing depends on besides the code."""

from __future__ import annotations

import os
import platform
import sys
from importlib.metadata import version
from typing import Any

PACKAGES = ("numpy", "torch", "scipy", "mediapipe", "opencv-python-headless")


def machine_facts() -> dict[str, Any]:
    """Processor, cores, load, threads and versions; nothing that names the machine."""
    import cv2
    import torch

    return {
        "system": f"{platform.system()} {platform.machine()}",
        "processor": _processor(),
        "cores": os.cpu_count(),
        "usable_cores": _usable_cores(),
        "load_before": _load(),
        "torch_threads": torch.get_num_threads(),
        "opencv_threads": cv2.getNumThreads(),
        "python": platform.python_version(),
        "versions": {package: version(package) for package in PACKAGES},
    }


def _usable_cores() -> int | None:
    """Cores that this process may run on, where the system tells."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count()


def _load() -> float | None:
    """Processes that wanted a core, on average over the last minute; Windows does not tell."""
    return None if sys.platform == "win32" else round(os.getloadavg()[0], 2)


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as stream:
            for line in stream:
                if line.startswith("model name"):
                    return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or "unknown"
