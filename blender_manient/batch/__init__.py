"""Whole folders of photos and videos without a window: takes, .blend files, exports and previews.

docs/batch.md describes every option, the exit codes and report.json. `scripts/batch_fit.py` and
`blender --command manient capture` are its two entries.
"""
