"""The zip, and machines on which there is nothing but Blender and that zip.

The tests themselves import neither bpy nor the add-on: all that is tested runs in processes of its own.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.installed.sealed import Sealed

PYTHON = f"{sys.version_info.major}.{sys.version_info.minor}"

if importlib.util.find_spec("bpy") is None:
    pytest.skip("needs one of the bpy wheels", allow_module_level=True)

if sys.platform != "linux":
    pytest.skip("what is left running is looked for in Linux's /proc", allow_module_level=True)


@pytest.fixture(scope="session")
def zipped() -> Path:
    """The zip that was built for this machine."""
    path = os.environ.get("HANDFIT_ZIP")
    if not path:
        pytest.skip("HANDFIT_ZIP does not name the built zip (nox -s build)")
    return Path(path).resolve()


@pytest.fixture(scope="module")
def new_sealed(tmp_path_factory) -> Iterator[Callable[[], Sealed]]:
    """new_sealed() -> one more machine; all of them, with some GB of disk, go after the module's tests."""
    made: list[Path] = []

    def new() -> Sealed:
        made.append(tmp_path_factory.mktemp("sealed"))
        return Sealed(made[-1])

    yield new
    for base in made:
        shutil.rmtree(base)
