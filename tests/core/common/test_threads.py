"""Parts that threads compute come in order, and an error in one ends the rest."""

import threading

import pytest

from handfit_core.common.threads import in_threads


@pytest.mark.parametrize("threads", [1, 3])
def test_parts_come_in_order(threads, monkeypatch):
    monkeypatch.setattr("handfit_core.common.threads.usable_threads", lambda: threads)
    used = set()

    def square(number: int) -> int:
        used.add(threading.current_thread().name)
        return number**2

    assert list(in_threads(square, range(20))) == [number**2 for number in range(20)]
    assert (threading.current_thread().name in used) == (threads == 1)


def test_an_error_comes_in_its_place(monkeypatch):
    monkeypatch.setattr("handfit_core.common.threads.usable_threads", lambda: 2)
    parts = in_threads(lambda number: 12 // number, [3, 2, 0, 1])
    assert [next(parts), next(parts)] == [4, 6]
    with pytest.raises(ZeroDivisionError):
        next(parts)
