import numpy as np
import pytest

from benchmarks import interleaved as module
from benchmarks.interleaved import Contender, Spread, Timing, interleaved


def test_everything_has_its_turn_in_every_round() -> None:
    log: list[tuple[str, int]] = []

    def contender(name: str, calls: int = 1) -> Contender:
        return Contender(name, lambda number: log.append((name, number)), calls=calls)

    done: list[int] = []
    timings = interleaved([contender("a"), contender("b", calls=2)], 3, done.append)
    warm_up = [("a", 0), ("b", 0)]
    assert log == warm_up + [(name, n) for n in range(3) for name in ("a", "b", "b")]
    assert done == [1, 2, 3]
    assert [t.name for t in timings] == ["a", "b"]
    assert [[len(calls) for calls in t.rounds] for t in timings] == [[1, 1, 1], [2, 2, 2]]


def test_seconds_are_those_of_the_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 0.0

    def work(seconds: float) -> None:
        nonlocal now
        now += seconds

    monkeypatch.setattr(module.time, "perf_counter", lambda: now)
    slow, quick = interleaved(
        [Contender("slow", lambda n: work(10.0 + n)), Contender("quick", lambda _: work(2.0), frames=4)], 3
    )
    assert slow.rounds == [[10.0], [11.0], [12.0]]
    assert slow.seconds_per_frame == Spread(11.0, 10.5, 11.5)
    assert quick.seconds_per_frame == Spread(0.5, 0.5, 0.5)


def test_spreads() -> None:
    values = [5.0, 1.0, 2.0, 4.0, 3.0]
    assert Spread.of(values) == Spread(3.0, 2.0, 4.0)
    assert Spread.with_extremes(values) == Spread(3.0, 1.0, 5.0)


def test_ratios_are_taken_within_rounds() -> None:
    # The machine is ten times slower in the second round: no ratio sees it.
    paper = Timing("paper", 1, rounds=[[1.0], [10.0], [1.2]])
    fast = Timing("fast", 8, rounds=[[0.08, 0.04, 9.0], [0.8, 0.4, 0.81], [0.08, 0.08, 0.08]])
    ratio = fast.times_faster_than(paper)
    assert ratio.median == pytest.approx(100.0)
    assert (ratio.low, ratio.high) == pytest.approx((100.0, 120.0))
    back = paper.times_faster_than(fast)
    assert back.median == pytest.approx(0.01)
    np.testing.assert_allclose(fast.times_faster_than(fast).median, 1.0)
