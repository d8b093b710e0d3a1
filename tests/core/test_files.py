"""Files are written whole or not at all."""

from __future__ import annotations

import errno
import os
import socket
import stat
from pathlib import Path

import pytest

from handfit_core.errors import OutputError, TakeError
from handfit_core.files import (
    check_room,
    check_writable,
    is_file,
    output_path,
    read_file,
    storable,
    written_whole,
)


def test_writes_and_makes_the_folder(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b" / "result.glb"
    with written_whole(path) as beside:
        assert beside.suffix == ".glb"
        assert beside.parent == path.parent
        beside.write_text("new")
        assert not path.exists()
    assert path.read_text() == "new"
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("error", [ValueError("bad"), KeyboardInterrupt()])
def test_an_error_leaves_what_was_there(tmp_path: Path, error: BaseException) -> None:
    path = tmp_path / "result.npz"
    path.write_text("old")
    with pytest.raises(type(error)), written_whole(path) as beside:  # noqa: PT012
        beside.write_text("half")
        raise error
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_full_disk_is_an_output_error_and_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "result.npz"
    path.write_text("old")
    with pytest.raises(OutputError, match=r"result\.npz.*No space left"), written_whole(path) as beside:  # noqa: PT012
        beside.write_text("half")
        raise OSError(28, "No space left on device")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_of_that_name_is_an_output_error(tmp_path: Path) -> None:
    (tmp_path / "result.npz").mkdir()
    with pytest.raises(OutputError, match="this is a folder"), written_whole(tmp_path / "result.npz"):
        pass
    assert [p.name for p in tmp_path.iterdir()] == ["result.npz"]


def test_a_file_in_the_folders_place_names_the_remedy(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("x")
    with (
        pytest.raises(OutputError, match="choose a folder that you may write to"),
        written_whole(tmp_path / "taken" / "result.npz"),
    ):
        pytest.fail("the block must not run")


@pytest.mark.skipif(os.name != "posix", reason="file modes are POSIX only")
def test_check_writable_says_so_before_and_leaves_nothing(tmp_path: Path) -> None:
    check_writable(tmp_path / "new" / "folder" / "file.npz")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(OutputError, match="this is a folder"):
        check_writable(tmp_path)
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError, match="cannot write here"):
        check_writable(tmp_path / "file" / "out.npz")


@pytest.mark.parametrize("name", ["a\0b.npz", "a\ud800b.npz", "x" * 300 + ".npz", "x" * 5000 + "/a.npz"])
def test_names_that_no_file_can_have(tmp_path: Path, name: str) -> None:
    def write(path: Path) -> None:
        with written_whole(path) as beside:
            beside.write_text("x")

    for writing in (check_writable, write):
        with pytest.raises(OutputError, match="choose another name") as caught:
            writing(tmp_path / name)
        assert len(str(caught.value)) < 600
        assert str(caught.value).isprintable()
    assert list(tmp_path.iterdir()) == []


def test_a_name_may_be_as_long_as_the_system_allows(tmp_path: Path) -> None:
    path = tmp_path / ("x" * 250 + ".npz")
    check_writable(path)
    with written_whole(path) as beside:
        beside.write_text("new")
    assert path.read_text() == "new"


def test_results_are_ordinary_files(tmp_path: Path) -> None:
    before = os.umask(0o022)
    try:
        with written_whole(tmp_path / "a.txt") as beside:
            beside.write_text("x")
        assert os.umask(0o022) == 0o022
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.txt").stat().st_mode) == 0o644


def test_only_files_are_read_and_only_so_much_of_them(tmp_path: Path) -> None:
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


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_what_is_no_file_is_not_waited_for(tmp_path: Path) -> None:
    """Nobody writes into this pipe: opening it as a file would wait for ever."""
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero"), Path("/dev/tty")):
        with pytest.raises(OSError, match="no file, but a pipe, a device"):
            read_file(path, 5)


def test_names_that_no_file_can_have_are_no_files() -> None:
    assert is_file(__file__)
    for name in ("a" * 5000, "a\0b", "/nowhere/\udcff"):
        assert not is_file(name)
    assert storable("Hände\udcff.png") == "Hände?.png"


@pytest.mark.skipif(os.name != "posix", reason="limits of a process are POSIX only")
def test_room_is_asked_for_and_given_back(tmp_path: Path) -> None:
    import resource

    path = tmp_path / "a.abc"
    path.write_text("old")
    check_room(path, 100_000)
    assert path.stat().st_size == 0
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, hard))
    try:
        with pytest.raises(OutputError, match="free some space"), written_whole(tmp_path / "b.abc") as beside:
            check_room(beside, 100_000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert [p.name for p in tmp_path.iterdir()] == ["a.abc"]


@pytest.mark.skipif(not hasattr(os, "posix_fallocate"), reason="this system always writes")
def test_room_is_written_where_it_cannot_be_asked_for(tmp_path: Path, monkeypatch) -> None:
    import resource

    monkeypatch.delattr(os, "posix_fallocate")
    check_room(tmp_path / "a.abc", 3_000_000)
    assert (tmp_path / "a.abc").stat().st_size == 0
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2_000_000, hard))
    try:
        with pytest.raises(OSError, match="too large"):
            check_room(tmp_path / "a.abc", 3_000_000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.skipif(not hasattr(errno, "EDQUOT"), reason="this system has no quotas")
def test_what_only_the_disk_itself_reports_is_seen(tmp_path: Path, monkeypatch) -> None:
    """Network disks and quotas accept a write and refuse it when it is to be kept."""
    path = tmp_path / "a.npz"
    path.write_text("old")

    def refuse(_handle: int) -> None:
        raise OSError(errno.EDQUOT, "Disk quota exceeded")

    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(OutputError, match=r"quota.*free some space"), written_whole(path) as beside:
        beside.write_text("new")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def put_pipe(path: Path) -> None:
    os.mkfifo(path)


def put_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))


def put_device(path: Path) -> None:
    try:
        os.mknod(path, stat.S_IFCHR | 0o666, os.makedev(1, 3))
    except PermissionError:
        pytest.skip("only root makes devices")


@pytest.mark.skipif(os.name == "nt", reason="needs pipes with names")
@pytest.mark.parametrize("put", [put_pipe, put_socket, put_device])
def test_what_is_no_file_is_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, put) -> None:
    monkeypatch.chdir(tmp_path)  # a socket's name is short
    put(Path("node"))
    Path("link").symlink_to("node")
    there = os.lstat("node")
    for name in ("node", "link"):
        with pytest.raises(OutputError, match="a pipe, a device"):
            check_writable(name)
        with pytest.raises(OutputError, match="a pipe, a device"), written_whole(name) as beside:
            beside.write_text("new")
    assert (os.lstat("node").st_ino, os.lstat("node").st_mode) == (there.st_ino, there.st_mode)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link", "node"]


@pytest.mark.parametrize("name", ["http://a/b.npz", "http:/a/b.npz", "s3://a/b.npz", "file:///tmp/b.npz"])
def test_an_address_is_no_output(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.chdir(tmp_path)
    for write in (check_writable, output_path):
        with pytest.raises(OutputError, match="this is an address"):
            write(name)
    with pytest.raises(OutputError, match="this is an address"), written_whole(name):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_tilde_is_the_users_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("USERPROFILE", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    with written_whole("~/a/x.npz") as beside:
        beside.write_text("new")
    assert (tmp_path / "home" / "a" / "x.npz").read_text() == "new"
    assert not (tmp_path / "~").exists()


def test_an_input_is_no_output(tmp_path: Path) -> None:
    (tmp_path / "a.npz").write_text("old")
    (tmp_path / "b.npz").hardlink_to(tmp_path / "a.npz")
    for inputs in ([tmp_path / "a.npz"], ["nowhere", "a\0b", str(tmp_path / "b.npz")]):
        with pytest.raises(OutputError, match="this is an input"):
            check_writable(tmp_path / "a.npz", inputs)
    check_writable(tmp_path / "c.npz", [tmp_path / "a.npz"])


def test_what_cannot_be_read_again_is_not_written(tmp_path: Path) -> None:
    path = tmp_path / "result.npz"
    path.write_text("old")

    def read(beside: Path) -> None:
        assert beside.read_text() == "new"
        raise TakeError(f"{beside}: it is damaged")

    with pytest.raises(OutputError, match=r"result\.npz: nothing was written.*\(it is damaged\)"):  # noqa: SIM117
        with written_whole(path, read) as beside:
            beside.write_text("new")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
