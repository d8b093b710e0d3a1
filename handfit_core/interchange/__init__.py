"""Hands and keypoints of other programs, in and out.

Reading: a `Document` is opened, a `Reader` recognises it and gives a `Recording`, of which `pipeline` makes
a take. Writing: a `Writer` makes a file of a take. One format a file of `formats/`.
"""
