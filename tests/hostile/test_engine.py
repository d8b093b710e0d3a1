"""The engine catches what it is there to catch: DOORS do what no case may do."""

from __future__ import annotations

import os
import socket
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.common.errors import InputError
from tests.hostile import engine
from tests.hostile.engine import Case, Doorkeeper

if sys.platform != "linux":
    pytest.skip("limits are watched through Linux's /proc", allow_module_level=True)

pytestmark = pytest.mark.quick


def _refuse(text: str = "a sentence") -> None:
    raise InputError(text)


DOORS: dict[str, Callable[..., Any]] = {
    "nothing": lambda: None,
    "refuse": _refuse,
    "raise": lambda: int("no sentence for an artist"),
    "abort": os.abort,
    "eat": lambda size: np.ones(size, dtype=np.uint8) is None,
    "compute": lambda: sum(iter(int, 1)),
    "sleep": lambda: time.sleep(3600),
    "connect": lambda port: socket.create_connection(("127.0.0.1", port)).close(),
    "say": lambda text: print(text, file=sys.stderr),
    "write": lambda name: Path(name).write_bytes(b"x"),
}


@pytest.fixture(scope="module")
def keeper() -> Iterator[Doorkeeper]:
    made = Doorkeeper()
    yield made
    made.close()


def case(door: str, *, refused: bool = False, **arguments: Any) -> Case:
    return Case(door, f"test_engine.{door}", lambda _: arguments, refused)


@pytest.mark.parametrize(
    "good",
    [case("nothing"), case("refuse", refused=True), case("write", name="result/x"), case("eat", size=9**8)],
)
def test_lets_good_cases_pass(keeper: Doorkeeper, good: Case) -> None:
    assert keeper.run(good) == []


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (case("nothing", refused=True), "must be refused"),
        (case("refuse", text="two\nlines"), "no sentence"),
        (case("raise"), "ValueError"),
        (case("abort"), "SIGABRT"),
        (case("eat", size=1_100_000_000), "memory: 11"),
        (case("eat", size=30_000_000_000), "MemoryError"),
        (case("compute"), "SIGXCPU"),
        (case("sleep"), "hangs"),
        (case("say", text="Traceback (most recent call last)"), "stderr"),
        (case("write", name="kept.npz"), "changed: 'kept.npz'"),
        (case("write", name="new"), "left behind: 'new'"),
    ],
    ids=lambda value: value.name if isinstance(value, Case) else "",
)
def test_catches(keeper: Doorkeeper, monkeypatch: pytest.MonkeyPatch, bad: Case, words: str) -> None:
    if bad.name in ("compute", "sleep"):  # which would take their whole time
        monkeypatch.setattr(engine, "CPU_SECONDS" if bad.name == "compute" else "SILENT_SECONDS", 2.0)
    assert words in "; ".join(keeper.run(bad))
    assert keeper.run(case("nothing")) == []  # and goes on


def test_catches_a_connection(keeper: Doorkeeper) -> None:
    assert keeper.run(case("connect", port=keeper.port)) == ["opened a connection"]


def test_a_name_makes_the_same_case_again(keeper: Doorkeeper) -> None:
    drawn: list[float] = []
    for _ in range(2):
        keeper.run(Case("a", "test_engine.nothing", lambda place: drawn.append(place.rng.random()) or {}))
    assert drawn[0] == drawn[1]
