"""Import one module beside NumPy and print seconds and MB of memory as JSON: `packages_child MODULE`."""

import importlib
import json
import sys
import time

# Not memory_child's: that loads NumPy and half of the core.
MB = 1_000_000


def resident() -> float:
    """MB of memory that this process holds now; 0 where the system does not tell."""
    try:
        with open("/proc/self/status", encoding="ascii", errors="replace") as stream:
            return next(int(line.split()[1]) for line in stream if line.startswith("VmRSS:")) * 1024 / MB
    except OSError:
        return 0.0


def main(module: str) -> None:
    """Import it."""
    if module != "numpy":
        importlib.import_module("numpy")
    before, started = resident(), time.perf_counter()
    importlib.import_module(module)
    print(json.dumps([time.perf_counter() - started, resident() - before]))


if __name__ == "__main__":
    main(*sys.argv[1:])
