"""Farms' job files: what they ask farms to run is run, and does every task once, whatever it is called."""

from __future__ import annotations

import importlib.util
import json
import logging
import os
import re
import shutil
import subprocess
import sys
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import pytest

from handfit_core.errors import OptionError
from handfit_core.farm.plan import Plan, Task
from handfit_core.farm.templates import dealt, write_template
from tests.core.farm.peers import COMMAND, attempts, plan_of, planned

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="the peer ends as processes do on POSIX")

PLACE = 'it\'s ünï 😀 "x" $HOME `id` {y} {{z}} %d & #1'
"""A folder's name that every language takes for something else where it is not quoted"""
NO_BRACES = str.maketrans("{}", "()")
NAMES = ["plain", 'o\'ne "two" $HOME', "{a} {{b}} `id`", "日本 & 😀 #2"]


@pytest.fixture
def log(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("PEER_LOG", str(tmp_path / "log"))
    return tmp_path / "log"


@pytest.fixture
def plan(tmp_path, log) -> Plan:
    """Of names that are hard to quote; the last task is a clip's, two are of its parts."""
    plan = plan_of(tmp_path / PLACE, NAMES)
    *others, last = plan.tasks
    parts = [replace(task, part="1-9", of=last.id) for task in (others[0], others[2])]
    last = replace(last, needs=tuple(part.id for part in parts))
    return planned(plan, tasks=(parts[0], others[1], parts[1], last))


def openjd(*words: str | Path) -> subprocess.CompletedProcess[str]:
    if importlib.util.find_spec("openjd") is None:
        pytest.skip("Open Job Description's own tool is not here; pip install openjd-cli")
    command = [sys.executable, "-m", "openjd", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, encoding="utf-8")


def told(log: Path) -> list[list[str]]:
    """The commands that were given, in their order."""
    return [each["told"] for each in attempts(log) if "told" in each]


def done(log: Path) -> list[str]:
    """The names of the tasks that were done, in their order."""
    return [each["task"] for each in attempts(log) if "attempt" in each]


def all_done_in_order(plan: Plan, log: Path) -> None:
    """Every task is sealed and was done once, and the report came last."""
    names = [task.name for task in plan.tasks]
    assert all(plan.is_sealed(task.id) != bool(task.of) for task in plan.tasks), "parts go with their clip"
    order = done(log)
    assert sorted(order) == sorted(names)
    assert order.index(names[3]) > max(order.index(names[0]), order.index(names[2]))
    assert told(log)[-1] == ["collect", str(plan.path)]
    assert [words[0] for words in told(log)].count("collect") == 1


def test_openjd_checks_and_runs_the_template(plan, log):
    file = write_template("openjd", plan)
    checked = openjd("check", file)
    assert checked.returncode == 0, checked.stdout
    run = openjd("run", file)
    assert run.returncode == 0, run.stdout
    all_done_in_order(plan, log)
    again = openjd("run", file)
    assert again.returncode == 0
    assert len(done(log)) == len(NAMES), "what is sealed is not done again"


def test_openjd_is_told_of_progress_and_of_failures(tmp_path, log):
    """By its own reading of what `--progress openjd` prints."""
    plan = plan_of(tmp_path / "out", ["slow", "input"])
    file = write_template("openjd", plan)
    run = openjd("run", file, "--verbose")
    assert run.returncode == 0, "an input that cannot be captured does not keep the report from being written"
    from openjd.sessions._action_filter import ActionMonitoringFilter

    found: dict[str, list] = defaultdict(list)
    reader = ActionMonitoringFilter(
        session_id="a", callback=lambda kind, value, _: found[kind.value].append(value)
    )
    for line in run.stdout.splitlines():
        record = logging.makeLogRecord({"msg": line.split("\t", 1)[-1], "session_id": "a"})
        reader.filter(record)
    assert all(0 <= value <= 100 for value in found["progress"])
    assert any(0 < value < 100 for value in found["progress"])
    assert found["fail"] == ["input: input"]
    assert any(text.startswith("slow detect") for text in found["status"])


def test_openjd_maps_the_plan_and_the_paths_in_it(tmp_path, log):
    plan = plan_of(tmp_path / "here", ["clip"])
    (task,) = plan.tasks
    plan = planned(plan, tasks=(replace(task, source=(r"Z:\shots\clip.mp4",)),))
    file = write_template("openjd", plan, tmp_path / "elsewhere.json")
    names = ("source_path_format", "source_path", "destination_path")
    rules = [("POSIX", "/mnt/plans", str(plan.path.parent)), ("WINDOWS", r"Z:\shots", "/footage/of today")]
    content = {
        "version": "pathmapping-1.0",
        "path_mapping_rules": [dict(zip(names, rule, strict=True)) for rule in rules],
    }
    (tmp_path / "rules.json").write_text(json.dumps(content))
    place = f"/mnt/plans/{plan.path.name}"
    given = ("--path-mapping-rules", f"file://{tmp_path}/rules.json", "-p", f"Plan={place}")
    run = openjd("run", file, *given)
    assert run.returncode == 0, run.stdout
    assert [words[1] for words in told(log)] == [str(plan.path)] * 2
    assert [each["sources"] for each in attempts(log) if "sources" in each] == [
        [["/footage/of today/clip.mp4"]]
    ]
    missing = openjd("run", file)
    assert missing.returncode != 0, "elsewhere the plan must be named"


def test_openjd_takes_plans_of_any_size(tmp_path, log):
    plan = many(tmp_path, 30_000)
    file = write_template("openjd", plan)
    checked = openjd("check", file)
    assert checked.returncode == 0, checked.stdout


def test_flamenco_compiles_the_job_and_its_commands_do_it(plan, log, tmp_path):
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not here, which runs Flamenco's job type")
    file = write_template("flamenco", plan, places=["Z:\\it's=/x y"])
    # As Flamenco's Manager has it: a job takes a copy of a task, and knows the tasks that it depends on.
    stand_in = """
    const fs = require("fs"), vm = require("vm");
    const tasks = [];
    const author = {
        Task: (name, type) => ({name, type, commands: [], dependencies: [],
            addCommand(command) { this.commands.push(command); },
            addDependency(task) { this.dependencies.push(task.name); },
        }),
        Command: (name, parameters) => ({name, parameters}),
    };
    const context = vm.createContext({author, print: () => null});
    vm.runInContext(fs.readFileSync(process.argv[2], "utf8"), context);
    const type = vm.runInContext("JOB_TYPE", context);
    const settings = Object.fromEntries(type.settings.map(each => [each.key, each.default]));
    context.job = {settings, addTask(task) { tasks.push(JSON.parse(JSON.stringify(task))); }};
    vm.runInContext("compileJob(job)", context);
    process.stdout.write(JSON.stringify({type, tasks}));
    """
    (tmp_path / "stand_in.js").write_text(stand_in)
    run = subprocess.run([node, tmp_path / "stand_in.js", file], capture_output=True, check=True)
    compiled = json.loads(run.stdout)
    assert compiled["type"]["label"] == f"Hands: {PLACE}"
    ended: list[str] = []
    for task in compiled["tasks"]:
        assert set(task["dependencies"]) <= set(ended), (
            "Flamenco wants tasks before those that depend on them"
        )
        (command,) = task["commands"]
        assert command["name"] == "exec"
        subprocess.run([command["parameters"]["exe"], *command["parameters"]["args"]], check=True)
        ended.append(task["name"])
    assert sorted(ended) == sorted([*NAMES, "report"])
    assert set(compiled["tasks"][-1]["dependencies"]) == set(NAMES)
    assert compiled["tasks"][-2]["dependencies"] == [NAMES[0], NAMES[2]]
    all_done_in_order(plan, log)
    assert told(log)[0][-2:] == ["--map", "Z:\\it's=/x y"]


def test_flamenco_knows_where_blender_is(tmp_path):
    plan = plan_of(tmp_path / "out", ["a"])
    command = ("C:\\Blender 4.5\\blender.exe", "--command", "manient")
    text = write_template("flamenco", planned(plan, command=command)).read_text()
    assert 'default: "{blender}"' in text
    assert 'ARGUMENTS = ["--command", "manient"]' in text


@pytest.fixture
def slurm(tmp_path, monkeypatch):
    """Stand-ins of SLURM's commands, which note what they are told."""
    folder = tmp_path / "bin"
    folder.mkdir()
    for name, then in (("sbatch", 'echo "$(wc -l < "$SLURM_LOG");cluster"'), ("scontrol", "true")):
        program = folder / name
        program.write_text(f'#!/bin/bash\necho "{name}" "${{@@Q}}" >> "$SLURM_LOG"\n{then}\n')
        program.chmod(0o755)
    monkeypatch.setenv("SLURM_LOG", str(tmp_path / "slurm"))
    monkeypatch.setenv("PATH", f"{folder}:{os.environ['PATH']}")
    return tmp_path / "slurm"


def in_job(file: Path, *words: str, **variables: str | int) -> int:
    environment = {**os.environ, **{name: str(value) for name, value in variables.items()}}
    return subprocess.run(["bash", file, *words], env=environment).returncode


def test_slurm_submits_arrays_that_wait_for_each_other_and_does_them(plan, log, slurm):
    file = write_template("slurm", plan)
    assert in_job(file, AT_ONCE=7) == 0
    array = f"sbatch '--parsable' '--array={{}}%7'{{}} '{file}' 'task'".replace(str(file), "FILE")
    said = slurm.read_text().replace(quoted_by_bash(file), "'FILE'").splitlines()
    assert said == [
        array.format("0-2", ""),
        array.format("3-3", " '--dependency=afterany:1'"),
        "sbatch '--dependency=afterany:1:2' 'FILE' 'report'",
    ]
    for place in (2, 0, 1, 3):
        ids = {"SLURM_ARRAY_JOB_ID": 1, "SLURM_ARRAY_TASK_ID": place, "SLURM_CPUS_PER_TASK": 3}
        assert in_job(file, "task", **ids) == 0
    assert in_job(file, "report") == 0
    all_done_in_order(plan, log)
    assert told(log)[0][3:5] == ["--processes", "3"]


def quoted_by_bash(path: Path) -> str:
    return subprocess.run(
        ["bash", "-c", 'echo "${1@Q}"', "-", path], capture_output=True, text=True, check=True
    ).stdout.strip()


@pytest.mark.parametrize(
    ("code", "restarts", "requeued"), [(0, 0, 0), (1, 0, 0), (2, 0, 0), (75, 0, 1), (75, 4, 1), (75, 5, 0)]
)
def test_slurm_queues_again_what_may_go_better_and_nothing_else(tmp_path, slurm, code, restarts, requeued):
    plan = planned(plan_of(tmp_path / "out", ["a"]), command=("bash", "-c", f"exit {code}"))
    ids = {"SLURM_ARRAY_JOB_ID": 17, "SLURM_ARRAY_TASK_ID": 0, "SLURM_RESTART_COUNT": restarts}
    assert in_job(write_template("slurm", plan), "task", **ids) == code
    said = slurm.read_text().splitlines() if slurm.exists() else []
    assert said == ["scontrol 'requeue' '17_0'"] * requeued


def test_slurm_ends_what_it_has_started_when_the_time_is_over(tmp_path):
    ready, ended = tmp_path / "ready", tmp_path / "ended"
    program = "import signal,sys; signal.pthread_sigmask(signal.SIG_BLOCK, [15]); open(sys.argv[1], 'x'); "
    program += "signal.sigwait([15]); open(sys.argv[2], 'x'); sys.exit(130)"
    command = (sys.executable, "-c", program, str(ready), str(ended))
    file = write_template("slurm", planned(plan_of(tmp_path / "out", ["a"]), command=command))
    script = f'bash "$0" task & until [ -e {ready} ]; do sleep 0.05; done; kill -TERM $!; wait $!'
    environment = {**os.environ, "SLURM_ARRAY_TASK_ID": "0"}
    assert subprocess.run(["bash", "-c", script, file], env=environment).returncode == 130
    assert ended.exists(), "it was told, and had the time to leave things as they should be"


@pytest.mark.parametrize("flat", [False, True])
def test_snakemake_does_the_plan(plan, log, flat, tmp_path):
    program = shutil.which("snakemake")
    if program is None:
        pytest.skip("snakemake is not here, which runs its job file; pip install snakemake")
    with pytest.raises(OptionError, match="braces"):
        write_template("snakemake", plan)
    without = [replace(task, name=task.name.translate(NO_BRACES)) for task in plan.tasks]
    plan = planned(plan, flat=flat, tasks=tuple(without))
    file = write_template("snakemake", plan)
    command = [program, "-s", file, "--cores", "1", "--keep-going"]
    run = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    all_done_in_order(plan, log)
    assert (
        "Nothing to be done" in subprocess.run(command, capture_output=True, text=True, cwd=tmp_path).stderr
    )
    assert len(done(log)) == len(NAMES)


def test_the_job_file_of_snakemake_is_python_where_it_names_things(plan):
    """Also where snakemake is not here."""
    plan = planned(plan, tasks=(replace(plan.tasks[0], name='o\'ne "two"'),))
    text = write_template("snakemake", plan, places=["Z:\\it's=/x y"]).read_text(encoding="utf-8")
    before, rest = text.split("workdir:")
    found: dict = {}
    exec(before, found)
    assert (found["PLAN"], found["COMMAND"]) == (str(plan.path), list(COMMAND))
    assert found["OPTIONS"][-2:] == ["--map", "Z:\\it's=/x y"]
    tasks = [plan.folder(task).done for task in plan.tasks]
    assert [plan.output / found["done"](task.name) for task in plan.tasks] == tasks
    assert "{COMMAND:q} task {PLAN:q}" in rest


def many(folder: Path, count: int) -> Plan:
    """Every tenth task costs much; every hundredth needs the one before it, and the first a later one."""
    tasks = [
        Task(f"{i:016x}", f"clip {i}", f"{i}.mp4", cost=100.0 if i % 10 == 0 else 1.0) for i in range(count)
    ]
    needs = {i: (tasks[i - 1].id,) for i in range(99, count, 100)} | {0: (tasks[5].id,)} if count > 5 else {}
    tasks = [replace(task, needs=needs.get(i, ())) for i, task in enumerate(tasks)]
    plan = Plan(folder / "out", tuple(tasks), {}, command=COMMAND)
    plan.save()
    return plan


def test_jobs_have_time_for_their_tasks_but_not_for_all_of_them_to_hang(tmp_path):
    tasks = [Task(f"{i:016x}", f"photo {i}", "a.jpg", cost=3.0) for i in range(500)]
    plan = planned(plan_of(tmp_path / "out", []), tasks=tuple(tasks), command=COMMAND)

    def minutes(**how: float) -> int:
        text = write_template("slurm", plan, **how).read_text()
        return int(re.findall(r"--time=(\d+)", text)[0]) - 10

    assert minutes() == 60, "an hour at least"
    assert minutes(timeout=300) == 5
    assert minutes(most=5) == 60 + 100 * 20 * 3 / 60
    assert minutes(most=5, timeout=6) == 100 * 6 / 60, "every one may take its time"


@pytest.mark.parametrize(
    ("count", "most"), [(0, 1000), (1, 1), (7, 1000), (2500, 1000), (2500, 20), (2500, 1)]
)
def test_tasks_are_dealt_out_evenly_each_once_after_what_they_need(tmp_path, count, most):
    plan = many(tmp_path, count)
    jobs = dealt(plan, most)
    assert len(jobs) <= max(most, 2)
    members = [plan.chosen(job.tasks) for job in jobs]
    assert sorted(task.id for tasks in members for task in tasks) == [task.id for task in plan.tasks]
    assert [len(tasks) for tasks in members] == [job.count for job in jobs]
    where = {task.id: place for place, tasks in enumerate(members) for task in tasks}
    for place, (job, tasks) in enumerate(zip(jobs, members, strict=True)):
        assert set(job.after) == {where[id] for task in tasks for id in task.needs}
        assert all(jobs[other].level < job.level and other < place for other in job.after)
    for level in {job.level for job in jobs}:
        costs = [sum(t.cost for t in m) for job, m in zip(jobs, members, strict=True) if job.level == level]
        assert costs == sorted(costs, reverse=True), "the longest first"
        assert len(costs) == 1 or max(costs) <= 2 * sum(costs) / len(costs) + 100


def test_numbers_choose_tasks(tmp_path):
    plan = plan_of(tmp_path, ["a", "b", "c", "#1"])
    chosen = {
        text: "".join(task.name for task in plan.chosen(text)) for text in ("#2", "#2-3", "#1,3-3", "b")
    }
    assert chosen == {"#2": "b", "#2-3": "bc", "#1,3-3": "ac", "b": "b"}
    assert [task.name for task in plan.chosen("#1")] == ["#1"], "a name is a name first"
    for wrong in ("#0", "#5", "#3-2", "#1-", "#", "#1,,2", "#x"):
        with pytest.raises(OptionError, match="no task of the plan is called"):
            plan.chosen(wrong)
