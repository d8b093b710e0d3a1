"""Hands and keypoints of other programs, in and out. A line here may read files that nobody trusts, within
bounds, and make takes of them; it knows no scene.

Reading: a `Document` is opened, a `Reader` recognises it and gives a `Recording`, of which `pipeline` makes
a take. Writing: a `Writer` makes a file of a take. One format a file of `formats/`.
"""
