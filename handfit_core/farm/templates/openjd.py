"""A job template of Open Job Description, 2023-09: for AWS Deadline Cloud and whatever else takes it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from handfit_core.farm.pool import ATTEMPTS

from .farm import Farm

_LONGEST_NAME = 128
_NOTICE = 30
"""seconds between a farm's request to end and the end"""


def openjd(farm: Farm) -> str:
    """The template of a plan, as JSON: a step for each level of tasks, and the report.

    The plan is a PATH, so that the farm's path mapping finds it, and the paths in it are mapped by the rules
    that the farm has for the session. The parts of the command are parameters as well: their values may have
    braces, which in the template itself would stand for something else.
    """
    plan: dict[str, Any] = {"name": "Plan", "type": "PATH", "objectType": "FILE", "dataFlow": "NONE"}
    if farm.file.parent == farm.plan.path.parent:  # a default must lie beside the template
        plan["default"] = farm.plan.path.name
    words = [*farm.plan.command, *farm.options]
    parameters = [
        {"name": f"Command{number}", "type": "STRING", "default": word}
        for number, word in enumerate(words, 1)
    ]
    command = [f"{{{{Param.{each['name']}}}}}" for each in parameters]
    program, told = command[: len(farm.plan.command)], command[len(farm.plan.command) :]
    steps: list[dict[str, Any]] = []
    for number, level in enumerate(farm.levels(), 1):
        rules = ["--map", "{{Session.PathMappingRulesFile}}", "--progress", "openjd", "--accept-failed"]
        this = [*program, "task", "{{Param.Plan}}", "{{Task.Param.Tasks}}", *told, *rules]
        values = [job.tasks for job in level]
        space = {"taskParameterDefinitions": [{"name": "Tasks", "type": "STRING", "range": values}]}
        steps.append(
            {
                "name": f"Hands{number}",
                "parameterSpace": space,
                "hostRequirements": {"amounts": [{"name": "amount.worker.memory", "min": farm.memory}]},
                **_run(this, ATTEMPTS * round(farm.longest), steps),
            }
        )
    collect = [*program, "collect", "{{Param.Plan}}"]
    name = farm.title.replace("{", "(").replace("}", ")")[:_LONGEST_NAME]
    template = {
        "specificationVersion": "jobtemplate-2023-09",
        "name": "".join(c for c in name if c.isprintable()),
        "parameterDefinitions": [plan, *parameters],
        "steps": [*steps, {"name": "Report", **_run(collect, 3600, steps)}],
    }
    return json.dumps(template, indent=1, ensure_ascii=False) + "\n"


def _run(command: Sequence[str], seconds: int, before: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """What a step does, and the steps that it waits for."""
    action = {
        "command": command[0],
        "args": list(command[1:]),
        "timeout": seconds,
        "cancelation": {"mode": "NOTIFY_THEN_TERMINATE", "notifyPeriodInSeconds": _NOTICE},
    }
    after = {"dependencies": [{"dependsOn": step["name"]} for step in before]} if before else {}
    return {**after, "script": {"actions": {"onRun": action}}}
