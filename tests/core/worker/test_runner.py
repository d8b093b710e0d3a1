"""What all runners have in common: a child process, this process and a pool answer alike."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from handfit_core.errors import Cancelled, InputError, OptionError
from handfit_core.worker.answering import answer
from handfit_core.worker.client import Worker
from handfit_core.worker.pool import Pool
from handfit_core.worker.runner import Answer, InProcess, OnProgress, Runner


def the_workers_answers() -> Answer:
    return answer


RUNNERS: dict[str, Callable[[], Runner]] = {
    "worker": lambda: Worker(threads=1),
    "in-process": lambda: InProcess(answer),
    "pool": lambda: Pool(2, the_workers_answers),
}


@pytest.fixture(params=RUNNERS)
def runner(request: pytest.FixtureRequest) -> Iterator[Runner]:
    with RUNNERS[request.param]() as made:
        yield made


@pytest.fixture
def picture(tmp_path: Path) -> str:
    path = tmp_path / "grey.png"
    assert cv2.imwrite(str(path), np.full((48, 64, 3), 128, np.uint8))
    return str(path)


def test_all_runners_answer_alike(runner: Runner, picture: str, tmp_path: Path) -> None:
    good = runner.submit("probe", input=[picture])
    bad = runner.submit("probe", input=[str(tmp_path / "nowhere.png")])
    assert runner.busy
    done = runner.wait(good, timeout=60)
    assert (done["kind"], done["width"], done["height"]) == ("photo", 64, 48)
    with pytest.raises(InputError, match=r"nowhere\.png") as caught:
        runner.wait(bad, timeout=60)
    assert "\n" not in str(caught.value)
    assert not runner.busy
    with pytest.raises(ValueError, match="answered before"):
        runner.wait(good)


def test_results_come_as_they_end_and_the_first_error_is_raised(runner: Runner, picture: str) -> None:
    requests = [runner.submit("probe", input=[picture]) for _ in range(3)]
    assert {done["id"] for done in runner.results(*requests)} == set(requests)
    wrong = runner.submit("probe", input=7)
    with pytest.raises(OptionError, match="got 7"):
        list(runner.results(wrong))


def test_each_asker_hears_of_its_own_requests(runner: Runner, picture: str) -> None:
    first, second = (runner.submit("probe", input=[picture]) for _ in range(2))
    runner.wait(second, timeout=60)
    assert runner.wait(first, timeout=60)["id"] == first


def test_what_waits_can_be_cancelled_and_stopped(runner: Runner, picture: str) -> None:
    for _ in range(8):
        runner.submit("warm", model="nowhere")
    last, other = (runner.submit("probe", input=[picture]) for _ in range(2))
    runner.cancel(last)
    runner.cancel(last)
    runner.stop()
    ended = {event["id"]: event for event in runner.events() if event["event"] in ("done", "error")}
    assert len(ended) == 10
    assert ended[last]["type"] == ended[other]["type"] == Cancelled.__name__
    assert not runner.busy


def talking(
    message: Mapping[str, Any], _should_stop: Callable[[], bool], on_progress: OnProgress
) -> dict[str, Any]:
    """Says much more than a pipe holds, then what it knows of its process."""
    for number in range(message["count"]):
        on_progress("fit", number, message["count"])
    logging.getLogger("handfit").warning("it is\ndark")
    if message["count"] < 0:
        raise KeyboardInterrupt
    if message["count"] == 0:
        raise ZeroDivisionError("nothing to say")
    return {"pid": os.getpid(), "threads": os.environ.get("OMP_NUM_THREADS")}


def a_talker() -> Answer:
    return talking


@pytest.mark.parametrize("make", [lambda: InProcess(talking), lambda: Pool(2, a_talker)])
def test_what_a_request_says_on_the_way_comes_before_its_end(make: Callable[[], Runner]) -> None:
    said: list[dict[str, Any]] = []
    with make() as runner:
        request = runner.submit("talk", count=5000)
        runner.wait(request, said.append, timeout=60)
    assert [event["done"] for event in said[:-1]] == list(range(5000))
    assert said[-1] == {"event": "warning", "id": request, "message": "it is dark"}


def test_ctrl_c_that_reached_a_child_is_no_defect() -> None:
    with Pool(1, a_talker) as runner, pytest.raises(Cancelled, match="interrupted"):
        runner.wait(runner.submit("talk", count=-1))


def test_an_unexpected_error_comes_back_as_what_it_was() -> None:
    for runner in (InProcess(talking), Pool(1, a_talker)):
        with runner, pytest.raises(ZeroDivisionError, match="nothing to say"):
            runner.wait(runner.submit("talk", count=0))


def test_a_pool_has_processes_of_its_own_with_one_thread_each() -> None:
    before = os.environ.get("OMP_NUM_THREADS")
    with Pool(2, a_talker) as runner:
        requests = [runner.submit("talk", count=1) for _ in range(4)]
        done = list(runner.results(*requests))
    assert os.getpid() not in {event["pid"] for event in done}
    assert {event["threads"] for event in done} == {"1"}
    assert os.environ.get("OMP_NUM_THREADS") == before


_ENDS_SLOWLY = """
import os, time
from handfit_core.worker import process
class Last:
    def __del__(self, sleep=time.sleep):
        sleep(0.5)
kept = Last()
process._PARENT_POLL_SECONDS = 0.01
process.end_with_parent(os.getppid(), lambda: None)
"""


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="this system has no such timers")
def test_who_looks_for_its_parent_is_not_killed_by_that_while_it_ends() -> None:
    assert subprocess.run([sys.executable, "-c", _ENDS_SLOWLY], timeout=60, check=False).returncode == 0
