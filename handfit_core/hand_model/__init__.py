"""Hand models in MANO's format: the bundled open hand, and the user's own MANO files. A line here may read
models and pose them with NumPy and `geometry`; it knows no picture and no solver."""

from handfit_core.hand_model.data import HandModel, ShapedHand, forward_kinematics
from handfit_core.hand_model.files import OPEN_HAND, load_model, load_model_npz, save_model_npz

__all__ = [
    "OPEN_HAND",
    "HandModel",
    "ShapedHand",
    "forward_kinematics",
    "load_model",
    "load_model_npz",
    "save_model_npz",
]
