"""What hands are judged by, one term a file, each with its Jacobian.

A term is called with posed hands and what is seen of them, and returns `Rows`, or `PairRows` where parts of
a hand meet. All are divided by what they are expected to be (their sigma), so that costs add up.
"""

from handfit_core.fit.terms.apart import Apart
from handfit_core.fit.terms.coupling import coupling
from handfit_core.fit.terms.depth import depth
from handfit_core.fit.terms.distance import distance
from handfit_core.fit.terms.in_front import InFront
from handfit_core.fit.terms.limits import Limits
from handfit_core.fit.terms.near_pose import near_pose
from handfit_core.fit.terms.pose_prior import PosePrior
from handfit_core.fit.terms.reprojection import reprojection
from handfit_core.fit.terms.rows import PairRows, Rows, Term
from handfit_core.fit.terms.shape import Shape
from handfit_core.fit.terms.touch import Touch

__all__ = [
    "Apart",
    "InFront",
    "Limits",
    "PairRows",
    "PosePrior",
    "Rows",
    "Shape",
    "Term",
    "Touch",
    "coupling",
    "depth",
    "distance",
    "near_pose",
    "reprojection",
]
