"""What lies in a task's folder and is not as it was written: the batch goes on, and says so."""

from __future__ import annotations

import itertools
import json
import sys

import pytest

from handfit_core.farm.collect import Report
from handfit_core.farm.plan import plans_in
from handfit_core.farm.pool import Pool
from handfit_core.farm.show import ProgressReporter
from tests.core.farm.peers import COMMAND, attempts, plan_of

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="the peer ends as processes do on POSIX")

STRANGE = [None, "words", [1], {"side": 1}, [{}], 10**400, float("nan"), {"a": float("inf")}]
FIELDS = [
    "hands",
    "frames",
    "seconds",
    "warnings",
    "attempts",
    "files",
    "character",
    "status",
    "name",
    "error",
]


@pytest.fixture(autouse=True)
def log(tmp_path, monkeypatch):
    monkeypatch.setenv("PEER_LOG", str(tmp_path / "log"))
    return tmp_path / "log"


def done(plan) -> Report:
    """A batch as its command does it."""
    report = Report(plans_in(plan.output))
    report.look()
    with Pool(COMMAND) as pool:
        pool.run(plan, plan.tasks, ProgressReporter(list(plan.tasks), "text", report))
    report.write()
    return report


@pytest.mark.parametrize("field", FIELDS)
def test_strange_fields_end_no_batch_and_cost_no_result(tmp_path, log, field):
    names = [f"n{i}" for i in range(len(STRANGE))]
    plan = plan_of(tmp_path / "out", [*names, "n-input"])
    done(plan)
    before = len(attempts(log))
    for name, value in itertools.chain(zip(names, STRANGE, strict=True), [("n-input", {"a": 1})]):
        folder = plan.folder(plan.task(name))
        file = folder.failed if name == "n-input" else folder.done
        content = json.loads(file.read_text())
        content["result"][field] = value
        file.write_text(json.dumps(content))
    plan = plan_of(tmp_path / "out", [*names, "n-input", "open"])
    results = {result.name: result for result in done(plan).results}
    assert [results[name].status for name in [*names, "open"]] == ["ok"] * 9
    assert [each["task"] for each in attempts(log)[before:] if each["task"] != "n-input"] == ["open"]
    if field not in ("status", "name"):  # which follow from where it lies
        assert f"what was noted of its {field} is damaged" in results["n2"].warnings


@pytest.mark.parametrize("field", ["files", "result", "id", "format"])
@pytest.mark.parametrize("what", ["done", "failed"])
def test_seals_that_say_nothing_are_none(tmp_path, log, what, field):
    names = [f"n{i}{'-input' * (what == 'failed')}" for i in range(len(STRANGE))]
    plan = plan_of(tmp_path / "out", names)
    done(plan)
    for name, value in zip(names, STRANGE, strict=True):
        folder = plan.folder(plan.task(name))
        file = folder.done if what == "done" else folder.failed
        content = json.loads(file.read_text())
        content[field] = value
        file.write_text(json.dumps(content))
    plan = plan_of(tmp_path / "out", [*names, "open"])
    results = done(plan).results
    assert results[-1].status == "ok"
    assert {result.status for result in results[:-1]} <= {"ok", "failed"}
