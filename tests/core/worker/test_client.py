"""The worker's client: messages, errors, deaths. Its peer is the real worker, or a script that misbehaves."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
import time

import pytest

from handfit_core.common.errors import Cancelled, InputError, NoHandFoundError
from handfit_core.common.version import __version__
from handfit_core.worker import client
from handfit_core.worker.client import ENDED, Worker
from handfit_core.worker.events import WorkerError, as_error
from handfit_core.worker.process import reap
from tests.conftest import ROOT
from tests.waiting import alive, pid_of, said_by, wait_for

needs_scripts = pytest.mark.skipif(
    sys.platform == "win32", reason="misbehaving peers are scripts with a #! line"
)

ADVICE = "choose a Python in the add-on's preferences"
SLEEPS = 60
"""seconds that a peer sleeps: nothing here may last as long"""

PRELUDE = f"""#!{sys.executable}
import json, os, signal, socket, sys, time

connection = socket.socket(fileno=int(os.environ["HANDFIT_CONNECTION"]))
sys.stdin, sys.stdout = connection.makefile("r"), connection.makefile("w")

def say(**event):
    print(json.dumps(event), flush=True)

def ready(version={__version__!r}):
    say(event="ready", version=version, pid=os.getpid(), python="3")

def requests():
    for line in sys.stdin:
        yield json.loads(line)

"""


@pytest.fixture
def peer(tmp_path):
    """peer(code) -> an interpreter that runs `code` whatever it is asked to run."""

    def make(code: str, name: str = "peer") -> str:
        path = tmp_path / name
        path.write_text(PRELUDE + code + "\n")
        path.chmod(path.stat().st_mode | stat.S_IXUSR)
        return str(path)

    return make


@pytest.fixture
def start():
    """start(python, ...) -> Worker, stopped after the test."""
    made: list[Worker] = []

    def make(*args, **kwargs) -> Worker:
        made.append(Worker(*args, **{"advice": ADVICE, **kwargs}))
        return made[-1]

    yield make
    for worker in made:
        worker.stop()


def exists(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def gone(pid: int, seconds: float = 5.0) -> bool:
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        reap()
        if not exists(pid):
            return True
        time.sleep(0.02)
    return False


# Requests and events


@needs_scripts
def test_events_arrive_in_order(peer, start):
    worker = start(
        peer(
            "ready()\n"
            "for r in requests():\n"
            "    say(event='progress', id=r['id'], stage='detect', done=3, total=30)\n"
            "    say(event='progress', id=999, stage='detect', done=1, total=1)\n"
            "    say(event='warning', id=r['id'], message='dark')\n"
            "    say(event='done', id=r['id'], got=r)"
        )
    )
    events = []
    request = worker.submit("capture", input=["a"], output="b")
    done = wait_for(worker, request, events.append, timeout=20)
    assert [(e["event"], e["id"]) for e in events] == [("progress", request), ("warning", request)]
    assert done["got"] == {"id": request, "request": "capture", "input": ["a"], "output": "b"}
    assert not worker.busy


@needs_scripts
def test_a_large_request_waits_for_nobody_and_arrives_whole(peer, start):
    """It is larger than any socket's room, and the peer reads late."""
    code = "ready()\ntime.sleep(3)\nfor r in requests(): say(event='done', id=r['id'], got=len(r['text']))"
    worker, began = start(peer(code)), time.monotonic()
    request = worker.submit("refit", text="x" * 5_000_000)
    assert worker.events() == []
    assert time.monotonic() - began < 3
    assert wait_for(worker, request, timeout=20)["got"] == 5_000_000


@needs_scripts
def test_what_was_said_while_nobody_looked_is_not_lost(peer, start):
    """More than any pipe holds: the peer waits, and goes on."""
    code = (
        "ready()\n"
        "for r in requests():\n"
        "    for i in range(40_000): say(event='progress', id=r['id'], stage='fit', done=i, total=40_000)\n"
        "    say(event='done', id=r['id'])"
    )
    worker = start(peer(code))
    request = worker.submit("capture")
    time.sleep(0.5)
    events = []
    wait_for(worker, request, events.append, timeout=60)
    assert [event["done"] for event in events] == list(range(40_000))


@needs_scripts
def test_a_dead_peer_does_not_take_blender_with_it(peer):
    """Blender leaves SIGPIPE deadly, where Python alone ignores it."""
    code = (
        "import os, signal, sys, time\n"
        "from handfit_core.worker.client import Worker\n"
        "signal.signal(signal.SIGPIPE, signal.SIG_DFL)\n"
        "worker = Worker(sys.argv[1]); job = worker.submit('capture')\n"
        "while worker.ready is None: worker.events(); time.sleep(0.01)\n"
        "os.kill(worker.ready['pid'], signal.SIGKILL); time.sleep(0.2)\n"
        "worker.cancel(job); found = []\n"
        "while not found: found = worker.events(); time.sleep(0.01)\n"
        "print(found[0]['type'], signal.sigpending(), flush=True); os._exit(0)\n"
    )
    command = [sys.executable, "-c", code, peer("ready()\ntime.sleep(60)")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert "WorkerError set()" in done.stdout.splitlines()


@needs_scripts
def test_cancel_reaches_the_peer(peer, start):
    worker = start(
        peer(
            "ready()\n"
            "job = None\n"
            "for r in requests():\n"
            "    if r['request'] == 'cancel':\n"
            "        say(event='error', id=r['job'], type='Cancelled', message='stopped', details='')"
        )
    )
    request = worker.submit("capture")
    worker.cancel(request)
    with pytest.raises(Cancelled, match="stopped"):
        wait_for(worker, request, timeout=20)
    worker.cancel(request)  # over already: nothing happens
    assert worker.events() == []


@pytest.mark.parametrize("kind", [NoHandFoundError, InputError])
def test_errors_are_raised_as_what_they_were(kind):
    error = as_error(
        {"event": "error", "id": 1, "type": kind.__name__, "message": "what", "details": "where"}
    )
    assert type(error) is kind
    assert str(error) == "what"
    unknown = as_error(
        {"event": "error", "id": 1, "type": "ZeroDivisionError", "message": "oh", "details": "x"}
    )
    assert isinstance(unknown, WorkerError)
    assert unknown.details == "x"


# Deaths


UNFIT = f"^the Python '.*peer' {{}}; {ADVICE}"
DEATHS = {
    "killed": ("ready()\nos.kill(os.getpid(), signal.SIGKILL)", ENDED, "exit code -9"),
    "hung": (
        "ready()\nsys.stdin.close(); sys.stdout.close(); connection.close(); time.sleep(60)",
        ENDED,
        "",
    ),
    "abort": (
        "ready()\nsys.stderr.write('out of paper\\n\\n'); sys.stderr.flush(); os.abort()",
        ENDED,
        "out of paper",
    ),
    "version": (
        "ready('0.0.1')\ntime.sleep(60)",
        "was updated from version .* to 0.0.1 .*restart Blender",
        "",
    ),
    "no-package": (
        "sys.stderr.write(\"No module named 'handfit_core'\\n\"); sys.exit(1)",
        UNFIT.format(r"cannot capture \(No module named 'handfit_core'\)"),
        "exit code 1",
    ),
    "old-python": (
        "sys.stderr.write('is version 3.9.1\\n'); sys.exit(77)",
        UNFIT.format("is version 3.9.1"),
        "exit code 77",
    ),
}
"""What a peer does -> what is said of it, and what is in its details"""


@needs_scripts
@pytest.mark.parametrize(("code", "expected", "details"), DEATHS.values(), ids=DEATHS)
def test_every_death_is_one_sentence_with_a_remedy(peer, start, code, expected, details):
    worker = start(peer(code))
    requests = [worker.submit("capture"), worker.submit("refit")]
    for request in requests:
        with pytest.raises(WorkerError, match=expected) as caught:
            wait_for(worker, request, timeout=30)
        assert details in caught.value.details
    assert not alive(worker)


@needs_scripts
def test_a_process_that_hangs_before_it_is_ready_is_ended(peer, start, monkeypatch):
    monkeypatch.setattr(client, "_START_SECONDS", 0.2)
    worker = start(peer(f"time.sleep({SLEEPS})"))
    with pytest.raises(WorkerError, match=r"peer\' did not answer within 0\.2 seconds: try again"):
        wait_for(worker, worker.submit("capture"), timeout=20)
    assert not alive(worker)


def test_a_missing_interpreter_is_one_sentence(start, tmp_path):
    worker = start(str(tmp_path / "nowhere"))
    with pytest.raises(WorkerError, match=r"nowhere.*preferences"):
        worker.submit("capture")
    assert not worker.busy
    with pytest.raises(WorkerError):
        worker.start()


@needs_scripts
def test_after_a_crash_the_next_request_starts_another(peer, start, tmp_path):
    mark = str(tmp_path / "crashed")
    crash = f"if not os.path.exists({mark!r}): open({mark!r}, 'w'); os._exit(7)"
    answer = "say(event='done', id=r['id'], pid=os.getpid())"
    worker = start(peer(f"ready()\nfor r in requests():\n    {crash}\n    {answer}"))
    with pytest.raises(WorkerError, match=ENDED):
        wait_for(worker, worker.submit("capture"), timeout=20)
    assert wait_for(worker, worker.submit("capture"), timeout=20)["pid"] == pid_of(worker)


@needs_scripts
def test_much_stderr_does_not_block_and_is_cut(peer, start):
    worker = start(
        peer("ready()\nfor r in requests(): sys.stderr.write('x' * 5_000_000); say(event='done', id=r['id'])")
    )
    wait_for(worker, worker.submit("capture"), timeout=20)
    assert 1000 < len(said_by(worker)) < 20_000


@needs_scripts
def test_stop_answers_what_is_open_and_kills_what_hangs(peer, start):
    """A peer that ignores the end of its stdin and every signal that can be ignored."""
    worker = start(peer(f"signal.signal(signal.SIGTERM, signal.SIG_IGN)\nready()\ntime.sleep({SLEEPS})"))
    request = worker.submit("capture")
    while worker.ready is None:
        worker.events()
        time.sleep(0.01)
    pid = pid_of(worker)
    worker.stop()
    (event,) = worker.events()
    assert (event["id"], event["type"]) == (request, "Cancelled")
    assert gone(pid)


@needs_scripts
def test_debug_repeats_what_it_says(peer, start, capfd):
    speak = "sys.stderr.write(' '.join(sys.argv[1:]) + '\\n'); say(event='done', id=r['id'])"
    worker = start(peer(f"ready()\nfor r in requests(): {speak}"), threads=3, debug=True)
    wait_for(worker, worker.submit("warm"), timeout=20)
    worker.stop()
    assert "launch.py worker --threads 3 --debug" in capfd.readouterr().err
