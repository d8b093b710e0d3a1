# Hands of a plan: snakemake -s THIS_FILE --cores 8 --keep-going
import json
from pathlib import Path

PLAN = @plan@
COMMAND = @command@
OPTIONS = @options@

_plan = json.loads(Path(PLAN).read_bytes())
_tasks = {task["name"]: task for task in _plan["tasks"]}
_names = {task["id"]: name for name, task in _tasks.items()}


def done(name):
    return f"{name}.done.json" if _plan["flat"] else f"{name}/done.json"


workdir: str(Path(PLAN).parent.parent)


rule all:
    input:
        lambda _: [done(name) for name, task in _tasks.items() if not task.get("of")],


rule task:
    input:
        lambda found: [done(_names[id]) for id in _tasks[found.name].get("needs", ())],
    output:
        done("{name}"),
    wildcard_constraints:
        name="[^/]+",
    params:
        id=lambda found: _tasks[found.name]["id"],
    threads: 4
    retries: 2
    resources:
        mem_mb=@memory@,
    shell:
        "{COMMAND:q} task {PLAN:q} {params.id:q} --processes {threads} {OPTIONS:q}"


onsuccess:
    shell("{COMMAND:q} collect {PLAN:q}")


onerror:
    shell("{COMMAND:q} collect {PLAN:q} || true")
