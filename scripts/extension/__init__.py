"""The parts of the add-on's zip, their sources, and the texts about them: one concept per file.

`scripts/build_extension.py` is the page that puts these together.
"""
