"""What `task` tells a farm: whose fault it is, and whether another machine may do better."""

from __future__ import annotations

import argparse
import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from handfit_core.errors import InputError, OutputError
from handfit_core.farm.commands import EXIT_LATER, add_running_arguments, task_exit_code
from handfit_core.farm.folder import TaskFolder, attempt
from handfit_core.farm.plan import PlanGone, plans_in
from handfit_core.farm.pool import ATTEMPTS, Pool
from handfit_core.farm.report import Result
from tests.core.farm.peers import COMMAND, ROOT, plan_of


def ended(*kinds: str, status: str = "failed") -> Result:
    return Result("a.mp4", "a", status, attempts=[attempt("so", kind, 1.0) for kind in kinds])


OK = Result("b.mp4", "b", "ok")


@pytest.mark.parametrize(
    ("result", "plain", "accepting"),
    [
        (ended("InputError"), 1, 0),
        (ended("WorkerDied", "NoHandFoundError"), 1, 0),
        (ended("TakeError"), 1, 0),
        (ended("PartFailed"), 1, 0),
        (ended(*["WorkerDied"] * ATTEMPTS), EXIT_LATER, 0),
        (ended("OutputError", "WorkerDied", "WorkerDied"), EXIT_LATER, EXIT_LATER),
        (ended("WorkerError"), EXIT_LATER, EXIT_LATER),
        (ended("LandmarkModelError"), EXIT_LATER, EXIT_LATER),
        (ended("HandModelError"), EXIT_LATER, EXIT_LATER),
        (ended("OptionError"), EXIT_LATER, EXIT_LATER),
        (ended("InputGone"), EXIT_LATER, EXIT_LATER),
        (ended(status="running"), EXIT_LATER, EXIT_LATER),
        (ended("Timeout"), 1, 1),
        (ended("ProtocolError"), 1, 1),
        (ended("KeyError"), 1, 1),
        (ended("NameTaken"), 1, 1),
        (OK, 0, 0),
    ],
    ids=lambda value: (
        "-".join(each["kind"] for each in value.attempts) if isinstance(value, Result) else None
    ),
)
def test_only_what_lies_in_the_input_is_accepted(result, plain, accepting):
    assert task_exit_code([OK, result], accept_failed=False) == plain
    assert task_exit_code([OK, result], accept_failed=True) == accepting


@pytest.mark.skipif(sys.platform == "win32", reason="the peer ends as processes do on POSIX")
@pytest.mark.parametrize(
    ("number", "kind", "tries"),
    [(errno.EROFS, "OutputRefused", 1), (errno.EACCES, "OutputRefused", 1), (errno.ENOSPC, "OutputError", 3)],
)
def test_a_folder_that_must_not_be_written_is_tried_once(tmp_path, monkeypatch, number, kind, tries):
    plan = plan_of(tmp_path / "out", ["fine"])

    def refused(folder: TaskFolder) -> Path:
        cause = OSError(number, os.strerror(number))
        raise OutputError(f"{folder.path}: {cause}") from cause

    monkeypatch.setattr(TaskFolder, "part", refused)
    monkeypatch.setattr("handfit_core.farm.pool.BACK_OFF", (0.0,))
    with Pool(COMMAND) as pool:
        (result,) = pool.run(plan, plan.tasks)
    assert [each["kind"] for each in result.attempts] == [kind] * tries
    assert task_exit_code([result], accept_failed=True) == EXIT_LATER


@pytest.mark.skipif(sys.platform == "win32", reason="the peer ends as processes do on POSIX")
@pytest.mark.parametrize("kind", ["HandModelError", "OptionError"])
def test_what_one_machine_lacks_is_tried_by_the_next(tmp_path, kind):
    plan = plan_of(tmp_path / "out", ["fine"])
    failed = ended(kind)
    plan.folder(plan.tasks[0]).fail(plan.tasks[0].id, vars(failed), {})
    with Pool(COMMAND) as pool:
        (result,) = pool.run(plan, plan.tasks)
    assert result.status == "ok"


def test_plans_that_are_away_and_plans_that_are_none(tmp_path):
    (tmp_path / "bad.json").write_text("{}")
    with pytest.raises(InputError) as strange:
        plans_in(tmp_path / "bad.json")
    assert not isinstance(strange.value, PlanGone)
    for away in (tmp_path / "not mounted" / "plans" / "a.json", tmp_path / "not mounted", tmp_path):
        with pytest.raises(PlanGone):
            plans_in(away)


@pytest.mark.parametrize("text", ["0", "-1", "nan", "inf", "-inf", "soon"])
def test_time_limits_are_times(text):
    parser = argparse.ArgumentParser()
    add_running_arguments(parser)
    with pytest.raises(SystemExit):
        parser.parse_args([f"--timeout={text}"])
    assert parser.parse_args(["--timeout=0.5"]).timeout == 0.5


_FIVE = """
import sys
from handfit_core.farm.plan import Task
from handfit_core.farm.report import Result
from handfit_core.farm.show import ProgressReporter

tasks = [Task(str(i), str(i), str(i)) for i in range(5)]
reporter = ProgressReporter(tasks, sys.argv[1])
sys.stdin.readline()
for task in tasks:
    reporter.began(task)
    reporter._last = -1e9
    reporter.turn()
    reporter.ended(task, Result(task.shown, task.name, "ok"))
"""


@pytest.mark.parametrize("style", ["text", "json", "openjd"])
def test_a_reader_that_goes_away_ends_nothing(style):
    command = [sys.executable, "-c", _FIVE, style]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=subprocess.STDOUT, cwd=ROOT) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdout.close()
        process.stdin.write(b"\n")
        process.stdin.close()
        assert process.wait() == 0
