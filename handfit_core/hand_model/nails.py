"""The polygons of a hand model that are fingernails."""

from __future__ import annotations

from typing import Final

import numpy as np

from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.files import OPEN_HAND

_OPEN_HAND_NAILS: Final = (
    *(844, 845, 846, 847, 848, 849),  # thumb
    *(170, 171, 172, 173, 174, 175, 894, 895, 1046, 1047),
    *(356, 357, 358, 359, 360, 361, 932, 933, 1084, 1085),
    *(542, 543, 544, 545, 546, 547, 970, 971, 1122, 1123),
    *(728, 729, 730, 731, 732, 733, 1008, 1009, 1160, 1161),  # little finger
)
"""Numbers of the quads that are nails on both open hands: MakeHuman models nails as plates in a groove, and
its quads keep their order"""


def nail_polygons(model: HandModel) -> np.ndarray:
    """Tell which polygons of a model are fingernails: (P,) bool. Only the open hand has nails: in MANO's mesh
    no faces follow their outline."""
    nails = np.zeros(len(model.polygons), dtype=bool)
    if model.name == OPEN_HAND and model.quads is not None:
        nails[list(_OPEN_HAND_NAILS)] = True
    return nails
