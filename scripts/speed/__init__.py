"""How fast solvers and the whole pipeline are, and how much memory they take (scripts/measure_speed.py)."""
