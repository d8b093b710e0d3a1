"""Steps taken at once, or map_yields as something else."""

import pytest

from handfit_core.common.slices import map_yields, run_to_completion


def counting(count: int, fails: bool = False):
    yield from range(count)
    if fails:
        raise ValueError("the last step failed")
    return f"{count} steps"


def test_the_result_of_all_steps():
    assert run_to_completion(counting(0)) == "0 steps"
    told = iter("abc")
    steps = map_yields(counting(3), lambda: next(told))
    assert [next(steps) for _ in range(3)] == ["a", "b", "c"]
    assert run_to_completion(steps) == "3 steps"


def test_errors_pass_through():
    with pytest.raises(ValueError, match="the last step"):
        run_to_completion(map_yields(counting(2, fails=True), lambda: None))
