"""Which packages a zip carries, besides handfit_core. NumPy is Blender's own."""

from __future__ import annotations

FOR_TORCH = ("torch", "typing-extensions")
"""Torch and what it imports. What else it declares (sympy, networkx, jinja2, ...) it imports only for what
is not used here."""

RUN_TIME = (*FOR_TORCH, "scipy", "opencv-python-headless", "mediapipe")
"""All that the worker imports. mediapipe declares absl-py, flatbuffers and sounddevice, but its hand
landmarker imports none of them."""
