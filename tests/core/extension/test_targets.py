from __future__ import annotations

import pytest

from handfit_core.errors import OptionError
from scripts.extension.targets import (
    PLATFORM_NAMES,
    checked_pythons,
    fits_platform,
    fits_python,
    platform_named,
    this_platform,
)


@pytest.mark.parametrize(
    ("python_tag", "abi_tag", "fitting"),
    [
        ("cp311", "cp311", ["3.11"]),
        ("cp313", "cp313", ["3.13"]),
        ("cp313", "cp313t", []),
        ("py3", "none", ["3.11", "3.13"]),
        ("py2.py3", "none", ["3.11", "3.13"]),
        ("cp37", "abi3", ["3.11", "3.13"]),
        ("cp312", "abi3", ["3.13"]),
        ("cp37", "cp37m", []),
        ("cp310", "cp310", []),
        ("py2", "none", []),
    ],
)
def test_which_pythons_a_wheel_fits(python_tag, abi_tag, fitting):
    assert [p for p in ("3.11", "3.13") if fits_python(python_tag, abi_tag, p)] == fitting


@pytest.mark.parametrize(
    ("tag", "fitting"),
    [
        ("any", ["linux-x64", "windows-x64", "macos-arm64"]),
        ("manylinux_2_17_x86_64.manylinux2014_x86_64", ["linux-x64"]),
        ("manylinux_2_28_x86_64", ["linux-x64"]),
        ("linux_x86_64", ["linux-x64"]),
        ("manylinux_2_34_x86_64", []),
        ("manylinux_2_28_aarch64", []),
        ("win_amd64", ["windows-x64"]),
        ("win32", []),
        ("macosx_11_0_universal2", ["macos-arm64"]),
        ("macosx_14_0_arm64", ["macos-arm64"]),
        ("macosx_15_0_arm64", []),
        ("macosx_11_0_x86_64", []),
    ],
)
def test_which_platforms_a_wheel_fits(tag, fitting):
    assert [n for n in PLATFORM_NAMES if fits_platform(tag, platform_named(n))] == fitting


def test_the_own_platform_has_blenders_form():
    system, processor = this_platform().split("-")
    assert system in ("linux", "windows", "macos")
    assert processor not in ("x86_64", "amd64", "aarch64")


def test_unknown_names_list_the_known_ones():
    with pytest.raises(OptionError, match=r"amiga: .*linux-x64, windows-x64, macos-arm64"):
        platform_named("amiga")
    with pytest.raises(OptionError, match=r"3\.9: .*3\.11, 3\.13"):
        checked_pythons(["3.11", "3.9"])
    with pytest.raises(OptionError, match="no Python was named"):
        checked_pythons([])


def test_pythons_come_in_order_and_once():
    assert checked_pythons(["3.13", "3.11", "3.13"]) == ("3.11", "3.13")
