"""Small wheels to build with."""

import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from scripts.extension.wheels import Wheel

MakeWheel = Callable[..., Wheel]


@pytest.fixture
def make_wheel(tmp_path: Path) -> MakeWheel:
    """A wheel of the given file name with metadata, a licence, and more files by name."""

    def make(
        file_name: str,
        licence: str = "License-Expression: MIT",
        files: dict[str, str] | None = None,
        folder: Path | None = None,
    ) -> Wheel:
        path = (folder or tmp_path / "made") / file_name
        path.parent.mkdir(parents=True, exist_ok=True)
        name, version = file_name.split("-")[:2]
        info = f"{name}-{version}.dist-info"
        tag = "-".join(file_name.removesuffix(".whl").split("-")[-3:])
        contents = {
            f"{info}/METADATA": f"Metadata-Version: 2.4\nName: {name}\nVersion: {version}\n{licence}\n\n",
            f"{info}/WHEEL": f"Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: {tag}\n",
            f"{info}/licenses/LICENSE": f"The licence of {name}.\n",
            **(files or {}),
        }
        with zipfile.ZipFile(path, "w") as archive:
            for member, text in contents.items():
                archive.writestr(member, text)
        return Wheel(path)

    return make


@pytest.fixture
def wheels(make_wheel: MakeWheel) -> list[Wheel]:
    """As of a zip: the core, a part with a licence of its own words, and torch for one Python."""
    torch = make_wheel("torch-2.13.0+cpu-cp311-cp311-manylinux_2_28_x86_64.whl")
    return [
        make_wheel("handfit_core-0.1.0-py3-none-any.whl", "License-Expression: GPL-3.0-or-later"),
        make_wheel("mediapipe-0.10.31-py3-none-manylinux_2_28_x86_64.whl", "License: Apache 2.0"),
        Wheel(torch.path, ("3.11",)),
    ]
