"""Job files that are texts beside this one, in the farms' own languages, in which values are filled in."""

from __future__ import annotations

import json
import math
import re
import shlex
from collections.abc import Callable, Mapping
from pathlib import Path, PurePath
from typing import Any

from handfit_core.errors import OptionError
from handfit_core.files import shown

from .farm import Farm


def flamenco(farm: Farm) -> str:
    """A job type of Flamenco 3."""
    return _filled("flamenco.js", json.dumps, farm)


def slurm(farm: Farm) -> str:
    """A script that submits itself."""
    return _filled("slurm.sh", _shell, farm)


def snakemake(farm: Farm) -> str:
    """A Snakefile. Raises OptionError for names that it could not have."""
    for task in farm.plan.tasks:
        if set(task.name) & set("{}"):
            raise OptionError(
                f"Snakemake cannot have {shown(task.name)} as a file's name, since it has braces; rename the "
                "input, or use another kind of farm"
            )
    return _filled("snakemake.smk", ascii, farm)


def _filled(name: str, quoted: Callable[[Any], str], farm: Farm) -> str:
    """The file of that name, in which @word@ becomes a value, as its language writes it."""
    values = _values(farm)
    text = Path(__file__).with_name(name).read_text(encoding="utf-8")
    return re.sub(r"@(\w+)@", lambda mark: quoted(values[mark[1]]), text)


def _values(farm: Farm) -> Mapping[str, Any]:
    first = 0
    arrays = []
    for level in farm.levels():
        arrays.append(f"{first}-{first + len(level) - 1}")
        first += len(level)
    program, *arguments = farm.plan.command
    if PurePath(program.replace("\\", "/")).name.lower().startswith("blender"):
        program = "{blender}"  # which Flamenco knows the place of, on each machine
    return {
        "title": farm.title,
        "plan": str(farm.plan.path),
        "command": list(farm.plan.command),
        "program": program,
        "arguments": arguments,
        "options": farm.options,
        "jobs": [job.tasks for job in farm.jobs],
        "named": [[job.name, job.tasks, job.after] for job in farm.jobs],
        "arrays": arrays,
        "memory": farm.memory,
        "minutes": math.ceil(farm.longest / 60),
    }


def _shell(value: Any) -> str:
    if isinstance(value, list):
        return f"({' '.join(map(shlex.quote, value))})"
    return shlex.quote(value) if isinstance(value, str) else str(value)
