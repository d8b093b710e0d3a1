"""Whole folders of photos and videos without a window: takes, .blend files, exports and previews. A line here
may ask the core's tasks, scene/ and exporters/, and works without a window and without an operator.

docs/batch.md describes every option, the exit codes and report.json. `scripts/batch_fit.py` and
`blender --command manient capture` are its two entries.
"""
