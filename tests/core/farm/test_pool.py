"""The pool with a program that does its tasks badly: what is tried again, what is told, what stays."""

from __future__ import annotations

import os
import sys

import pytest

from handfit_core.farm.pool import Pool
from tests.core.farm.peers import COMMAND, attempts, content, plan_of

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="the peer ends as processes do on POSIX")


@pytest.fixture(autouse=True)
def log(tmp_path, monkeypatch):
    """Where the program writes down what it does; nobody waits long for another attempt."""
    monkeypatch.setenv("PEER_LOG", str(tmp_path / "log"))
    monkeypatch.setattr("handfit_core.farm.pool.BACK_OFF", (0.0,))
    return tmp_path / "log"


def exists(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


CURED = [
    "fine",
    "a-crash1",
    "a-kill2",
    "an-exit1",
    "half2",
    "memory1",
    "gone1",
    "disk1",
    "a-nonsense",
    "deep",
]


@pytest.mark.parametrize("jobs", [1, 3])
def test_what_another_attempt_cures(tmp_path, log, jobs):
    out = tmp_path / "out"
    plan = plan_of(out, CURED)
    with Pool(COMMAND, jobs=jobs) as pool:
        results = pool.run(plan, plan.tasks)
    assert {r.name: r.status for r in results} == dict.fromkeys(CURED, "ok")
    for task in plan.tasks:
        seal = plan.folder(task).sealed(task.id)
        assert seal is not None
        assert len(seal["files"]) == 2
        for name in seal["files"]:
            assert (out / task.name / name).read_bytes() == content(task.name, name.rpartition(".")[2])
    for result in results:
        often = "".join(c for c in result.name if c.isdigit())
        assert len(result.attempts) == int(often or 0), result.name
    assert sorted(p.name for p in out.iterdir()) == sorted([*CURED, "plans"]), "no part is left"
    assert not list(out.rglob("running.json"))
    assert not list(out.rglob("failed.json"))
    assert not any(exists(a["pid"]) for a in attempts(log))
