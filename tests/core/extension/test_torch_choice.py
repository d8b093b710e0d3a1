from __future__ import annotations

import pytest

from scripts.extension.errors import BuildError
from scripts.extension.targets import platform_named
from scripts.extension.torch_choice import own_torch

LINUX, WINDOWS = platform_named("linux-x64"), platform_named("windows-x64")
CUDA = "torch-2.13.0+cu126-cp311-cp311-manylinux_2_28_x86_64.whl"


def test_one_wheel(make_wheel):
    wheel = make_wheel(CUDA)
    assert own_torch(str(wheel.path), LINUX, ["3.11", "3.13"]) == [wheel]


@pytest.mark.parametrize(("platform", "pythons"), [(WINDOWS, ["3.11"]), (LINUX, ["3.13"])])
def test_a_wheel_for_something_else_is_refused(make_wheel, platform, pythons):
    wheel = make_wheel(CUDA)
    with pytest.raises(BuildError, match=rf"expected torch for {platform.name}, Python .*found torch-2\.13"):
        own_torch(str(wheel.path), platform, pythons)


def test_of_a_folder_what_fits(make_wheel, tmp_path):
    for_both = [
        make_wheel(CUDA),
        make_wheel("nvidia_cublas-13.1-py3-none-manylinux_2_27_x86_64.whl"),
        make_wheel("torch-2.13.0+cu126-cp313-cp313-manylinux_2_28_x86_64.whl"),
    ]
    make_wheel("torch-2.13.0+cu126-cp311-cp311-win_amd64.whl")
    found = own_torch(str(tmp_path / "made"), LINUX, ["3.11", "3.13"])
    assert {w.path for w in found} == {w.path for w in for_both}
    assert [w.name for w in own_torch(str(tmp_path / "made"), WINDOWS, ["3.11"])] == ["torch"]


def test_a_folder_without_torch(make_wheel, tmp_path):
    make_wheel("triton-3.5-cp311-cp311-manylinux_2_28_x86_64.whl")
    with pytest.raises(BuildError, match=r"expected torch .*found triton"):
        own_torch(str(tmp_path / "made"), LINUX, ["3.11"])
    (tmp_path / "empty").mkdir()
    with pytest.raises(BuildError, match="found no wheels"):
        own_torch(str(tmp_path / "empty"), LINUX, ["3.11"])


@pytest.mark.parametrize("name", ["numpy-2.4-cp311-cp311-manylinux_2_28_x86_64", "scipy-1.15-py3-none-any"])
def test_a_folder_with_what_comes_from_elsewhere(make_wheel, tmp_path, name):
    make_wheel(CUDA)
    make_wheel(f"{name}.whl")
    with pytest.raises(BuildError, match="does not come from here"):
        own_torch(str(tmp_path / "made"), LINUX, ["3.11"])


def test_neither_a_word_nor_a_path(tmp_path):
    with pytest.raises(BuildError, match="expected cpu, none, or the path"):
        own_torch(str(tmp_path / "gone.whl"), LINUX, ["3.11"])


def test_cuda_libraries_must_be_there_too(make_wheel, tmp_path):
    needs = (
        'Requires-Dist: nvidia-cublas-cu12==12.6.4; platform_system == "Linux"\n'
        'Requires-Dist: optree>=0.13; extra == "optree"\nRequires-Dist: sympy>=1.13'
    )
    torch = make_wheel(CUDA, needs)
    with pytest.raises(BuildError, match=r"also needs nvidia-cublas-cu12; give a folder"):
        own_torch(str(torch.path), LINUX, ["3.11"])
    library = make_wheel("nvidia_cublas_cu12-12.6.4-py3-none-manylinux_2_27_x86_64.whl")
    assert {w.name for w in own_torch(str(tmp_path / "made"), LINUX, ["3.11"])} == {torch.name, library.name}
    windows = make_wheel("torch-2.13.0+cu126-cp311-cp311-win_amd64.whl", needs)
    assert own_torch(str(windows.path), WINDOWS, ["3.11"]) == [windows]
