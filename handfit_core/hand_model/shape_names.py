"""Names of a model's shape coefficients by what they change, found in the model's own data.

A coefficient moves every vertex of the flat hand. This movement is compared with those of things that an
artist would ask for: a larger hand, longer fingers, a thicker palm, and so on. Where one of them explains
most of it, it gives the coefficient its name. NumPy only.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, NUM_BETAS
from handfit_core.hand_model.data import HandModel

_LONG_FINGERS: Final = tuple(finger for finger in FINGERS if finger != "thumb")


def shape_names(model: HandModel) -> tuple[str | None, ...]:
    """Return for each of the ten betas the name of what its positive direction does, such as "Longer
    Fingers"; None where no single effect dominates, and where another coefficient does so more purely."""
    shares = effect_shares(model)
    names: list[str | None] = [None] * NUM_BETAS
    for beta, row in enumerate(shares):
        effect = max(row, key=lambda name: abs(row[name]), default="")
        purest = max(range(NUM_BETAS), key=lambda other: abs(shares[other].get(effect, 0.0)))
        # Share of the movement beyond which an effect gives the coefficient its name. Of two equal effects
        # each explains half.
        if beta == purest and abs(row.get(effect, 0.0)) > 0.55:
            names[beta] = _worded(effect, grows=row[effect] > 0.0)
    return tuple(names)


def effect_shares(model: HandModel) -> tuple[dict[str, float], ...]:
    """Return for each of the betas, and by the name of each effect, the share of the vertices' movement (sum
    of squares) which that effect alone explains, -1..1; negative where the beta does the opposite. Empty for
    a beta that moves nothing.

    Where the hand is placed does not count: what a movement has in common with a rigid motion of the whole
    hand is taken out first.
    """
    placing = np.linalg.qr(np.stack([m.ravel() for m in _rigid_motions(model)], axis=1))[0]

    def shape_only(movement: np.ndarray) -> np.ndarray:
        """Take the rigid part out of a `movement` (V, 3), and return the rest (V * 3,) with length 1; zeros
        where nothing is left."""
        flat = movement.ravel()
        rest = flat - placing @ (placing.T @ flat)
        length = float(np.linalg.norm(rest))
        return rest / length if length > 1e-9 * max(1.0, float(np.linalg.norm(flat))) else np.zeros_like(rest)

    effects = {name: shape_only(movement) for name, movement in _effects(model)}
    shares = []
    for beta in range(NUM_BETAS):
        movement = shape_only(model.shapedirs[:, :, beta])
        alike = {name: float(effect @ movement) for name, effect in effects.items()}
        shares.append({name: a * abs(a) for name, a in alike.items()} if movement.any() else {})
    return tuple(shares)


def _worded(effect: str, *, grows: bool) -> str:
    part, dimension = effect.rsplit(" ", 1)
    more, less = {
        "size": ("Larger", "Smaller"),
        "length": ("Longer", "Shorter"),
        "thickness": ("Thicker", "Thinner"),
        "width": ("Wider", "Narrower"),
        "spread": ("Spread", "Closed"),
    }[dimension]
    return f"{more if grows else less} {part.title()}"


def _rigid_motions(model: HandModel) -> Iterator[np.ndarray]:
    """Yield the six movements (V, 3) of a hand that keeps its shape: along three axes, and about them."""
    for axis in np.eye(3):
        yield np.broadcast_to(axis, model.v_template.shape)
        yield np.cross(axis, model.v_template)


def _effects(model: HandModel) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the name and the movement (V, 3) of each effect, whose length does not matter."""
    shaped = model.shaped()
    x, wrist = shaped.vertices, shaped.joints[0]
    bones = {
        finger: np.array([*shaped.joints[list(joints)], shaped.tips[FINGERS.index(finger)]])
        for finger, joints in FINGER_JOINTS.items()
    }  # finger -> (4, 3)
    grown = {finger: _grown(model, finger, bones[finger]) for finger in FINGERS}
    longer, thicker = ({finger: both[i] for finger, both in grown.items()} for i in range(2))
    along, back, across = np.eye(3)  # of the model frame; only lines count, so sides do not matter

    yield "hand size", x - wrist
    yield "hand width", _along(across, x - wrist)
    yield "fingers length", np.sum([longer[finger] for finger in _LONG_FINGERS], axis=0)
    all_thicker = np.sum(list(thicker.values()), axis=0)
    yield "fingers thickness", all_thicker
    yield "fingers spread", _spread(model, bones)
    for finger in FINGERS:
        part = "thumb" if finger == "thumb" else f"{finger} finger"
        yield f"{part} length", longer[finger]
        yield f"{part} thickness", thicker[finger]
    # Fingers ride on the palm: each is carried along by the joint at its base.
    carried = model.weights[:, [0]] * (x - wrist)
    for finger, joints in FINGER_JOINTS.items():
        carried = carried + model.weights[:, joints].sum(axis=1, keepdims=True) * (bones[finger][0] - wrist)
    yield "palm length", _along(along, carried)
    yield "palm width", _along(across, carried)
    palm_thicker = _along(back, model.weights[:, [0]] * (x - wrist))
    yield "palm thickness", palm_thicker
    yield "hand thickness", palm_thicker + all_thicker


def _along(axis: np.ndarray, movement: np.ndarray) -> np.ndarray:
    return (movement @ axis)[:, None] * axis


def _grown(model: HandModel, finger: str, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two movements (V, 3) of a finger whose joints and tip are `points` (4, 3): stretched along its
    bones from its base, and grown away from them."""
    longer, thicker = np.zeros_like(model.v_template), np.zeros_like(model.v_template)
    for joint, here, beyond in zip(FINGER_JOINTS[finger], points[:-1], points[1:], strict=True):
        bone = (beyond - here) / np.linalg.norm(beyond - here)
        away = model.v_template - here
        along = _along(bone, away)
        longer += model.weights[:, [joint]] * (here - points[0] + along)
        thicker += model.weights[:, [joint]] * (away - along)
    return longer, thicker


def _spread(model: HandModel, bones: dict[str, np.ndarray]) -> np.ndarray:
    """Return the movement (V, 3) that turns the long fingers apart in the palm's plane, the outer ones
    most."""
    places = np.array([bones[finger][0, 2] for finger in _LONG_FINGERS])
    moved = np.zeros_like(model.v_template)
    for finger, place in zip(_LONG_FINGERS, places - places.mean(), strict=True):
        base, tip = bones[finger][0], bones[finger][3]
        # The sign that takes the tip to where the base already lies, seen from the middle.
        turned = np.cross([0.0, place, 0.0], model.v_template - base)
        outwards = np.sign(np.cross([0.0, place, 0.0], tip - base)[2] * place)
        weights = model.weights[:, FINGER_JOINTS[finger]].sum(axis=1, keepdims=True)
        moved += outwards * weights * turned
    return moved
