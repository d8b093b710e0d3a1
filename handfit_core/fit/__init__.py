"""Fitting hands to what is seen of them: a `Problem` in, a `Solution` out. NumPy; SciPy for clips."""
