"""How accurate and how fast solvers are, on any labelled data set: `python -m handfit_core evaluate`."""
