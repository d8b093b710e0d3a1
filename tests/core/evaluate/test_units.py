from __future__ import annotations

from pathlib import Path

import pytest

from handfit_core.evaluate.labels import Entry, Labels, units_of

ENTRIES = [
    Entry(name, Path(name), lambda: Labels((), None), clip)
    for name, clip in (("a", None), ("b", None), ("c", None), ("x1", "x"), ("x2", "x"), ("y1", "y"))
]


@pytest.mark.parametrize(
    ("every", "clips", "expected"),
    [
        (1, True, [["a"], ["b"], ["c"], ["x1", "x2"], ["y1"]]),
        (2, True, [["a"], ["c"], ["x1", "x2"]]),
        (1, False, [["a"], ["b"], ["c"], ["x1"], ["x2"], ["y1"]]),
        (3, False, [["a"], ["x1"]]),
    ],
)
def test_stills_are_units_and_clips_stay_whole(every: int, clips: bool, expected: list[list[str]]) -> None:
    units = units_of(ENTRIES, clips=clips, every=every)
    assert [[e.name for e in unit.entries] for unit in units] == expected
    assert [unit.is_clip for unit in units] == [clips and len(u) > 0 and u[0][0] in "xy" for u in expected]
