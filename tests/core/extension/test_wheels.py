"""Locks, and the wheels that they name: from the index into the cache, once, each held against its hash."""

import os

import pytest

from scripts.extension.wheels import (
    BUILD_LOCK,
    LOCKS,
    PLATFORMS,
    PYTHONS,
    RUN_TIME,
    TORCH,
    BuildError,
    Pin,
    fetched,
    lock_path,
    read_lock,
    wheel_cache,
)
from scripts.lock_wheels import ROOT, SYSTEMS, resolved, versions

ALL = [(platform, python) for platform in PLATFORMS for python in PYTHONS]
NAME = "torch-2.13.0+cpu-cp311-cp311-manylinux_2_28_x86_64.whl"


@pytest.fixture
def index(make_wheel, tmp_path, monkeypatch):
    """A folder that is all that pip knows, with one wheel; the cache is empty."""
    monkeypatch.setenv("HANDFIT_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("PIP_CONFIG_FILE", os.devnull)
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path / "index"))
    return make_wheel(NAME, folder=tmp_path / "index")


def test_downloaded_once(index):
    pin = Pin("torch", "2.13.0+cpu", index.sha256)
    (path,) = fetched([pin], "linux-x64", "3.11")
    assert path == wheel_cache() / NAME
    assert path.read_bytes() == index.path.read_bytes()
    index.path.unlink()
    assert fetched([pin], "linux-x64", "3.11") == [path]
    assert [p.name for p in wheel_cache().iterdir()] == [NAME]


def test_a_damaged_wheel_in_the_cache_is_replaced(index):
    wheel_cache().mkdir(parents=True)
    (wheel_cache() / NAME).write_bytes(index.path.read_bytes() + b"x")
    (path,) = fetched([Pin("torch", "2.13.0+cpu", index.sha256)], "linux-x64", "3.11")
    assert path.read_bytes() == index.path.read_bytes()


@pytest.mark.parametrize(("python", "digest", "said"), [("3.13", None, ""), ("3.11", "0" * 64, ".*hash")])
def test_what_cannot_be_had_is_one_sentence(index, python, digest, said):
    said = rf"the wheels for linux-x64, Python {python} could not be downloaded \({said}"
    with pytest.raises(BuildError, match=said) as caught:
        fetched([Pin("torch", "2.13.0+cpu", digest or index.sha256)], "linux-x64", python)
    assert str(wheel_cache()) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not list(wheel_cache().glob("*"))


def test_the_locked_wheel_is_the_one_that_pip_finds(index):
    pinned = {"torch": "2.13.0+cpu"}
    assert resolved(["torch"], pinned, "linux-x64") == [Pin("torch", "2.13.0+cpu", index.sha256)]
    with pytest.raises(BuildError, match="No matching distribution"):
        resolved(["torch"], pinned, "linux-x64", "3.13")


@pytest.mark.parametrize(("platform", "python"), ALL)
def test_locks_have_every_part_in_the_version_of_constraints(platform, python):
    """Where this fails, run `nox -s lock`. Linux has no CPU build of torch for Python 3.13."""
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pinned = versions(lines, python, SYSTEMS[platform.partition("-")[0]])
    if platform == "linux-x64":
        pinned["torch"] += "+cpu"  # the plain file is several GB of CUDA
    torch = () if (platform, python) == ("linux-x64", "3.13") else TORCH
    pins = {pin.name: pin.version for pin in read_lock(lock_path(platform, python))}
    assert pins == {name: pinned[name] for name in (*RUN_TIME, *torch)}
    (tool,) = read_lock(BUILD_LOCK)
    assert tool.version == pinned[tool.name]
    assert not [path for path in LOCKS.iterdir() if "://" in path.read_text(encoding="utf-8")]


def test_a_line_without_a_hash_is_refused(tmp_path):
    path = tmp_path / "lock.txt"
    path.write_text("# A lock.\nscipy==1.15.3\n", encoding="utf-8")
    with pytest.raises(BuildError, match="line 2: expected NAME==VERSION --hash"):
        read_lock(path)
