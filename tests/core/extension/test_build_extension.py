from __future__ import annotations

import dataclasses
import errno
import tempfile

import pytest

from scripts.build_extension import listed, system_error, zip_name


@pytest.mark.parametrize(
    ("torch", "pythons", "name"),
    [
        ("cpu", ("3.11", "3.13"), "manient-0.1.0-linux_x64.zip"),
        ("cpu", ("3.11",), "manient-0.1.0-linux_x64-py311.zip"),
        ("none", ("3.11", "3.13"), "manient-0.1.0-linux_x64-no_torch.zip"),
        ("2.13.0", ("3.11", "3.13"), "manient-0.1.0-linux_x64-torch_2.13.0.zip"),
        ("2.13.0+cpu", ("3.11",), "manient-0.1.0-linux_x64-py311-torch_2.13.0_cpu.zip"),
        ("2.12.1 2.13.0+cu126", ("3.11",), "manient-0.1.0-linux_x64-py311-torch_2.12.1_2.13.0_cu126.zip"),
    ],
)
def test_only_the_usual_zip_has_the_usual_name(contents, torch, pythons, name):
    assert zip_name(dataclasses.replace(contents, torch=torch, pythons=pythons)) == name


@pytest.mark.parametrize(
    ("given", "names"),
    [
        ("linux-x64, windows-x64", ["linux-x64", "windows-x64"]),
        (" 3.11,3.11,", ["3.11"]),
        ("", []),
    ],
)
def test_lists_on_the_command_line(given, names):
    assert listed(given) == names


def test_a_full_disk_is_one_sentence():
    said = system_error(OSError(errno.ENOSPC, "No space left on device", "cache/torch.whl"))
    assert said.startswith("No space left on device; a build needs ")
    assert tempfile.gettempdir() in said
    assert system_error(PermissionError(errno.EACCES, "Permission denied", "x")).startswith("x: Permission")
    assert "None" not in system_error(OSError("odd"))
