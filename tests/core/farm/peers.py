"""A program that speaks the protocol of handfit_core/farm/slot.py, and does as the names of tasks say.

`python tests/core/farm/peers.py slot`. A task's name is made of words, split at dashes; a number behind a
word is how often it is so, before all goes well ("a-crash2" crashes twice), and without one it always is:

    crash, kill, exit    its process ends: by SIGABRT, by SIGKILL, by itself
    half                 the same after one of two results was told of
    hang, stop           it never answers; it is stopped by SIGSTOP; both have a child that sleeps
    memory, input, gone, disk     it fails with MemoryRanOut, InputError, InputGone, OutputError
    nonsense             it says what is no message, and messages that nobody knows, and then all goes well
    bad                  it says messages that lack what they must have
    last                 it ends by SIGKILL once it has said that all is done
    liar                 it tells of a file that it has not written
    slow                 it takes half a second, in ten steps
    deep                 one of its files is in a folder of its own

Every task gives NAME.first and NAME.second, whose contents follow from the task. What it does is written
down, a JSON line each, in the file that $PEER_LOG names: {"task", "attempt", "pid", "host", "finished"}.

It also takes the commands that farms' job files give, `task` and `collect`, and notes them: {"told"}.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT))

from handfit_core.farm import folder, pool, show  # noqa: E402
from handfit_core.farm.folder import TaskFolder  # noqa: E402
from handfit_core.farm.plan import Plan, Task, places_of  # noqa: E402
from handfit_core.farm.pool import Pool  # noqa: E402
from handfit_core.version import __version__  # noqa: E402

COMMAND = (sys.executable, str(Path(__file__).resolve()))
"""Of a plan whose tasks this program does"""
_STEPS = 10


def plan_of(output: Path, names: list[str], **options: Any) -> Plan:
    """A plan, saved, with a task for each name; `options` may have `version`, which the program then claims
    to have."""
    ids = [hashlib.sha256(name.encode()).hexdigest()[:16] for name in names]
    tasks = tuple(Task(id, name, f"{name}.mp4", cost=1.0) for id, name in zip(ids, names, strict=True))
    plan = Plan(output, tasks, options, command=COMMAND)
    plan.save()
    return plan


def planned(plan: Plan, **changes: Any) -> Plan:
    """The same with other fields, saved."""
    plan = replace(plan, **changes)
    plan.save()
    return plan


def content(name: str, which: str) -> bytes:
    """What the results of a task hold."""
    return f"{which} of {name}\n".encode() * 100


def attempts(log: Path) -> list[dict[str, Any]]:
    """What the programs that wrote this log have begun."""
    return [json.loads(line) for line in log.read_text().splitlines()] if log.exists() else []


def say(kind: str, **fields: Any) -> None:
    sys.stdout.write(json.dumps({"event": kind, **fields}) + "\n")
    sys.stdout.flush()


def serve() -> None:
    """Do tasks until stdin ends, or who gives them is gone."""
    parent = os.getppid()
    if hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, lambda *_: os.getppid() == parent or os.killpg(0, signal.SIGKILL))
        signal.siginterrupt(signal.SIGALRM, False)
        signal.setitimer(signal.ITIMER_REAL, 0.1, 0.1)
    say("ready", version=os.environ.get("PEER_VERSION", __version__), pid=os.getpid())
    for line in sys.stdin:
        do(json.loads(line))


def do(request: dict[str, Any]) -> None:
    name, part = request["task"]["name"], Path(request["folder"])
    words = dict(re.findall(r"(?<![a-z])([a-z]+)(\d*)", name))
    number = _written_down(name, request)
    result = {"input": request["task"]["shown"], "name": name, "frames": number, "hands": []}

    def is_(word: str) -> bool:
        return word in words and (not words[word] or number <= int(words[word]))

    def write(which: str) -> None:
        path = part / ("in/" * ("deep" in words)) / f"{name}.{which}"
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content(name, which))
        told = {"size": path.stat().st_size, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
        say("file", name=path.relative_to(part).as_posix(), **told)

    say("progress", stage="detect", done=0, total=_STEPS)
    for kind in ("memory", "input", "gone", "disk"):
        if is_(kind):
            kinds = {"memory": "MemoryRanOut", "input": "InputError", "gone": "InputGone"}
            say("error", type=kinds.get(kind, "OutputError"), message=f"{name}: {kind}", result=result)
            return
    if is_("nonsense"):
        sys.stdout.write("words\n{}\n[1]\n" + "x" * 100_000 + "\n")
        say("what nobody knows", of=1)
    if is_("bad"):
        say("file", name="../outside", size="large")
        say("progress")
        say("done")
        return
    if is_("liar"):
        say("file", name=f"{name}.nothing", size=3, sha256="0" * 64)
    if is_("half"):
        write("first")
    if is_("crash") or is_("half"):
        os.abort()
    if is_("kill"):
        os.kill(os.getpid(), signal.SIGKILL)
    if is_("exit"):
        os._exit(0)
    if is_("hang") or is_("stop"):
        child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
        _note({"task": name, "child": child.pid, "pid": os.getpid()})
        if "stop" in words:
            os.kill(os.getpid(), signal.SIGSTOP)
        time.sleep(600)
    for step in range(_STEPS):
        if is_("slow"):
            time.sleep(0.5 / _STEPS)
        say("progress", stage="detect", done=step + 1, total=_STEPS)
        if step in (4, 9):
            write("first" if step == 4 else "second")
    say("done", result=result)
    if is_("last"):
        os.kill(os.getpid(), signal.SIGKILL)


def _written_down(name: str, request: dict[str, Any]) -> int:
    """Note an attempt; returns which one it is."""
    if "PEER_LOG" not in os.environ:
        return 1
    before = sum(
        each.get("task") == name and "attempt" in each for each in attempts(Path(os.environ["PEER_LOG"]))
    )
    whence = {"pid": os.getpid(), "host": socket.gethostname()}
    _note({"task": name, "attempt": before + 1, **whence, "finished": sorted(request["finished"])})
    return before + 1


def _note(what: dict[str, Any]) -> None:
    with open(os.environ["PEER_LOG"], "a") as log:
        log.write(json.dumps(what) + "\n")


def commanded(command: str, plan: str, *words: str) -> int:
    """What a batch does with a command, as far as that can be done without Blender."""
    _note({"told": [command, plan, *words]})
    if command == "collect":
        return 0
    options = dict(itertools.pairwise(words))
    mapped = Plan.load(Path(plan)).mapped(places_of(options["--map"]) if "--map" in options else [])
    tasks = mapped.chosen(words[0])
    _note({"sources": [task.source for task in tasks]})
    show._EVERY.update(dict.fromkeys(show._EVERY, 0.0))
    with Pool(COMMAND) as doing:
        results = doing.run(
            mapped, tasks, show.ProgressReporter(tasks, options.get("--progress", "text")), wait=False
        )
    return int("--accept-failed" not in words and any(result.status != "ok" for result in results))


def run_pool(file: str, jobs: str) -> int:
    """`peers.py pool PLAN JOBS`: do what is left of a plan, as a machine of its own would. What is sealed is
    noted, too. $PEER_STALE: seconds without a sign after which another one's task is taken over; $PEER_CLOCK:
    seconds that this machine's clock is wrong by. Returns how many tasks are not done."""
    was_sealed, set_time = TaskFolder.seal, os.utime

    def seal(of: TaskFolder, *args: Any) -> None:
        was_sealed(of, *args)
        _note({"sealed": of.name, "pid": os.getpid(), "host": socket.gethostname()})

    def wrong(path: Path) -> None:
        now = time.time() + float(os.environ.get("PEER_CLOCK", "0"))
        set_time(path, (now, now))

    TaskFolder.seal = seal  # type: ignore[method-assign]
    os.utime = wrong  # type: ignore[assignment]
    if "PEER_STALE" in os.environ:
        folder.STALE = float(os.environ["PEER_STALE"])
        folder.BEAT = folder.STALE / 10
    pool.BACK_OFF, pool._ELSEWHERE = (0.05,), 0.1
    plan = Plan.load(Path(file))
    with Pool(COMMAND, jobs=int(jobs)) as doing:
        results = doing.run(plan, plan.tasks)
    for result in results:
        print(result.name, result.status, result.error, file=sys.stderr)
    return sum(result.status != "ok" for result in results)


if __name__ == "__main__":
    _, what, *words = sys.argv
    if what == "slot":
        serve()
    else:
        sys.exit(run_pool(*words) if what == "pool" else commanded(what, *words))
