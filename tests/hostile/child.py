"""The process in which hostile cases run: it takes them one by one on stdin, and answers on stdout.

`python -m tests.hostile.child MODULE`: its DOORS are functions that raise HandfitError for what they refuse.
"""

from __future__ import annotations

import importlib
import json
import os
import resource
import sys
import traceback
from pathlib import Path

from handfit_core.common.errors import HandfitError

MOST_ADDRESSES = 12 << 30
"""Bytes of address space, which end what would take all of the machine's memory"""


def memory(*fields: str) -> list[int]:
    """Bytes of fields of /proc/self/status."""
    found = dict(line.split(":") for line in Path("/proc/self/status").read_text().splitlines())
    return [int(found[field].split()[0]) * 1024 for field in fields]


def answer(door, ask: dict) -> dict:
    """What comes of a case: {"verdict", "text"}, and the memory that it took."""
    os.chdir(ask["folder"])
    Path("/proc/self/clear_refs").write_text("5")  # the peak of memory begins anew
    used = resource.getrusage(resource.RUSAGE_SELF)
    limit = int(used.ru_utime + used.ru_stime + ask["cpu_seconds"]) + 1
    resource.setrlimit(resource.RLIMIT_CPU, (limit, resource.RLIM_INFINITY))
    try:
        door(**ask["arguments"])
        verdict, text = "result", ""
    except HandfitError as error:
        verdict, text = "sentence", str(error)
    except BaseException as error:  # a case must not end the process, whatever it raises
        frames = traceback.extract_tb(error.__traceback__)[-4:]
        at = " > ".join(f"{os.path.basename(f.filename)}:{f.lineno} {f.name}" for f in frames)  # noqa: PTH119
        verdict, text = "fault", f"{type(error).__name__}: {str(error)[:600]} (at {at})"
    os.chdir("/")
    # Without the pages of libraries, which differ by a hundred MB with how the system happens to map them.
    peak, libraries, now = memory("VmHWM", "RssFile", "VmRSS")
    return {"verdict": verdict, "text": text, "peak": peak - libraries, "now": now}


def main() -> None:
    requests, answers = os.fdopen(os.dup(0)), os.fdopen(os.dup(1), "w")
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.dup2(2, 1)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (MOST_ADDRESSES, MOST_ADDRESSES))
    doors = importlib.import_module(sys.argv[1]).DOORS
    print('"ready"', file=answers, flush=True)
    for line in requests:
        ask = json.loads(line)
        found = answer(doors[ask["door"]], ask)
        sys.stdout.flush()
        sys.stderr.flush()
        print(json.dumps(found), file=answers, flush=True)


if __name__ == "__main__":
    main()
    os._exit(0)  # without the ends of native libraries, which are no part of any case
