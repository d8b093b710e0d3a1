"""Hostile inputs: no crash, hang, traceback, lost file, connection, or use of more than 1 GB.

`nox -s hostile` runs all, `nox -s hostile -- -m quick` a part of each kind, `nox -s hostile -- -k NAME` one:
the name is all that is needed to make a case again. Everything is generated, nothing is kept.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

import pytest

if sys.platform != "linux":
    pytest.skip("limits are watched through Linux's /proc", allow_module_level=True)
pytest.importorskip("bpy", reason="needs one of the bpy wheels")
pytest.importorskip("cv2", reason="needs OpenCV")

from tests.hostile import (
    blends,
    commands,
    models,
    names,
    pickles,
    pictures,
    recordings,
    records,
    takes,
    videos,
)
from tests.hostile.engine import Case, Doorkeeper

KINDS = (takes, recordings, records, models, pickles, pictures, videos, names, commands, blends)
# By door, so that the children that hold a door open change places once.
CASES = sorted(
    (case for kind in KINDS for case in kind.cases()), key=lambda case: case.door.partition(".")[0]
)


@pytest.fixture(scope="module")
def keeper() -> Iterator[Doorkeeper]:
    made = Doorkeeper()
    yield made
    made.close()


@pytest.mark.quick
def test_there_are_as_many_as_promised() -> None:
    assert len(CASES) >= 1500
    assert len({case.name for case in CASES}) == len(CASES)


@pytest.mark.parametrize(
    "case", [pytest.param(c, id=c.name, marks=[pytest.mark.quick] if c.quick else []) for c in CASES]
)
def test_case(keeper: Doorkeeper, case: Case) -> None:
    faults = keeper.run(case)
    if faults:
        pytest.fail("; ".join(faults), pytrace=False)
