from __future__ import annotations

import pytest

from scripts.extension.contents import sorted_wheels
from scripts.extension.errors import BuildError
from scripts.extension.targets import platform_named

LINUX = platform_named("linux-x64")


def test_each_wheel_once_with_its_pythons(make_wheel):
    anywhere = make_wheel("mediapipe-0.10.31-py3-none-manylinux_2_28_x86_64.whl")
    older = make_wheel("scipy-1.15.3-cp311-cp311-manylinux_2_17_x86_64.whl")
    newer = make_wheel("scipy-1.17.1-cp313-cp313-manylinux_2_27_x86_64.whl")
    wheels = sorted_wheels([newer, anywhere, older, anywhere], LINUX, ("3.11", "3.13"))
    assert [(w.path.name.split("-")[0], w.version, pythons) for w, pythons in wheels] == [
        ("mediapipe", "0.10.31", ("3.11", "3.13")),
        ("scipy", "1.15.3", ("3.11",)),
        ("scipy", "1.17.1", ("3.13",)),
    ]


def test_two_wheels_of_a_package_for_one_python_are_refused(make_wheel):
    wheels = [make_wheel("part-1-py3-none-any.whl"), make_wheel("part-2-cp311-cp311-linux_x86_64.whl")]
    with pytest.raises(BuildError, match=r"are both part for Python 3\.11"):
        sorted_wheels(wheels, LINUX, ("3.11", "3.13"))


def test_a_wheel_for_something_else_is_refused(make_wheel):
    with pytest.raises(BuildError, match=r"not for linux-x64, Python 3\.11"):
        sorted_wheels([make_wheel("part-1-cp311-cp311-win_amd64.whl")], LINUX, ("3.11",))
