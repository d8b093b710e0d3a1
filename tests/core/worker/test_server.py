"""The worker as Blender meets it: a process with pipes."""

from __future__ import annotations

import os
import queue
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from handfit_core import Take
from handfit_core.arrays import unpack
from handfit_core.fit_quality import mean_expected_error, mean_relative_error
from handfit_core.media.pictures import read_picture
from handfit_core.version import __version__
from handfit_core.worker.protocol import PROTOCOL, decode, encode
from tests.conftest import ROOT

FOLDER = ROOT / "samples" / "rendered_hand"
PHOTO = str(FOLDER / "hand.0001.jpg")
PATTERN = str(FOLDER / "hand.%04d.jpg")
PATIENCE = 120.0
"""seconds until a silent worker is a failure: torch and MediaPipe load on busy machines"""

Event = dict[str, Any]


class Worker:
    """A worker process, driven line by line."""

    def __init__(self, *options: str, code: str | None = None) -> None:
        command = ["-m", "handfit_core"] if code is None else ["-c", code]
        self.process = subprocess.Popen(
            [sys.executable, *command, "worker", *options],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            cwd=ROOT,
        )
        self._lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self.hello = self.next()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._lines.put(line)

    def send(self, **message: Any) -> None:
        self.send_line(encode(message))

    def send_line(self, line: bytes) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(line)
        self.process.stdin.flush()

    def next(self) -> Event:
        return decode(self._lines.get(timeout=PATIENCE))

    def last(self, number: int | None) -> tuple[Event, list[Event]]:
        """The last event of a request, and all that came before it."""
        before: list[Event] = []
        while True:
            event = self.next()
            if event["event"] in ("done", "error") and event["id"] == number:
                return event, before
            before.append(event)

    def rest(self) -> list[Event]:
        """What an ended worker had said that nobody took yet."""
        self._reader.join(PATIENCE)
        return [decode(self._lines.get()) for _ in range(self._lines.qsize())]

    def ask(self, number: int, kind: str, **fields: Any) -> Event:
        self.send(id=number, request=kind, **fields)
        return self.last(number)[0]

    def close(self) -> int:
        """Close its stdin; the exit code."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        return self.process.wait(PATIENCE)

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()
        self._reader.join(PATIENCE)
        for pipe in (self.process.stdin, self.process.stdout, self.process.stderr):
            assert pipe is not None
            pipe.close()


@pytest.fixture(scope="module")
def warm() -> Iterator[Worker]:
    """One worker that all quiet tests share."""
    with Worker("--threads", "1") as worker:
        yield worker


@pytest.fixture
def fresh() -> Iterator[Worker]:
    with Worker() as worker:
        yield worker


def capture_of(folder: Path, frames: str | None = None, **options: Any) -> dict[str, Any]:
    return {"input": [PATTERN], "output": str(folder / "a.npz"), "options": {"frames": frames, **options}}


def test_says_who_it_is(fresh: Worker) -> None:
    hello = fresh.hello
    assert hello["pid"] == fresh.process.pid
    assert (hello["event"], hello["protocol"], hello["version"]) == ("ready", PROTOCOL, __version__)
    assert hello["python"].startswith("3.")
    assert fresh.close() == 0


def test_captures(warm: Worker, tmp_path: Path) -> None:
    warm.send(id=10, request="capture", **capture_of(tmp_path, "1-4", hands="right", hand_length=0.17))
    done, before = warm.last(10)
    assert done["event"] == "done", done
    assert {e["event"] for e in before} == {"progress"}
    assert all(e["id"] == 10 for e in before)
    for stage in ("detect", "fit"):
        counts = [(e["done"], e["total"]) for e in before if e["stage"] == stage]
        assert counts[0] == (1, 4)
        assert counts[-1] == (4, 4)
    assert (done["frames"], done["stopped"], done["output"]) == (4, False, str(tmp_path / "a.npz"))
    (hand,) = done["hands"]
    assert (hand["side"], hand["frames"], hand["filled"]) == ("right", 4, 0)
    take = Take.load(done["output"])
    assert hand["mean_reprojection_error_px"] == pytest.approx(take.hands[0].reprojection_error.mean())
    assert hand["mean_error_of_hand"] == mean_relative_error(take.hands[0], take.intrinsics)
    assert hand["mean_expected_error"] == mean_expected_error(take.hands[0])
    assert take.hands[0].refinable
    assert [p.name for p in tmp_path.iterdir()] == ["a.npz"]


def test_tells_what_an_input_is(warm: Worker) -> None:
    found = warm.ask(15, "probe", input=[PATTERN])
    names = ("kind", "width", "height", "fps", "frames", "first", "last")
    assert tuple(found[name] for name in names) == ("sequence", 640, 480, 24.0, 24, 1, 24)
    assert warm.ask(16, "probe", input=[PHOTO])["kind"] == "photo"
    assert warm.ask(17, "probe", input=["/nowhere/a.png"])["type"] == "InputError"
    assert warm.ask(18, "probe")["type"] == "OptionError"
    assert (
        "no more than 0.01 are read" in warm.ask(151, "probe", input=[PHOTO], max_megapixels=0.01)["message"]
    )
    assert warm.ask(152, "probe", input=[PHOTO], max_megapixels="9")["type"] == "OptionError"


def test_finds_what_can_be_chosen(warm: Worker, tmp_path: Path) -> None:
    path = tmp_path / "frame.jpg"
    found = warm.ask(160, "find", input=[PATTERN], options={"frames": "7-7"}, picture=str(path))
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
        assert len(warm.ask(161, "find", input=[PHOTO], options=options)["hands"]) == count
    assert warm.ask(162, "find", input=[PHOTO], picture=3)["type"] == "OptionError"
    assert warm.ask(163, "find", input=["/nowhere/a.png"])["type"] == "InputError"
    nowhere = str(tmp_path / "frame.jpg" / "b.jpg")
    assert warm.ask(164, "find", input=[PHOTO], picture=nowhere)["type"] == "OutputError"


def test_makes_contact_sheets(warm: Worker, tmp_path: Path) -> None:
    take, sheet = str(tmp_path / "a.npz"), tmp_path / "new" / "a.sheet.jpg"
    assert warm.ask(170, "capture", input=[PATTERN], output=take, options={"frames": "3-8"})["frames"] == 6
    done = warm.ask(171, "sheet", take=take, output=str(sheet))
    assert done["frames"] == [3, 5, 6, 8]
    cells = np.hsplit(read_picture(sheet)[0][:, : 4 * 324].astype(int), range(324, 1296, 324))
    for number, cell in zip(done["frames"], cells, strict=True):
        true = cv2.resize(read_picture(FOLDER / f"hand.{number:04d}.jpg")[0], (320, 240)).astype(int)
        off = np.abs(cell[:, :320] - true).mean(axis=-1)
        assert np.median(off) < 3  # the ground is the picture's
        assert (off > 30).mean() > 0.03  # and the hand is drawn over it
    for fields, kind in (
        ({"take": take}, "OptionError"),
        ({"output": str(sheet)}, "OptionError"),
        ({"take": [take], "output": str(sheet)}, "OptionError"),
        ({"take": take, "output": str(sheet), "max_megapixels": -1}, "OptionError"),
        ({"take": PHOTO, "output": str(sheet)}, "TakeError"),
        ({"take": take, "output": str(tmp_path / "a.npz" / "b.jpg")}, "OutputError"),
    ):
        assert warm.ask(172, "sheet", **fields)["type"] == kind


def test_options_reach_the_capture(warm: Worker, tmp_path: Path) -> None:
    output = str(tmp_path / "b.npz")
    options = {"solver": "fast-per-frame", "model": "open-hand", "threshold": 0.4, "plain_detection": True}
    camera: list[tuple[dict[str, Any], tuple[float, ...]]] = [
        ({"intrinsics": [700, 710, 320, 240.5]}, (700, 710, 320, 240.5)),
        ({"lens": [1.25, 0.5, 0.25]}, (800, 800, 320, 120)),
    ]
    for i, (given, expected) in enumerate(camera):
        done = warm.ask(20 + i, "capture", input=[PHOTO], output=output, options={**options, **given})
        assert done["event"] == "done", done
        take = Take.load(output)
        assert take.solver == "fast-per-frame"
        assert tuple(vars(take.intrinsics).values()) == expected


@pytest.mark.parametrize(
    ("changes", "kind", "said"),
    [
        ({"options": {"speed": 3}}, "OptionError", "no option 'speed' of a capture; choose from frames"),
        ({"options": {"solver": "magic"}}, "OptionError", "no solver 'magic'"),
        ({"input": "a.png"}, "OptionError", "input must be a list"),
        ({"input": []}, "OptionError", "input must be a list"),
        ({"input": ["/nowhere/a.png"]}, "InputError", "no such file"),
        ({"output": None}, "OptionError", "output"),
        ({"output": f"{__file__}/y.npz"}, "OutputError", "cannot write"),
        ({"output": "a\0b.npz"}, "OutputError", "choose another name"),
        ({"output": "a\ud800b.npz"}, "OutputError", "choose another name"),
        ({"output": "x" * 300}, "OutputError", "choose another name"),
        ({"input": ["x" * 300]}, "InputError", "xxx"),
        ({"input": [" "]}, "InputError", "' ': there is no such file"),
        ({"options": {"intrinsics": [1, 1, 0, 0]}}, "OptionError", "between 32 and 640000 pixels"),
    ],
    ids=str,
)
def test_errors_are_sentences_with_details(
    warm: Worker, tmp_path: Path, changes: dict[str, Any], kind: str, said: str
) -> None:
    error = warm.ask(30, "capture", **{**capture_of(tmp_path), **changes})
    assert (error["event"], error["type"]) == ("error", kind)
    assert said in error["message"]
    assert "\n" not in error["message"]
    assert error["details"].startswith("Traceback")
    assert list(tmp_path.iterdir()) == []


def test_lines_that_are_no_requests(warm: Worker) -> None:
    for line, said in [
        (b"hello\n", "not JSON"),
        (b"[]\n", "one JSON object"),
        (b'{"request": "check"}\n', "id must be"),
        (b'{"id": -4, "request": "check"}\n', "id must be"),
        (b'{"request": "cancel"}\n', "job must be"),
    ]:
        warm.send_line(line)
        error = warm.next()
        assert (error["event"], error["id"], error["type"]) == ("error", None, "ProtocolError")
        assert said in error["message"]
    error = warm.ask(40, "magic")
    assert (error["id"], error["type"]) == (40, "ProtocolError")
    assert "known are capture" in error["message"]
    warm.send_line(b"\n")  # nothing at all is not worth an error
    warm.send(request="cancel", job=39)  # nor is a job that has ended
    assert warm.ask(41, "refit")["message"] == "refit: hand is missing"


def test_an_open_id_is_not_taken_twice(warm: Worker, tmp_path: Path) -> None:
    warm.send(id=50, request="capture", **capture_of(tmp_path, "1-3"))
    warm.send(id=50, request="check")
    done, before = warm.last(50)
    assert done["event"] == "done"
    (error,) = [e for e in before if e["event"] == "error"]
    assert error["id"] is None
    assert "still open" in error["message"]


def test_warnings_are_of_their_request(warm: Worker, tmp_path: Path) -> None:
    fields = {"input": [PHOTO], "output": str(tmp_path / "a.npz")}
    warm.send(id=60, request="capture", **fields, options={"hand_length": 0.1})
    _, before = warm.last(60)
    (warning,) = [e for e in before if e["event"] == "warning"]
    assert warning["id"] == 60
    assert "100 mm" in warning["message"]


def test_a_compact_take_has_numbers_of_32_bits(warm: Worker, tmp_path: Path) -> None:
    for compact, dtype in ((None, "float64"), (False, "float64"), (True, "float32")):
        output = tmp_path / f"{compact}.npz"
        fields = {} if compact is None else {"compact": compact}
        done = warm.ask(65, "capture", input=[PHOTO], output=str(output), **fields)
        assert done["event"] == "done", done
        with np.load(output, allow_pickle=False) as arrays:
            kinds = {a.dtype.name for a in arrays.values() if a.dtype.kind == "f"}
        assert kinds == {dtype}
    error = warm.ask(66, "capture", input=[PHOTO], output=str(tmp_path / "x.npz"), compact="yes")
    assert "compact must be true or false" in error["message"]


def test_a_bare_take_is_written_without_looking_for_hands(warm: Worker, tmp_path: Path) -> None:
    output = tmp_path / "bare.npz"
    done = warm.ask(67, "capture", input=[PHOTO], output=str(output), bare=True)
    assert (done["event"], done["frames"], done["hands"]) == ("done", 1, [])
    assert Take.load(output).hands == ()
    error = warm.ask(68, "capture", input=[PHOTO], output=str(output), bare=1)
    assert "bare must be true or false" in error["message"]


def test_warm_and_check(warm: Worker) -> None:
    assert warm.ask(70, "warm")["event"] == "done"
    assert warm.ask(71, "warm", model="/nowhere.pkl")["type"] == "HandModelError"
    assert warm.ask(72, "warm", model=3)["type"] == "OptionError"
    done = warm.ask(73, "check")
    assert done["ok"], done["report"]
    lines = done["report"].splitlines()
    for name in ("numpy", "scipy", "torch", "opencv", "mediapipe", "landmark model", "open hand, left"):
        assert any(line.startswith(name) and line.endswith(": ok") for line in lines), name
    assert "hand_landmarker.task" in done["report"]
    assert any(line.startswith("landmarks of 2020: ") and line.endswith(": ok") for line in lines)
    assert f"core {__version__}" in lines[0]


def test_a_package_that_is_missing_is_a_line_and_an_error(tmp_path: Path) -> None:
    """torch and MediaPipe cannot be imported; the worker starts all the same."""
    code = (
        "import sys\n"
        "sys.modules['torch'] = sys.modules['mediapipe'] = None\n"
        "from handfit_core.__main__ import main\n"
        "main()\n"
    )
    with Worker(code=code) as worker:
        error = worker.ask(1, "capture", **capture_of(tmp_path))
        assert error["type"] == "ModuleNotFoundError"
        assert "mediapipe" in error["message"]
        assert "choose another Python" in error["message"]
        done = worker.ask(2, "check")
        assert done["event"] == "done"
        assert not done["ok"]
        failed = [line for line in done["report"].splitlines() if "FAILED" in line]
        assert failed[0].startswith("mediapipe")
        assert "a Python of your own needs mediapipe>=" in failed[0]
        assert "torch: not installed, which the paper's experiments alone would need: ok" in done["report"]
        assert any(line.startswith("self-test of the detector: FAILED") for line in failed)


def test_prints_of_libraries_do_not_damage_the_protocol() -> None:
    """Python's print, and a write to descriptor 1, in the middle of a request."""
    code = (
        "import os\n"
        "from handfit_core.worker import checking, server\n"
        "def noisy(should_stop):\n"
        "    print('printed')\n"
        "    os.write(1, b'written')\n"
        "    os.system('echo a child')\n"
        "    assert os.read(0, 10) == b''\n"
        "    return {'report': '', 'ok': True}\n"
        "checking.check = noisy\n"
        "server.serve()\n"
    )
    with Worker(code=code) as worker:
        assert worker.ask(1, "check") == {"event": "done", "id": 1, "report": "", "ok": True}
        assert worker.process.stderr is not None
        assert worker.close() == 0
        said = worker.process.stderr.read()
        for noise in (b"printed", b"written", b"a child"):
            assert noise in said


def test_cancel_of_what_runs_and_what_waits(warm: Worker, tmp_path: Path) -> None:
    warm.ask(80, "warm")
    warm.send(id=81, request="capture", **capture_of(tmp_path))
    other = {**capture_of(tmp_path), "output": str(tmp_path / "waits.npz")}
    warm.send(id=82, request="capture", **other)
    while warm.next().get("done") != 1:
        pass
    warm.send(request="cancel", job=82)
    warm.send(request="cancel", job=81)
    waited, _ = warm.last(82)
    assert (waited["type"], waited["details"]) == ("Cancelled", "")
    done, after = warm.last(81)
    assert done["event"] == "done"
    assert done["stopped"]
    assert 1 <= done["frames"] < 24
    assert all(event["id"] == 81 for event in after)
    take = Take.load(tmp_path / "a.npz")
    assert len(take.frame_numbers) == len(take.source.files) == done["frames"]
    assert warm.ask(83, "warm")["event"] == "done"  # nothing of 82 came in between
    assert [p.name for p in tmp_path.iterdir()] == ["a.npz"]


@pytest.mark.parametrize("how", ["end", "closed"])
def test_ends_in_the_middle_of_a_capture(how: str, tmp_path: Path) -> None:
    with Worker() as worker:
        worker.send(id=1, request="capture", **capture_of(tmp_path))
        while worker.next()["event"] != "progress":
            pass
        if how == "end":
            worker.send(request="end")
            assert worker.process.wait(PATIENCE) == 0
        else:
            assert worker.close() == 0
        events = worker.rest()
        assert "done" not in [event["event"] for event in events]
        assert all(event["done"] < event["total"] for event in events if event["event"] == "progress")
        assert list(tmp_path.iterdir()) == []


def test_ends_when_its_events_cannot_be_read_any_more(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-m", "handfit_core", "worker"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        cwd=ROOT,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdout.readline()
        process.stdout.close()
        process.stdin.write(encode({"id": 1, "request": "capture", **capture_of(tmp_path)}))
        process.stdin.flush()
        assert process.wait(PATIENCE) == 0
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGINT for other processes")
def test_interrupting_blender_in_its_terminal_is_not_for_the_worker(fresh: Worker) -> None:
    import signal

    fresh.process.send_signal(signal.SIGINT)
    assert fresh.ask(1, "magic")["type"] == "ProtocolError"


def test_threads_reach_torch_and_the_others() -> None:
    code = (
        "import os\n"
        "from handfit_core.worker import checking\n"
        "from handfit_core.worker.server import THREAD_VARIABLES\n"
        "def told(should_stop):\n"
        "    import torch\n"
        "    variables = [os.environ.get(name) for name in THREAD_VARIABLES]\n"
        "    return {'torch': torch.get_num_threads(), 'variables': variables}\n"
        "checking.check = told\n"
        "from handfit_core.__main__ import main\n"
        "main()\n"
    )
    for threads in (1, 3):
        with Worker("--threads", str(threads), code=code) as worker:
            done = worker.ask(1, "check")
            assert set(done["variables"]) == {str(threads)}
            assert 1 <= done["torch"] <= threads


def test_a_line_without_an_end_is_refused_and_the_next_understood() -> None:
    code = "from handfit_core.worker import server\nserver.LONGEST_REQUEST = 4096\nserver.serve()\n"
    with Worker(code=code) as worker:
        for length in (4096, 4097, 3_000_000):
            worker.send_line(b"x" * length + b"\n")
            error = worker.next()
            assert (error["id"], error["type"]) == (None, "ProtocolError")
            assert "more than 4096 bytes came; send fewer frames" in error["message"]
        worker.send_line(b"x" * 4095 + b"\n")  # as long as a line may be
        assert "not JSON" in worker.next()["message"]
        assert worker.ask(1, "magic")["id"] == 1
        worker.send_line(b"x" * 5000)
        assert worker.close() == 0


def test_a_worker_that_cannot_read_any_more_ends() -> None:
    """Memory runs out over a request; stdin stays open."""
    code = (
        "from handfit_core.worker import server\n"
        "def decode(line):\n"
        "    raise MemoryError\n"
        "server.decode = decode\n"
        "server.serve()\n"
    )
    with Worker(code=code) as worker:
        worker.send(id=1, request="check")
        worker.process.wait(PATIENCE)
        assert worker.process.stderr is not None
        assert worker.process.stderr.read().splitlines()[-1] == b"MemoryError"


def test_threads_must_be_positive() -> None:
    command = [sys.executable, "-m", "handfit_core", "worker", "--threads", "0"]
    result = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, cwd=ROOT)
    assert result.returncode == 1
    assert result.stdout == ""
    assert "at least 1 thread" in result.stderr
