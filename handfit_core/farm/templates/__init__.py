"""Job files for farms that a studio has: they run the tasks of a plan on whatever machines the farm chooses.

Each job is the plan's own command, `task PLAN #1-9`, and the last one is `collect`. The farm decides where
and when; claims and seals in the tasks' folders (folder.py) see to it that nothing is done twice.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

from handfit_core.errors import OptionError
from handfit_core.farm.plan import Plan
from handfit_core.files import shown, written_whole

from .farm import MOST_JOBS, PATIENCE, Farm, dealt
from .filled import flamenco, slurm, snakemake
from .openjd import openjd

KINDS: Final[Mapping[str, tuple[str, Callable[[Farm], str]]]] = {
    "openjd": ("{}.openjd.yaml", openjd),
    "flamenco": ("manient_{}.js", flamenco),
    "slurm": ("{}.slurm.sh", slurm),
    "snakemake": ("{}.smk", snakemake),
}
"""What a farm's job file is called beside a plan, and what makes it. Open Job Description's is JSON, which is
YAML too: files that end in .json are plans there."""
_AT_LEAST: Final = 3600.0
"""seconds"""


def write_template(
    kind: str,
    plan: Plan,
    file: Path | None = None,
    *,
    most: int = MOST_JOBS,
    timeout: float | None = None,
    places: Sequence[str] = (),
) -> Path:
    """Write the job file of a kind, by default beside the plan; returns it. Raises OptionError, OutputError.

    The tasks are dealt out to at most `most` jobs; `timeout`: seconds that a task may take; `places`: paths
    that are called otherwise on the farm, as `task --map` takes them.
    """
    name, make = KINDS[kind]
    if not plan.command:
        raise OptionError(f"{shown(plan.path)}: this plan names no command that does its tasks; make it anew")
    file = (file or plan.path.with_name(name.format(plan.path.stem))).absolute()
    if timeout is None:
        timeout = max(_AT_LEAST, PATIENCE * max((task.cost for task in plan.tasks), default=0.0))
    text = make(Farm(plan, file, dealt(plan, most), math.ceil(timeout), places))
    with written_whole(file) as beside:
        beside.write_text(text, encoding="utf-8", errors="surrogateescape", newline="\n")
    return file
