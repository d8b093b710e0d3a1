"""Files are written whole or not at all."""

import errno
import os
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest

from handfit_core.common.errors import OutputError, TakeError
from handfit_core.common.files import (
    check_room,
    check_writable,
    is_file,
    output_path,
    read_file,
    storable,
    written_whole,
)


@pytest.fixture
def old(tmp_path: Path) -> Iterator[Path]:
    """A file that is there before, and alone and unchanged after."""
    path = tmp_path / "result.npz"
    path.write_text("old")
    yield path
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_writes_and_makes_the_folder(tmp_path):
    path = tmp_path / "a" / "b" / ("x" * 250 + ".glb")
    check_writable(path)
    assert list(tmp_path.iterdir()) == []
    with written_whole(path) as beside:
        assert beside.suffix == ".glb"
        assert beside.parent == path.parent
        beside.write_text("new")
        assert not path.exists()
    assert path.read_text() == "new"
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize(
    ("error", "raised", "said"),
    [
        (ValueError("bad"), ValueError, "bad"),
        (KeyboardInterrupt(), KeyboardInterrupt, None),
        (OSError(errno.ENOSPC, "No space left on device"), OutputError, r"result\.npz.*No space left"),
    ],
)
def test_an_error_leaves_what_was_there(old, error, raised, said):
    with pytest.raises(raised, match=said), written_whole(old) as beside:  # noqa: PT012
        beside.write_text("half")
        raise error


def test_what_cannot_be_read_again_is_not_written(old):
    def read(beside: Path) -> None:
        assert beside.read_text() == "new"
        raise TakeError(f"{beside}: it is damaged")

    said = r"result\.npz: nothing was written.*\(it is damaged\)"
    with pytest.raises(OutputError, match=said), written_whole(old, read) as beside:
        beside.write_text("new")


@pytest.mark.skipif(not hasattr(errno, "EDQUOT"), reason="this system has no quotas")
def test_what_only_the_disk_itself_reports_is_seen(old, monkeypatch):
    """Network disks and quotas accept a write and refuse it when it is to be kept."""

    def refuse(_handle: int) -> None:
        raise OSError(errno.EDQUOT, "Disk quota exceeded")

    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(OutputError, match=r"quota.*free some space"), written_whole(old) as beside:
        beside.write_text("new")


def check_written(path: str | Path) -> None:
    with written_whole(path) as beside:
        beside.write_text("x")


@pytest.mark.parametrize("write", [check_writable, check_written])
@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("", "this is a folder"),
        ("result.npz/out.npz", "cannot write here|choose a folder that you may write to"),
        ("a\0b.npz", "choose another name"),
        ("a\ud800b.npz", "choose another name"),
        ("x" * 300 + ".npz", "choose another name"),
        ("x" * 5000 + "/a.npz", "choose another name"),
    ],
    ids=["folder", "in a file", "zero", "surrogate", "long", "very long"],
)
def test_names_that_no_file_can_have(old, name, said, write):
    with pytest.raises(OutputError, match=said) as caught:
        write(old.parent / name)
    assert len(str(caught.value)) < 600
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("name", ["http://a/b.npz", "http:/a/b.npz", "s3://a/b.npz", "file:///tmp/b.npz"])
@pytest.mark.parametrize("write", [check_writable, check_written, output_path])
def test_an_address_is_no_output(write, name):
    with pytest.raises(OutputError, match="this is an address"):
        write(name)


def test_results_are_ordinary_files(tmp_path):
    before = os.umask(0o022)
    try:
        with written_whole(tmp_path / "a.txt") as beside:
            beside.write_text("x")
        assert os.umask(0o022) == 0o022
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.txt").stat().st_mode) == 0o644


def test_only_files_are_read_and_only_so_much_of_them(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"12345")
    assert read_file(path, 5) == b"12345"
    with pytest.raises(OSError, match="too large"):
        read_file(path, 4)
    with path.open("wb") as stream:
        stream.truncate(1 << 40)  # sparse, takes no room
    with pytest.raises(OSError, match="too large: 1099511 MB"):
        read_file(path, 1 << 31)
    with pytest.raises(FileNotFoundError):
        read_file(tmp_path / "nowhere", 5)
    with pytest.raises(OSError, match="folder"):
        read_file(tmp_path, 5)
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe")  # nobody writes into it: opening it as a file would wait for ever
        for path in (tmp_path / "pipe", Path("/dev/zero"), Path("/dev/tty")):
            with pytest.raises(OSError, match="no file, but a pipe, a device"):
                read_file(path, 5)


def test_names_that_no_file_can_have_are_no_files():
    assert is_file(__file__)
    for name in ("a" * 5000, "a\0b", "/nowhere/\udcff"):
        assert not is_file(name)
    assert storable("Hände\udcff.png") == "Hände?.png"


@pytest.mark.skipif(not hasattr(os, "posix_fallocate"), reason="this system always writes")
@pytest.mark.parametrize("asked_for", [True, False])
def test_room_is_asked_for_or_written_and_given_back(tmp_path, monkeypatch, asked_for):
    import resource

    if not asked_for:
        monkeypatch.delattr(os, "posix_fallocate")
    check_room(tmp_path / "a.abc", 3_000_000)
    assert (tmp_path / "a.abc").stat().st_size == 0
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2_000_000, hard))
    try:
        with pytest.raises(OutputError, match="free some space"), written_whole(tmp_path / "b.abc") as beside:
            check_room(beside, 3_000_000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert [p.name for p in tmp_path.iterdir()] == ["a.abc"]


@pytest.mark.skipif(os.name == "nt", reason="needs pipes with names")
@pytest.mark.parametrize("write", [check_writable, check_written])
def test_what_is_no_file_is_not_replaced(tmp_path, write):
    node, link = tmp_path / "node", tmp_path / "link"
    os.mkfifo(node)
    link.symlink_to("node")
    there = os.lstat(node)
    for path in (node, link):
        with pytest.raises(OutputError, match="a pipe, a device"):
            write(path)
    assert (os.lstat(node).st_ino, os.lstat(node).st_mode) == (there.st_ino, there.st_mode)
    assert sorted(tmp_path.iterdir()) == [link, node]


def test_a_tilde_is_the_users_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("USERPROFILE", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    with written_whole("~/a/x.npz") as beside:
        beside.write_text("new")
    assert (tmp_path / "home" / "a" / "x.npz").read_text() == "new"
    assert not (tmp_path / "~").exists()


def test_an_input_is_no_output(tmp_path):
    (tmp_path / "a.npz").write_text("old")
    (tmp_path / "b.npz").hardlink_to(tmp_path / "a.npz")
    for inputs in ([tmp_path / "a.npz"], ["nowhere", "a\0b", str(tmp_path / "b.npz")]):
        with pytest.raises(OutputError, match="this is an input"):
            check_writable(tmp_path / "a.npz", inputs)
    check_writable(tmp_path / "c.npz", [tmp_path / "a.npz"])
