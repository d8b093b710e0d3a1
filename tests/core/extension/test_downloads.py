from __future__ import annotations

import os
import shutil

import pytest

from scripts.extension.downloads import fetched, wheel_cache
from scripts.extension.errors import BuildError
from scripts.extension.locks import Pin
from scripts.extension.targets import platform_named

NAME = "torch-2.13.0+cpu-cp311-cp311-manylinux_2_28_x86_64.whl"
LINUX = platform_named("linux-x64")


@pytest.fixture
def index(make_wheel, tmp_path, monkeypatch):
    """A folder that is all that pip knows, with one wheel; the cache is empty."""
    monkeypatch.setenv("HANDFIT_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("PIP_CONFIG_FILE", os.devnull)
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path / "index"))
    return make_wheel(NAME, folder=tmp_path / "index")


def test_downloaded_once(index, monkeypatch):
    pin = Pin("torch", "2.13.0+cpu", index.sha256)
    (wheel,) = fetched([pin], LINUX, "3.11")
    assert wheel.path == wheel_cache() / NAME
    assert wheel.path.read_bytes() == index.path.read_bytes()
    index.path.unlink()
    monkeypatch.setenv("PATH", "")
    assert fetched([pin], LINUX, "3.11") == [wheel]
    assert [path.name for path in wheel_cache().iterdir()] == [NAME]


def test_a_hash_that_the_index_does_not_have(index):
    pin = Pin("torch", "2.13.0+cpu", "0" * 64)
    with pytest.raises(BuildError, match=r"torch 2\.13\.0\+cpu for linux-x64, Python 3\.11 could not .*hash"):
        fetched([pin], LINUX, "3.11")
    assert not list(wheel_cache().glob("*"))


def test_a_damaged_wheel_in_the_cache_that_cannot_be_replaced(index, make_wheel):
    """As without a network."""
    pin = Pin("torch", "2.13.0+cpu", index.sha256)
    wheel_cache().mkdir(parents=True)
    damaged = wheel_cache() / NAME
    damaged.write_bytes(index.path.read_bytes()[:-9])
    index.path.unlink()
    make_wheel(NAME.replace("cp311", "cp313"), folder=wheel_cache())
    with pytest.raises(BuildError) as caught:
        fetched([pin], LINUX, "3.11")
    assert f"; {damaged} has another hash than the lock, and may be damaged; " in str(caught.value)
    assert "cp313" not in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_cache_that_cannot_be_written(index, tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("HANDFIT_CACHE", str(tmp_path / "file"))
    with pytest.raises(BuildError, match=r"wheels cannot be kept here .*HANDFIT_CACHE"):
        fetched([Pin("torch", "2.13.0+cpu", index.sha256)], LINUX, "3.11")


def test_a_damaged_wheel_in_the_cache_is_replaced(index):
    wheel_cache().mkdir(parents=True)
    (wheel_cache() / NAME).write_bytes(index.path.read_bytes() + b"x")
    (wheel,) = fetched([Pin("torch", "2.13.0+cpu", index.sha256)], LINUX, "3.11")
    assert wheel.sha256 == index.sha256


def test_a_wheel_that_was_put_into_the_cache_by_hand(index):
    wheel_cache().mkdir(parents=True)
    (wheel_cache() / "notes.whl").write_text("not a wheel's name")
    pin = Pin("torch", "2.13.0+cpu", index.sha256)
    shutil.move(index.path, wheel_cache())
    (wheel,) = fetched([pin], LINUX, "3.11")
    assert wheel.path == wheel_cache() / NAME


def test_what_cannot_be_had_is_one_sentence(index):
    with pytest.raises(BuildError) as caught:
        fetched([Pin("torch", "2.13.0+cpu", index.sha256)], LINUX, "3.13")
    message = str(caught.value)
    assert message.startswith("torch 2.13.0+cpu for linux-x64, Python 3.13 could not be downloaded (")
    assert str(wheel_cache()) in message
    assert "--torch none" in message
    assert "\n" not in message
