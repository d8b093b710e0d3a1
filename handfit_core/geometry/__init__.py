"""Geometry in NumPy: rotations, similarity transforms and the pinhole camera, each formula once."""
