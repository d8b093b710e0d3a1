"""The residual terms of a fit, one a file, each with its Jacobian. A line here computes rows from poses, and
neither solves nor decides.

A term is called with posed hands and their `Observation`, and returns `Rows`, `PairRows` where it couples two
parts of a hand, or `SkinRows` of places on its skin. All residuals are divided by their expected size (their
sigma), so that costs add up.
"""

from handfit_core.fit.terms.contact import Contact
from handfit_core.fit.terms.coupling import coupling
from handfit_core.fit.terms.depth import depth
from handfit_core.fit.terms.distance import distance
from handfit_core.fit.terms.grip import grip, near_wrist
from handfit_core.fit.terms.interpenetration import Interpenetration
from handfit_core.fit.terms.limits import Limits
from handfit_core.fit.terms.near_pose import near_pose
from handfit_core.fit.terms.ordinal_depth import OrdinalDepth
from handfit_core.fit.terms.pose_prior import PosePrior
from handfit_core.fit.terms.reprojection import reprojection
from handfit_core.fit.terms.rows import PairRows, Rows, SkinRows, Term
from handfit_core.fit.terms.second_view import second_view
from handfit_core.fit.terms.shape import Shape

__all__ = [
    "Contact",
    "Interpenetration",
    "Limits",
    "OrdinalDepth",
    "PairRows",
    "PosePrior",
    "Rows",
    "Shape",
    "SkinRows",
    "Term",
    "coupling",
    "depth",
    "distance",
    "grip",
    "near_pose",
    "near_wrist",
    "reprojection",
    "second_view",
]
