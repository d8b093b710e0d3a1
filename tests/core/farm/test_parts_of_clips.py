"""Clips whose hands are found in parts: what comes first, what is left of it, what fails with it."""

from __future__ import annotations

import sys
from dataclasses import replace

import pytest

from handfit_core.farm.collect import Report
from handfit_core.farm.pool import Pool
from tests.core.farm.peers import COMMAND, attempts, plan_of, planned

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="the peer ends as processes do on POSIX")


@pytest.fixture(autouse=True)
def log(tmp_path, monkeypatch):
    """Where the peer writes down what it does; nobody waits long for another attempt."""
    monkeypatch.setenv("PEER_LOG", str(tmp_path / "log"))
    monkeypatch.setattr("handfit_core.farm.pool.BACK_OFF", (0.0,))
    monkeypatch.setattr("handfit_core.farm.pool._ELSEWHERE", 0.1)
    return tmp_path / "log"


def clip_of(output, *names: str):
    """A plan with a clip, and a task for each of its parts."""
    plan = plan_of(output, ["clip", *names])
    clip, *parts = plan.tasks
    clip = replace(clip, needs=tuple(part.id for part in parts), cost=100.0)
    return planned(plan, tasks=(clip, *(replace(part, of=clip.id, part="1-9") for part in parts)))


def test_parts_come_first_and_go_when_the_clip_is_done(tmp_path, log):
    plan = clip_of(tmp_path / "out", "one", "two-crash1")
    with Pool(COMMAND, jobs=2) as pool:
        results = pool.run(plan, plan.tasks)
    assert [r.status for r in results] == ["ok"] * 3
    assert attempts(log)[-1]["task"] == "clip"
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["clip", "plans"]
    report = Report([plan])
    report.look()
    assert [(r.name, r.status) for r in report.results] == [("clip", "ok")]
    begun = len(attempts(log))
    with Pool(COMMAND) as pool:
        assert [r.status for r in pool.run(plan, plan.tasks)] == ["ok"] * 3
    assert len(attempts(log)) == begun, "parts of a clip that is done need not be done again"


def test_a_clip_fails_with_its_parts(tmp_path, log):
    plan = clip_of(tmp_path / "out", "one", "two-input")
    with Pool(COMMAND) as pool:
        clip, one, two = pool.run(plan, plan.tasks)
    assert [r.status for r in (clip, one, two)] == ["failed", "ok", "failed"]
    assert two.error in clip.error
    assert "clip" not in {each["task"] for each in attempts(log)}


def test_a_clip_alone_waits_for_its_parts(tmp_path, log):
    plan = clip_of(tmp_path / "out", "one")
    with Pool(COMMAND) as pool:
        (result,) = pool.run(plan, plan.tasks[:1], wait=False)
        assert (result.status, result.error) == ("running", "parts of the clip are not done yet")
        pool.run(plan, plan.tasks[1:])
        (result,) = pool.run(plan, plan.tasks[:1], wait=False)
    assert result.status == "ok"
    assert [each["task"] for each in attempts(log)] == ["one", "clip"]


def test_a_clip_alone_fails_with_parts_that_another_process_has_given_up(tmp_path, log):
    """As on farms, where each task is a process of its own: it would wait for ever."""
    plan = clip_of(tmp_path / "out", "one", "two-input")
    for number, status in ((1, "ok"), (2, "failed"), (0, "failed")):
        with Pool(COMMAND) as pool:
            (result,) = pool.run(plan, [plan.tasks[number]], wait=False)
        assert result.status == status
    assert "two-input: input" in result.error
    assert [each["task"] for each in attempts(log)] == ["one", "two-input"]
