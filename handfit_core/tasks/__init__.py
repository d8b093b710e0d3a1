"""Batches: a task for each input, done by processes of this machine or of a Dask cluster. A line here may
start processes, capture and write records; it knows nothing of Blender.

A task captures one input and writes NAME.json last (`capture.py`). What has its key there is done, so whoever
gives the same command again goes on, on this machine or another, and a task that is done twice does no harm.
"""
