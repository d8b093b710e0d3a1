"""How fast solvers and the whole pipeline are: `python -m benchmarks --help`."""
