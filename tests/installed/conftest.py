"""The zip, and machines on which there is nothing but Blender and that zip.

The tests themselves import neither bpy nor the add-on: all that is tested runs in processes of its own.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.installed.sealed import Sealed

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
def sealed(tmp_path_factory) -> Iterator[Sealed]:
    """Such a machine; it, with some GB of disk, goes after the module's tests."""
    base = tmp_path_factory.mktemp("sealed")
    yield Sealed(base)
    shutil.rmtree(base)
