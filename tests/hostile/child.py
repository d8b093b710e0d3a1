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

from handfit_core.errors import HandfitError

BACKSTOP_BYTES = 12 << 30
"""Of address space: the watch of engine.py strikes long before, but it looks only every so often."""


def main() -> None:
    requests, answers = os.fdopen(os.dup(0)), os.fdopen(os.dup(1), "w")
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.dup2(2, 1)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_AS, (BACKSTOP_BYTES, BACKSTOP_BYTES))
    doors = importlib.import_module(sys.argv[1]).DOORS
    print('"ready"', file=answers, flush=True)
    for line in requests:
        ask = json.loads(line)
        os.chdir(ask["folder"])
        try:
            doors[ask["door"]](**ask["arguments"])
            answer = {"verdict": "result", "text": ""}
        except HandfitError as error:
            answer = {"verdict": "sentence", "text": str(error)}
        except BaseException as error:  # a case must not end the process, whatever it raises
            frames = traceback.extract_tb(error.__traceback__)[-4:]
            at = " > ".join(f"{os.path.basename(f.filename)}:{f.lineno} {f.name}" for f in frames)  # noqa: PTH119
            answer = {"verdict": "fault", "text": f"{type(error).__name__}: {str(error)[:600]} (at {at})"}
        os.chdir("/")
        sys.stdout.flush()
        sys.stderr.flush()
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    main()
    os._exit(0)  # without the ends of native libraries, which are no part of any case
