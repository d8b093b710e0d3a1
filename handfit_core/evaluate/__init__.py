"""How accurate and how fast solvers are, on any labelled data set: `python -m handfit_core evaluate`. A line
here may import anything, pandas too; no capture imports it."""

from typing import Final, Literal

ProtocolName = Literal["strict", "paper"]
CameraChoice = Literal["assumed", "labelled"]
"""What solvers are told about the camera: nothing, or the data set's labels"""
CAMERA_CHOICES: Final[tuple[CameraChoice, ...]] = ("assumed", "labelled")
