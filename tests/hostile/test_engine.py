"""The engine catches what it is there to catch."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

import pytest

if sys.platform != "linux":
    pytest.skip("limits are watched through Linux's /proc", allow_module_level=True)

from tests.hostile import engine
from tests.hostile.engine import Case, Doorkeeper

pytestmark = pytest.mark.quick


@pytest.fixture(scope="module")
def keeper() -> Iterator[Doorkeeper]:
    made = Doorkeeper()
    yield made
    made.close()


def case(door: str, *, refused: bool = False, **arguments: Any) -> Case:
    return Case(door, f"bad.{door}", lambda _: arguments, refused)


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
        (case("refuse", text=""), "no sentence"),
        (case("raise"), "ValueError"),
        (case("exit"), "SystemExit"),
        (case("abort"), "SIGABRT"),
        (case("leave"), "exit code 0"),
        (case("eat", size=1_100_000_000), "memory: 11"),
        (case("eat", size=3_000_000_000), "memory"),
        (case("compute"), "computes"),
        (case("sleep"), "hangs"),
        (case("say", text="Traceback (most recent call last)"), "stderr"),
        (case("write", name="kept.npz"), "changed: 'kept.npz'"),
        (case("write", name="new"), "left behind: 'new'"),
        (case("remove", name="kept.npz"), "lost: 'kept.npz'"),
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
    def drawn() -> float:
        numbers: list[float] = []
        keeper.run(Case("some-name", "bad.nothing", lambda place: numbers.append(place.rng.random()) or {}))
        return numbers[0]

    assert drawn() == drawn()
