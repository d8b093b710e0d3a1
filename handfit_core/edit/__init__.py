"""Re-fitting frames of a captured hand with an artist's corrections: points that are pinned to where they
belong in the picture, and joints that are locked. A line here may ask the fit; it knows takes, and no scene.

Light to import: SciPy loads with the first range.
"""

from handfit_core.edit.hand import Prop, RefineHand, SecondSight, second_sight
from handfit_core.edit.handles import POINT_NAMES, gaps_between, landmark_points, lying_over, touching_pair
from handfit_core.edit.messages import answer, from_message, result_from_message, to_message
from handfit_core.edit.refit import refit_each, refit_grip, refit_range, warm_up

__all__ = [
    "POINT_NAMES",
    "Prop",
    "RefineHand",
    "SecondSight",
    "answer",
    "from_message",
    "gaps_between",
    "landmark_points",
    "lying_over",
    "refit_each",
    "refit_grip",
    "refit_range",
    "result_from_message",
    "second_sight",
    "to_message",
    "touching_pair",
    "warm_up",
]
