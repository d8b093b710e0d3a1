"""Geometry in NumPy: rotations, similarity transforms and the pinhole camera, each formula once. A line here
knows nothing but arrays, and may import NumPy and the errors alone."""
