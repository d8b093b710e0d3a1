"""What goes into the add-on's zip, where it comes from, and what is said about it: one concept per file.

`scripts/build_extension.py` is the page that puts these together.
"""
