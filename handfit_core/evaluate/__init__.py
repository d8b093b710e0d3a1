"""Accuracy and speed of solvers on any labelled data set: `python -m handfit_core evaluate`. Modules here may
import anything, pandas too; no capture imports them."""

from typing import Final, Literal

ProtocolName = Literal["strict", "paper"]
CameraChoice = Literal["assumed", "labelled"]
"""The camera that solvers get: a guess, or the data set's labels"""
CAMERA_CHOICES: Final[tuple[CameraChoice, ...]] = ("assumed", "labelled")
