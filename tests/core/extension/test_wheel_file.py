from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from scripts.extension.errors import BuildError
from scripts.extension.targets import platform_named
from scripts.extension.wheel_file import normalized, wheel_file


def test_a_wheel_by_its_name(make_wheel):
    wheel = make_wheel("Some_Thing.x-1.2+cpu-3-cp37-abi3-manylinux_2_17_x86_64.manylinux2014_x86_64.whl")
    assert (wheel.name, wheel.version) == ("some-thing-x", "1.2+cpu")
    assert (wheel.python_tag, wheel.abi_tag) == ("cp37", "abi3")
    assert wheel.fits(platform_named("linux-x64"), ["3.11", "3.13"]) == ("3.11", "3.13")
    assert wheel.fits(platform_named("macos-arm64"), ["3.11", "3.13"]) == ()
    assert normalized("typing_extensions") == normalized("Typing.Extensions") == "typing-extensions"


def test_what_is_inside(make_wheel):
    wheel = make_wheel("part-1-py3-none-any.whl", files={"part/data.txt": "x" * 5000})
    assert wheel.members["part/data.txt"] == 5000
    assert wheel.unpacked_size == sum(wheel.members.values()) > 5000
    assert wheel.size == wheel.path.stat().st_size
    assert wheel.sha256 == hashlib.sha256(wheel.path.read_bytes()).hexdigest()
    assert wheel.metadata["Name"] == "part"
    assert wheel.texts(r".*/LICENSE") == [("part-1.dist-info/licenses/LICENSE", "The licence of part.\n")]


@pytest.mark.parametrize("name", ["torch.whl", "torch-2.13.0.zip", "torch-2-cp311-cp311-win_amd64.whl.part"])
def test_a_name_that_no_wheel_has(name):
    with pytest.raises(BuildError, match="not named as a wheel"):
        wheel_file(Path(name))


def test_a_damaged_wheel_is_a_sentence(tmp_path):
    path = tmp_path / "part-1-py3-none-any.whl"
    path.write_bytes(b"half a download")
    with pytest.raises(BuildError, match="cannot be read"):
        _ = wheel_file(path).metadata
