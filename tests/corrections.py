"""Corrections at random, for the core's tests and for those in Blender."""

from __future__ import annotations

import numpy as np

from handfit_core.edit.corrections import Correction, CorrectionField


def correction(rng: np.random.Generator, spread: float = 6.0, **fields) -> Correction:
    return Correction(
        {8: (1.0, 2.0)},
        rng.normal(scale=0.4, size=(16, 3)),
        rng.normal(scale=0.01, size=3),
        spread,
        **fields,
    )


def random_field(seed: int, frames, spread: float = 6.0) -> CorrectionField:
    rng = np.random.default_rng(seed)
    return CorrectionField({int(f): correction(rng, spread) for f in frames})
