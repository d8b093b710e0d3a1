"""The worker as Blender meets it: its answers, what stops it, and what it leaves."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import cv2
import mediapipe
import numpy as np
import pytest
import scipy

from handfit_core import Take
from handfit_core.common.arrays import unpack
from handfit_core.common.errors import Cancelled, HandfitError, ProtocolError
from handfit_core.common.version import __version__
from handfit_core.media.pictures import read_picture
from handfit_core.take.fit_quality import mean_expected_error, mean_relative_error
from handfit_core.worker import client
from handfit_core.worker.client import ENDED, Worker
from handfit_core.worker.events import THREAD_VARIABLES, Event, WorkerError
from tests.conftest import ROOT
from tests.waiting import pid_of, said_by, stopping, wait_for

FOLDER = ROOT / "samples" / "rendered_hand"
PHOTO = str(FOLDER / "hand.0001.jpg")
PATTERN = str(FOLDER / "hand.%04d.jpg")
PATIENCE = 120.0
"""seconds until a silent worker is a failure: MediaPipe loads on busy machines"""


@pytest.fixture(scope="module")
def warm() -> Iterator[Worker]:
    """One worker that all quiet tests share."""
    with stopping(Worker(threads=1)) as worker:
        yield worker


@pytest.fixture
def start(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """start(code) -> a worker whose process runs this code before it serves."""
    made: list[Worker] = []

    def make(code: str, **options: Any) -> Worker:
        def command(python: str) -> list[str]:
            return [python, "-u", "-c", f"{code}\nfrom handfit_core.__main__ import main\nmain()", "worker"]

        monkeypatch.setattr(client, "worker_command", command)
        made.append(Worker(**options))
        return made[-1]

    yield make
    for worker in made:
        worker.stop(5.0)


def ask(worker: Worker, kind: str, **fields: Any) -> Event:
    return wait_for(worker, worker.submit(kind, **fields), timeout=PATIENCE)


def capture_of(folder: Path, frames: str | None = None, **options: Any) -> dict[str, Any]:
    return {"input": [PATTERN], "output": str(folder / "a.npz"), "options": {"frames": frames, **options}}


def test_captures(warm: Worker, tmp_path: Path) -> None:
    before: list[Event] = []
    request = warm.submit("capture", **capture_of(tmp_path, "1-4", hands="right", hand_length=0.1))
    done = wait_for(warm, request, before.append, timeout=PATIENCE)
    assert {event["id"] for event in before} == {request}
    for stage in ("detect", "fit"):
        counts = [(e["done"], e["total"]) for e in before if e.get("stage") == stage]
        assert counts[0] == (1, 4)
        assert counts[-1] == (4, 4)
        assert counts == sorted(counts)
    (warning,) = [e["message"] for e in before if e["event"] == "warning"]
    assert "100 mm" in warning
    assert (done["frames"], done["stopped"], done["output"]) == (4, False, str(tmp_path / "a.npz"))
    (hand,) = done["hands"]
    assert (hand["side"], hand["frames"], hand["filled"]) == ("right", 4, 0)
    take = Take.load(done["output"])
    assert hand["mean_reprojection_error_px"] == pytest.approx(take.hands[0].reprojection_error.mean())
    assert hand["mean_error_of_hand"] == mean_relative_error(take.hands[0], take.intrinsics)
    assert hand["mean_expected_error"] == mean_expected_error(take.hands[0])
    assert take.hands[0].refinable
    assert [p.name for p in tmp_path.iterdir()] == ["a.npz"]


def test_takes_can_be_compact_and_without_hands(warm: Worker, tmp_path: Path) -> None:
    output = str(tmp_path / "a.npz")
    for compact, dtype in ((False, "float64"), (True, "float32")):
        ask(warm, "capture", input=[PHOTO], output=output, compact=compact)
        with np.load(output, allow_pickle=False) as arrays:
            assert {a.dtype.name for a in arrays.values() if a.dtype.kind == "f"} == {dtype}
    done = ask(warm, "capture", input=[PHOTO], output=output, bare=True)
    assert (done["frames"], done["hands"]) == (1, [])
    assert Take.load(output).hands == ()


def test_options_reach_the_capture(warm: Worker, tmp_path: Path) -> None:
    options = {"solver": "fast-per-frame", "model": "open-hand", "threshold": 0.4, "lens": [1.25, 0.5, 0.25]}
    ask(warm, "capture", input=[PHOTO], output=str(tmp_path / "b.npz"), options=options)
    take = Take.load(tmp_path / "b.npz")
    assert take.solver == "fast-per-frame"
    assert tuple(vars(take.intrinsics).values()) == (800, 800, 320, 120)


def test_tells_what_an_input_is(warm: Worker) -> None:
    found = ask(warm, "probe", input=[PATTERN])
    names = ("kind", "width", "height", "fps", "frames", "first", "last")
    assert tuple(found[name] for name in names) == ("sequence", 640, 480, 24.0, 24, 1, 24)
    assert ask(warm, "probe", input=[PHOTO])["kind"] == "photo"


def test_finds_what_can_be_chosen(warm: Worker, tmp_path: Path) -> None:
    path = tmp_path / "frame.jpg"
    found = ask(warm, "find", input=[PATTERN], options={"frames": "7-7"}, picture=str(path))
    assert (found["frame"], found["width"], found["height"]) == (7, 640, 480)
    (hand,) = found["hands"]
    assert hand["side"] == "right"
    assert 0.5 < hand["certainty"] <= 1.0
    points = unpack(hand["keypoints"])
    assert points.shape == (21, 2)
    shown, true = (read_picture(p)[0].astype(int) for p in (path, FOLDER / "hand.0007.jpg"))
    assert np.abs(shown - true).mean() < 3
    box = [*points.min(axis=0).tolist(), *np.ptp(points, axis=0).tolist()]
    for regions, count in (([box], 1), ([[1, 1, 30, 30]], 0), ([], 0)):
        options = {"regions": regions, "only_regions": True}
        assert len(ask(warm, "find", input=[PHOTO], options=options)["hands"]) == count


def test_adds_arms_to_takes(warm: Worker, tmp_path: Path) -> None:
    """A drawn hand has none, and both ways tell why."""
    first, second = str(tmp_path / "a.npz"), str(tmp_path / "b.npz")
    ask(warm, "capture", **capture_of(tmp_path, "1-3"))
    before: list[Event] = []
    done = wait_for(warm, warm.submit("arms", take=first, output=second), before.append, timeout=PATIENCE)
    last = [(e["stage"], e["done"], e["total"]) for e in before if e["event"] == "progress"][-1]
    assert last == ("arms", 3, 3)
    (hand,) = done["hands"]
    assert (done["output"], hand["arm"]) == (second, 0)
    assert hand["no_arm"] == Take.load(second).hands[0].no_arm != ""
    assert ask(warm, "capture", **capture_of(tmp_path, "1-3", arms=True))["hands"] == done["hands"]


def test_makes_contact_sheets(warm: Worker, tmp_path: Path) -> None:
    take, sheet = str(tmp_path / "a.npz"), tmp_path / "new" / "a.sheet.jpg"
    assert ask(warm, "capture", input=[PATTERN], output=take, options={"frames": "3-8"})["frames"] == 6
    done = ask(warm, "sheet", take=take, output=str(sheet))
    assert done["frames"] == [3, 5, 6, 8]
    cells = np.hsplit(read_picture(sheet)[0][:, : 4 * 324].astype(int), range(324, 1296, 324))
    for number, cell in zip(done["frames"], cells, strict=True):
        true = cv2.resize(read_picture(FOLDER / f"hand.{number:04d}.jpg")[0], (320, 240)).astype(int)
        off = np.abs(cell[:, :320] - true).mean(axis=-1)
        assert np.median(off) < 3  # the ground is the picture's
        assert (off > 30).mean() > 0.03  # and the hand is drawn over it


@pytest.mark.parametrize(
    ("kind", "changes", "error", "said"),
    [
        ("capture", {"options": {"speed": 3}}, "OptionError", "no option 'speed' of a capture; choose from"),
        ("capture", {"options": {"solver": "magic"}}, "OptionError", "no solver 'magic'"),
        ("capture", {"input": ["/nowhere/a.png"]}, "InputError", "no such file"),
        ("capture", {"input": ["x" * 300]}, "InputError", "xxx"),
        ("capture", {"input": [" "]}, "InputError", "' ': there is no such file"),
        ("capture", {"output": f"{__file__}/y.npz"}, "OutputError", "cannot write"),
        ("capture", {"output": "a\0b.npz"}, "OutputError", "choose another name"),
        ("capture", {"output": "a\ud800b.npz"}, "OutputError", "choose another name"),
        ("capture", {"output": "x" * 300}, "OutputError", "choose another name"),
        ("probe", {"input": ["/nowhere/a.png"]}, "InputError", "no such file"),
        ("probe", {"max_megapixels": 0.01}, "InputError", "no more than 0.01 are read"),
        ("find", {"input": ["/nowhere/a.png"]}, "InputError", "no such file"),
        ("find", {"picture": f"{__file__}/b.jpg"}, "OutputError", "cannot write"),
        ("sheet", {"take": PHOTO}, "TakeError", "hand.0001.jpg"),
        ("warm", {"model": "/nowhere.pkl"}, "HandModelError", "nowhere"),
        ("lens", {"name": "1,2"}, "OptionError", "a name with a letter"),
        ("lens", {"name": "mine"}, "InputError", "the chessboard was found in none of 24 frames"),
    ],
    ids=str,
)
def test_errors_are_sentences_with_details(
    warm: Worker, tmp_path: Path, kind: str, changes: dict[str, Any], error: str, said: str
) -> None:
    with pytest.raises(HandfitError) as caught:
        ask(warm, kind, **{**capture_of(tmp_path), **changes})
    assert type(caught.value).__name__ == error
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
    assert caught.value.__notes__[0].startswith("Traceback")
    assert list(tmp_path.iterdir()) == []


def test_what_json_cannot_hold_is_not_sent(warm: Worker) -> None:
    for value in (float("nan"), np.float32(1), np.zeros(2), object()):
        with pytest.raises(ProtocolError, match="JSON's types"):
            warm.submit("capture", value=value)
    assert not warm.busy


def test_check_and_warm(warm: Worker) -> None:
    ask(warm, "warm")
    lines = ask(warm, "check")["versions"].splitlines()
    assert lines[0] == f"handfit_core {__version__}"
    assert lines[1].endswith(sys.executable)
    assert lines[2:] == [
        f"{module.__name__} {module.__version__}" for module in (np, scipy, cv2, mediapipe, av)
    ]


def test_a_package_that_is_missing_is_a_sentence(start: Any, tmp_path: Path) -> None:
    """torch and MediaPipe cannot be imported; the worker starts all the same."""
    worker = start("import sys; sys.modules['torch'] = sys.modules['mediapipe'] = None")
    for kind, fields in (("capture", capture_of(tmp_path)), ("check", {})):
        with pytest.raises(WorkerError, match=r"cannot capture \(.*mediapipe.*\); choose a Python that has"):
            ask(worker, kind, **fields)


def test_prints_of_libraries_do_not_damage_the_messages(start: Any) -> None:
    """Python's print, and a write to descriptor 1, in the middle of a request; what is printed before."""
    worker = start(
        "import os\n"
        "from handfit_core.worker import checking\n"
        "def noisy(should_stop):\n"
        "    print('printed')\n"
        "    os.write(1, b'written')\n"
        "    os.system('echo a child')\n"
        "    assert os.read(0, 10) == b'', 'nothing is to be read'\n"
        "    return {'versions': ''}\n"
        "checking.check = noisy\n"
        "print('loading')\n",
        debug=True,
    )
    assert ask(worker, "check")["versions"] == ""
    for noise in ("printed", "written", "a child"):
        assert noise in said_by(worker)


def test_threads_reach_the_libraries(start: Any) -> None:
    told = f"[os.environ.get(name) for name in {THREAD_VARIABLES}]"
    code = "import os\nfrom handfit_core.worker import checking\n"
    code += (
        f"checking.check = lambda should_stop: {{'told': {told}}}\nimport sys; sys.argv += ['--threads', '3']"
    )
    assert set(ask(start(code), "check")["told"]) == {"3"}
    command = [sys.executable, "-m", "handfit_core", "worker", "--threads", "0"]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, cwd=ROOT)
    assert (done.returncode, done.stdout) == (1, "")
    assert "at least 1 thread" in done.stderr


def test_cancel_of_what_runs_and_what_waits(warm: Worker, tmp_path: Path) -> None:
    ask(warm, "warm")
    runs = warm.submit("capture", **capture_of(tmp_path))
    waits = warm.submit("capture", **{**capture_of(tmp_path), "output": str(tmp_path / "waits.npz")})
    while not any(event.get("done") for event in warm.events(runs)):
        pass
    warm.cancel(waits)
    warm.cancel(runs)
    with pytest.raises(Cancelled, match="before it was begun"):
        wait_for(warm, waits, timeout=PATIENCE)
    done = wait_for(warm, runs, timeout=PATIENCE)
    assert done["stopped"]
    assert 1 <= done["frames"] < 24
    take = Take.load(tmp_path / "a.npz")
    assert len(take.frame_numbers) == len(take.source.files) == done["frames"]
    warm.cancel(runs)  # is over: nothing happens
    ask(warm, "warm")
    assert not warm.busy
    assert [p.name for p in tmp_path.iterdir()] == ["a.npz"]


def test_ends_in_the_middle_of_a_capture_when_blender_dies(tmp_path: Path) -> None:
    """Nobody says goodbye, and nothing half-written stays."""
    pictures = sorted(map(str, FOLDER.glob("*.jpg"))) * 20  # which take a while
    asked = capture_of(tmp_path, quality="best") | {"input": pictures}
    code = (
        "import os, sys\n"
        "from handfit_core.worker.client import Worker\n"
        "worker = Worker()\n"
        f"worker.submit('capture', **{asked!r})\n"
        "while not any(e['event'] == 'progress' for e in worker.events()): pass\n"
        "print(worker.ready['pid'], flush=True); os._exit(1)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60)
    pid = int(done.stdout.split()[-1])
    gone = threading.Event()
    for _ in range(200):
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            gone.set()
            break
        gone.wait(0.05)
    assert gone.is_set()
    assert list(tmp_path.iterdir()) == []


def test_stop_is_heard_in_the_middle_of_a_capture(tmp_path: Path) -> None:
    with stopping(Worker()) as worker:
        request = worker.submit("capture", **capture_of(tmp_path, quality="best"))
        while not any(event["event"] == "progress" for event in worker.events()):
            pass
        worker.stop(5.0)
        assert [(e["id"], e["type"]) for e in worker.events() if e["event"] == "error"] == [
            (request, "Cancelled")
        ]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGINT for other processes")
def test_interrupting_blender_in_its_terminal_is_not_for_the_worker() -> None:
    with stopping(Worker()) as worker:
        ask(worker, "probe", input=[PHOTO])
        os.kill(pid_of(worker), signal.SIGINT)
        assert ask(worker, "probe", input=[PHOTO])["kind"] == "photo"


def test_a_worker_that_cannot_read_any_more_ends(start: Any) -> None:
    """Memory runs out over a request, while the connection stays."""
    code = "import json\ndef loads(line): raise MemoryError\njson.loads = loads\n"
    with pytest.raises(WorkerError, match=ENDED):
        ask(start(code), "check")
