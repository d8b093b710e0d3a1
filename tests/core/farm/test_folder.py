"""Folders of tasks: whose turn it is, what is sealed, and what is left of those who ended in the middle."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from handfit_core.errors import OutputError
from handfit_core.farm import folder as folders
from handfit_core.farm.folder import STALE, Claim, Lost, TaskFolder, Watch, files_in, parts_in
from handfit_core.files import written_whole

ID = "0123456789abcdef"
linux = pytest.mark.skipif(
    sys.platform != "linux", reason="only Linux tells which processes run, and always has links"
)


@pytest.fixture
def folder(tmp_path) -> TaskFolder:
    return TaskFolder(tmp_path, "clip")


def claimed(folder: TaskFolder) -> Claim:
    claim = Watch().claim(folder, ID)
    assert claim is not None
    return claim


def of_another_machine(folder: TaskFolder) -> Claim:
    """A claim of a process that nobody here can see."""
    claim = claimed(folder)
    sign = {**claim.content, "host": "elsewhere", "boot": "another"}
    folder.running.write_text(json.dumps(sign))
    return Claim(folder, sign, inherited=False)


def with_results(folder: TaskFolder, **files: bytes) -> tuple[Path, dict[str, dict[str, object]]]:
    part = folder.part()
    for name, held in files.items():
        (part / name).write_bytes(held)
    return part, files_in(part, files)


def test_a_task_is_one_process_s_alone(folder):
    claim = claimed(folder)
    assert Watch().claim(folder, ID) is None
    claim.release()
    assert not folder.path.exists(), "an empty folder says nothing"
    assert claimed(folder).inherited is False


@linux
@pytest.mark.parametrize("reaped", [True, False])
def test_what_a_process_of_this_machine_has_left_is_taken_at_once(folder, tmp_path, reaped):
    code = (
        "import os, sys; from pathlib import Path; from handfit_core.farm.folder import *\n"
        "f = TaskFolder(Path(sys.argv[1]), 'clip'); Watch().claim(f, sys.argv[2]); f.part()\n"
        "os.kill(os.getpid(), 9)"
    )
    killed = subprocess.Popen([sys.executable, "-c", code, str(tmp_path), ID])
    if reaped:
        killed.wait()
    else:  # it has ended, and is there until it is asked for
        os.waitid(os.P_PID, killed.pid, os.WEXITED | os.WNOWAIT)
    assert folder.worked_on == ""
    claim = claimed(folder)
    assert claim.inherited
    assert len(parts_in(tmp_path)) == 1
    folder.remove_parts()
    assert not parts_in(tmp_path)
    claim.check()
    killed.wait()


def test_another_machine_is_waited_for_by_the_clock_of_who_waits(folder, monkeypatch):
    """Its own clock may be wrong by any amount, and change."""
    now = [1000.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    theirs = of_another_machine(folder)
    watch = Watch()
    for clock in (0.0, 4e9, 5.0, 5.0 + 1e-3, 2e9):
        os.utime(folder.running, (clock, clock))
        for _ in range(3):
            assert watch.claim(folder, ID) is None
            now[0] += 0.3 * STALE
    assert watch.claim(folder, ID) is None, "it gave a sign since the look before the last"
    now[0] += 0.2 * STALE
    claim = watch.claim(folder, ID)
    assert claim is not None
    assert claim.inherited
    with pytest.raises(Lost):
        theirs.check()
    theirs.release()
    claim.check()


def test_two_who_find_the_same_one_dead_do_not_both_begin(folder, monkeypatch):
    now = [1000.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    of_another_machine(folder)
    first, second = Watch(), Watch()
    assert first.claim(folder, ID) is second.claim(folder, ID) is None
    now[0] += STALE + 1
    seen = folder.running.read_text()
    claim = first.claim(folder, ID)
    assert claim is not None
    assert not folders._put(folder, {}, seen), "the other one has looked before, and comes late"
    assert second.claim(folder, ID) is None
    claim.check()


def test_a_sign_that_another_has_moved_by_mistake_is_put_back(folder):
    claim = claimed(folder)
    folder.running.unlink()
    claim.check()
    assert Watch().claim(folder, ID) is None
    folder.running.unlink()
    other = of_another_machine(folder)
    with pytest.raises(Lost, match="another process"):
        claim.check()
    claim.release()
    other.check()


def test_what_was_given_up_while_its_disk_was_away_is_free(folder, tmp_path):
    claim = claimed(folder)
    away = tmp_path.with_name("away")
    tmp_path.rename(away)
    with pytest.raises(OSError, match="No such file"):
        claim.check()
    claim.beat()  # in time: nothing is said yet
    claim.last -= STALE + folders.BEAT
    with pytest.raises(Lost, match="gone"):
        claim.beat()
    claim.release()
    assert not tmp_path.exists()
    with pytest.raises(OutputError):
        folder.seal(ID, {}, {}, 1.0)
    with pytest.raises(OutputError):
        folder.fail(ID, {}, {})
    with pytest.raises(OutputError):
        Watch().claim(folder, ID)
    assert not tmp_path.exists()
    away.rename(tmp_path)
    assert claimed(folder).inherited


def test_many_processes_that_find_a_dead_one(folder, tmp_path):
    """Each takes it over if it can; in the end it is one's alone."""
    code = (
        "import sys; from pathlib import Path; from handfit_core.farm import folder as f\n"
        "folder, watch, won = f.TaskFolder(Path(sys.argv[1]), 'clip'), f.Watch(), 0\n"
        "for line in sys.stdin:\n"
        "    claim = watch.claim(folder, 'x')\n"
        "    print('mine' if claim else 'not', flush=True); sys.stdin.readline()\n"
        "    try:\n"
        "        claim and claim.check(); print(bool(claim), flush=True); sys.stdin.readline()\n"
        "    except f.Lost: print(False, flush=True); sys.stdin.readline()\n"
        "    if claim: claim.release()\n"
        "    print('released', flush=True)\n"
    )
    command = [sys.executable, "-c", code, str(tmp_path)]
    several = [
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) for _ in range(4)
    ]

    def told() -> list[str]:
        for each in several:
            print(file=each.stdin, flush=True)
        return [each.stdout.readline().strip() for each in several if each.stdout]

    try:
        for _ in range(25):
            folder.path.mkdir(exist_ok=True)
            sign = {"format": "manient-task", "version": 1, "id": "x", "token": "t", "boot": folders._boot()}
            sign |= {"host": socket.gethostname(), "pid": 2**31, "started": "1"}
            folder.running.write_text(json.dumps(sign))
            assert told().count("mine") >= (1 if sys.platform == "linux" else 0)
            assert told().count("True") == (1 if sys.platform == "linux" else 0)
            assert told() == ["released"] * 4
            assert not parts_in(tmp_path)
    finally:
        for each in several:
            each.kill()
            each.communicate()


DAMAGED = {
    "empty": b"",
    "not JSON": b"{",
    "no object": b"[1, 2]",
    "numbers": b"1" * 5000,
    "deep": b"[" * 100_000,
    "not UTF-8": b"\xff\xfe{}",
    "fields": json.dumps({"format": "manient-task", "version": 1, "id": ID, "files": 3}).encode(),
    "kinds": json.dumps(
        {
            **{
                "format": "manient-task",
                "version": 1,
                "id": ID,
                "files": {"a": {}},
                "result": [],
                "pid": "x",
            },
            **{"token": [], "boot": {}, "host": 7, "started": None},
        }
    ).encode(),
    "newer": json.dumps({"format": "manient-task", "version": 2, "id": ID}).encode(),
}


@pytest.mark.parametrize("damage", DAMAGED)
@pytest.mark.parametrize("file", ["done", "failed", "running"])
def test_files_of_ours_that_are_damaged_say_nothing(folder, damage, file):
    folder.path.mkdir()
    getattr(folder, file).write_bytes(DAMAGED[damage])
    assert folder.sealed(ID) is None
    assert folder.failures(ID) is None
    assert folder.kept(ID) == {}
    assert isinstance(folder.worked_on, str)
    assert isinstance(folder.owner, str)
    claim = Watch().claim(folder, ID)
    if file == "running":
        assert claim is None, "who has written it may be at it, on another machine"
    else:
        assert claim is not None
        part, files = with_results(folder, result=b"r")
        folder.take_in(part, files)
        folder.seal(ID, {"status": "ok"}, files, 1.0)
        assert folder.sealed(ID)
        assert not folder.failed.exists()


@pytest.mark.parametrize("how", ["absolute", "above", pytest.param("link", marks=linux), "own"])
@pytest.mark.parametrize("file", ["done", "failed"])
def test_only_what_lies_in_its_folder_goes_with_a_task(folder, tmp_path, how, file):
    """Others may write what a seal says."""
    victim = tmp_path / "of the user" / "a.txt"
    victim.parent.mkdir()
    victim.write_text("words")
    folder.path.mkdir()
    if how == "link":
        (folder.path / "link").symlink_to(victim.parent)
    (folder.path / "a.txt").write_text("words")
    names = {"absolute": str(victim), "above": "../of the user/a.txt", "link": "link/a.txt", "own": "a.txt"}
    getattr(folder, file).write_text(
        json.dumps(
            {
                **{"format": "manient-task", "version": 1, "id": ID, "result": {"status": "ok"}},
                "files": {names[how]: {"size": 5, "sha256": ""}},
            }
        )
    )
    folder.discard(ID)
    assert victim.exists()
    assert (folder.path / "a.txt").exists() == (how != "own")
    assert how in ("link", "own") or folder.sealed(ID) is None


def test_results_are_moved_whole_and_once(folder):
    claimed(folder)
    part, files = with_results(folder, a=b"one", b=b"two")
    (part / "b").rename(part / "elsewhere")
    with pytest.raises(OutputError):
        folder.take_in(part, files)
    assert not (folder.path / "a").exists(), "nothing is moved where something is missing"
    (part / "elsewhere").rename(part / "b")
    (part / "a").replace(folder.path / "a")  # as far as another call got
    folder.take_in(part, files)
    folder.take_in(part, files)
    folder.seal(ID, {"status": "ok"}, files, 1.0)
    assert folder.sealed(ID)
    (folder.path / "b").unlink()
    assert folder.sealed(ID) is None
    assert folder.sealed("another id") is None


def test_a_result_that_changes_after_it_was_told_of_is_not_taken(folder):
    claimed(folder)
    part, files = with_results(folder, a=b"one")
    (part / "a").write_bytes(b"one and more")
    with pytest.raises(OutputError, match="changed since"):
        folder.take_in(part, files)


def test_only_a_task_s_own_parts_are_removed(tmp_path):
    one, two = TaskFolder(tmp_path, "a"), TaskFolder(tmp_path, "a-2")
    mine, other = one.part(), two.part()
    one.remove_parts()
    assert not mine.exists()
    assert other.exists()


def test_nothing_is_written_into_a_part_that_was_taken_away(folder):
    part = folder.part()
    part.rmdir()
    with pytest.raises(OutputError), written_whole(part / "result.glb") as beside:
        beside.write_bytes(b"late")
    assert not part.exists()


def test_flat_results_lie_beside_each_other(tmp_path):
    one, two = (TaskFolder(tmp_path, name, flat=True) for name in ("a", "b"))
    for folder in (one, two):
        claim = claimed(folder)
        part, files = with_results(folder, **{f"{folder.name}.glb": b"held"})
        assert part == tmp_path
        folder.take_in(part, files)
        folder.seal(ID, {"status": "ok"}, files, 1.0)
        claim.release()
    assert one.sealed(ID)
    assert two.sealed(ID)
    one.part()
    assert one.sealed(ID) is None, "its results are being replaced, one by one"
    assert two.sealed(ID)
