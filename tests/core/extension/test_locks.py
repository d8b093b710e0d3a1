from __future__ import annotations

import pytest

from scripts.extension.errors import BuildError
from scripts.extension.locks import BUILD_LOCK, FOLDER, Lock, Pin, lock_path, lock_text, read_lock
from scripts.extension.parts import RUN_TIME
from scripts.extension.targets import PLATFORM_NAMES, PYTHONS, platform_named
from scripts.lock_wheels import CONSTRAINTS, versions

ALL = [(platform, python) for platform in PLATFORM_NAMES for python in PYTHONS]


@pytest.mark.parametrize(("platform", "python"), ALL)
def test_every_part_is_locked_or_said_to_be_missing(platform, python):
    lock = read_lock(lock_path(platform, python))
    assert {pin.name for pin in lock.pins} | set(lock.missing) == set(RUN_TIME)
    assert not {pin.name for pin in lock.pins} & set(lock.missing)
    no_cpu_build = (platform, python) == ("linux-x64", "3.13")
    assert set(lock.missing) == ({"torch"} if no_cpu_build else set())


@pytest.mark.parametrize(("platform", "python"), ALL)
def test_locks_have_the_versions_of_constraints(platform, python):
    """Where this fails, run `nox -s lock`."""
    lines = CONSTRAINTS.read_text(encoding="utf-8").splitlines()
    pinned = versions(lines, python, platform_named(platform).sys_platform)
    for pin in read_lock(lock_path(platform, python)).pins:
        assert pin.version.partition("+")[0] == pinned[pin.name], pin
    (tool,) = read_lock(BUILD_LOCK).pins
    assert tool.version == pinned[tool.name]


@pytest.mark.parametrize("python", PYTHONS)
def test_torch_on_linux_is_a_cpu_build(python):
    """The plain file for Linux is several GB of CUDA."""
    pins = [pin for pin in read_lock(lock_path("linux-x64", python)).pins if pin.name == "torch"]
    assert all(pin.version.endswith("+cpu") for pin in pins)


def test_locks_name_no_host():
    for path in FOLDER.iterdir():
        assert "://" not in path.read_text(encoding="utf-8"), path


def test_a_lock_is_read_as_it_was_written(tmp_path):
    lock = Lock(
        (Pin("torch", "2.13.0+cpu", "0" * 64), Pin("scipy", "1.15.3", "a" * 64)), {"x": "no file: none"}
    )
    path = tmp_path / "lock.txt"
    path.write_text(lock_text("A lock.", lock), encoding="utf-8")
    assert read_lock(path) == lock


def test_a_missing_lock_says_how_to_make_it(tmp_path):
    with pytest.raises(BuildError, match=r"linux-x64-py311\.txt: .*nox -s lock"):
        read_lock(lock_path("linux-x64", "3.11", tmp_path))


@pytest.mark.parametrize("line", ["scipy", "scipy==1.15.3", "scipy==1.15.3 --hash=sha256:12", "scipy>=1.15"])
def test_a_line_without_a_hash_is_refused(tmp_path, line):
    path = tmp_path / "lock.txt"
    path.write_text(f"# A lock.\n{line}\n", encoding="utf-8")
    with pytest.raises(BuildError, match="line 2: expected NAME==VERSION --hash"):
        read_lock(path)


def test_versions_by_python_and_platform():
    lines = [
        "# comment",
        'scipy==1.15.3; python_version < "3.12"  # why',
        'scipy==1.17.1; python_version >= "3.12"',
        'torch==2.13.0; sys_platform != "win32"',
        'torch==2.12.1; sys_platform == "win32"',
        "typing_extensions==4.16.0",
    ]
    assert versions(lines, "3.11", "linux") == {
        "scipy": "1.15.3",
        "torch": "2.13.0",
        "typing-extensions": "4.16.0",
    }
    assert versions(lines, "3.13", "win32")["scipy"] == "1.17.1"
    assert versions(lines, "3.13", "win32")["torch"] == "2.12.1"
