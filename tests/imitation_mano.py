"""Imitations of MANO's licensed files, so that tests can run without them.

The hand is tubes around plausible bones: MANO's vertex and face counts, joint order, axes and key
names, none of its data. `write_mano_pickle` writes it as the released files are written: pickle
protocol 2 from Python 2, chumpy objects, and a sparse matrix under SciPy's old module name.
"""

from __future__ import annotations

import pickle
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, PARENTS
from handfit_core.hand_model import HandModel, load_model
from handfit_core.hand_model.checks import checked_model

VERTICES = 778
FACES = 1538
TIPS = {"thumb": 745, "index": 317, "middle": 444, "ring": 556, "little": 673}


def _rest_points() -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The wrist (3,), and three joints and the tip (4, 3) of each finger, metres: the open hand's."""
    shaped = load_model("open-hand", "right").shaped()
    fingers = {
        finger: np.array([*shaped.joints[list(FINGER_JOINTS[finger])], shaped.tips[FINGERS.index(finger)]])
        for finger in ("index", "middle", "little", "ring", "thumb")
    }
    return shaped.joints[0], fingers


_WRIST, _FINGERS = _rest_points()


def imitation_arrays(
    side: str = "right", *, seed: int = 0, left_fault: bool = False
) -> dict[str, np.ndarray]:
    """The arrays of an imitation under MANO's key names; J_regressor dense, parents as uint32.

    The left hand is the exact mirror image of the right one with the same seed. `left_fault` gives
    its shape directions the right hand's sign in x, as the released left model has them.
    """
    rng = np.random.default_rng(seed)
    parts = [_tube(np.array([_WRIST, (0.012, 0.003, -0.006)]), (0, 9), (16, 10), (0.012, 0.030))]
    bones = [[(0, 0), (9, 0)]]
    for number, (name, chain) in enumerate(_FINGERS.items()):
        thumb = name == "thumb"
        stops = (0, 5, 10, 13) if thumb else (0, 4, 8, 11)
        parts.append(_tube(np.array(chain), stops, (9, 14) if thumb else (10, 12), (0.008, 0.008)))
        bones.append([(stop, 1 + 3 * number + i) for i, stop in enumerate(stops[:3])])

    vertices, faces, weights, regressor, tips = [], [], [], np.zeros((16, VERTICES)), {}
    start = 0
    for part, ((points, part_faces, rings, around), stops) in enumerate(zip(parts, bones, strict=True)):
        part_weights = np.zeros((len(points), 16))
        for ring in range(rings):
            rows = slice(ring * around, (ring + 1) * around)
            for stop, joint in stops:
                if stop == ring and (part > 0 or ring == 0):
                    regressor[joint, start + ring * around : start + (ring + 1) * around] = 1 / around
            joint = max((stop, j) for stop, j in stops if stop <= ring)
            # Half the parent's on the joint itself, less beyond it, never quite none.
            share = {0: 0.5, 1: 0.1}.get(ring - joint[0], 0.02) if joint[1] else 0.0
            part_weights[rows, joint[1]] += 1 - share
            part_weights[rows, max(PARENTS[joint[1]], 0)] += share
        part_weights[-2] = part_weights[0]
        part_weights[-1] = part_weights[(rings - 1) * around]
        if part:
            tips[list(_FINGERS)[part - 1]] = start + len(points) - 1
        vertices.append(points)
        weights.append(part_weights)
        faces.append(part_faces + start)
        start += len(points)
    # Webs between the fingers' bases and the palm bring the faces to MANO's number.
    bases = np.cumsum([0] + [len(p) for p in vertices])[1:6]
    webs = np.array([(a, a + 1, 160) for a in bases] + [(bases[0], bases[1], 160)])
    vertices_, weights_ = np.concatenate(vertices), np.concatenate(weights)
    faces_ = np.concatenate([*faces, webs])

    # Put the fingertips where MANO has them.
    order = np.arange(VERTICES)
    for name, place in TIPS.items():
        now = int(np.flatnonzero(order == tips[name])[0])
        order[[place, now]] = order[[now, place]]
    place_of = np.argsort(order)
    vertices_, weights_, regressor = vertices_[order], weights_[order], regressor[:, order]
    faces_ = place_of[faces_]

    centre = np.array(_WRIST)
    shapedirs = np.zeros((VERTICES, 3, 10))
    shapedirs[:, :, 0] = 0.06 * (vertices_ - centre)
    shapedirs[:, :, 1] = (vertices_ - centre) * (0.02, -0.01, -0.02)
    for i in range(2, 10):
        bend = rng.normal(size=(3, 3)) * 0.01 / i
        shapedirs[:, :, i] = (vertices_ - centre) @ bend + 1e-3 / i * np.sin(
            vertices_ @ rng.normal(size=(3, 3)) * 40
        )
    posedirs = rng.normal(size=(VERTICES, 3, 135)) * 4e-4
    hands_mean = np.tile([0.1, 0.05, 0.3], 15) * rng.uniform(0.3, 1.0, 45)
    components = np.linalg.qr(rng.normal(size=(45, 45)))[0]

    if side == "left":
        mirror = np.array([-1.0, 1.0, 1.0])
        vertices_ = vertices_ * mirror
        if not left_fault:
            shapedirs = shapedirs * mirror[:, None]
        # A mirrored rotation: elements of R - I with exactly one x change their sign.
        feature_sign = np.tile(np.outer(mirror, mirror).reshape(-1), 15)
        posedirs = posedirs * mirror[:, None] * feature_sign
        pose_sign = np.tile([1.0, -1.0, -1.0], 15)
        hands_mean, components = hands_mean * pose_sign, components * pose_sign
        faces_ = faces_[:, ::-1]
    return {
        "v_template": vertices_,
        "f": faces_.astype(np.uint32),
        "shapedirs": shapedirs,
        "posedirs": posedirs,
        "J_regressor": regressor,
        "J": regressor @ vertices_,
        "weights": weights_,
        "kintree_table": np.array([[p % 2**32 for p in PARENTS], range(16)], dtype=np.uint32),
        "hands_components": components,
        "hands_mean": hands_mean,
        "hands_coeffs": rng.normal(size=(20, 45)),
    }


def imitation_model(side: str = "right", *, pose_blendshapes: bool = True) -> HandModel:
    """An imitation as a HandModel, without going through a file."""
    arrays = imitation_arrays(side)
    arrays |= {"faces": arrays["f"], "joint_regressor": arrays["J_regressor"]}
    arrays |= {
        "posedirs": arrays["posedirs"] * pose_blendshapes,
        "tip_vertices": np.array(list(TIPS.values())),
    }
    return checked_model(arrays, where="imitation", name="imitation", side=side)


def write_mano_pickle(path: Path, arrays: dict[str, Any], *, select: bool = False) -> Path:
    """Write arrays as a released MANO file: Python 2's pickle with chumpy and old SciPy names.

    `select` stores shapedirs as chumpy.reordering.Select over a larger array, as SMPL-family files do.
    """
    content: dict[str, Any] = arrays | {"bs_style": "lbs", "bs_type": "lrotmin"}
    content["J_regressor"] = Instance("scipy.sparse.csc", "csc_matrix", csc_fields(arrays["J_regressor"]))
    if select:
        whole = np.concatenate([arrays["shapedirs"], np.ones((VERTICES, 3, 5))], axis=2)
        chosen = np.arange(whole.size).reshape(whole.shape)[:, :, :10].reshape(-1)
        fields = {"a": Instance("chumpy.ch", "Ch", {"x": whole}), "idxs": chosen}
        fields["preferred_shape"] = (VERTICES, 3, 10)
        content["shapedirs"] = Instance("chumpy.reordering", "Select", fields)
    else:
        fields = {"x": arrays["shapedirs"], "_dirty_vars": {"x"}, "_itr": None}
        content["shapedirs"] = Instance("chumpy.ch", "Ch", fields)
    with path.open("wb") as stream:
        _Python2Pickler(stream, protocol=2).dump(content)
    return path


@dataclass(frozen=True, eq=False)
class Instance:
    """An object of a class that is not installed, by its `__dict__`."""

    module: str
    name: str
    fields: dict[str, Any]


def csc_fields(dense: np.ndarray) -> dict[str, Any]:
    """What a scipy.sparse csc_matrix keeps in its `__dict__`."""
    columns, rows = np.nonzero(dense.T)
    return {
        "_shape": dense.shape,
        "maxprint": 50,
        "indices": rows.astype(np.int32),
        "indptr": np.searchsorted(columns, np.arange(dense.shape[1] + 1)).astype(np.int32),
        "data": dense.T[columns, rows],
    }


class _Python2Pickler(pickle._Pickler):
    """Writes protocol 2 the way Python 2 does: bytes and text are 8-bit strings, modules have old names."""

    dispatch: ClassVar[dict[Any, Any]] = dict(pickle._Pickler.dispatch)

    def _save_string(self, obj: str | bytes) -> None:
        raw = obj.encode("latin1") if isinstance(obj, str) else obj
        self.write(pickle.BINSTRING + len(raw).to_bytes(4, "little") + raw)
        self.memoize(obj)

    def _save_instance(self, obj: Instance) -> None:
        self.write(f"c{obj.module}\n{obj.name}\n".encode() + pickle.EMPTY_TUPLE + pickle.NEWOBJ)
        self.memoize(obj)
        self.save(obj.fields)
        self.write(pickle.BUILD)

    dispatch[bytes] = dispatch[str] = _save_string
    dispatch[Instance] = _save_instance

    def save_global(self, obj: Any, name: str | None = None) -> None:
        module = {"numpy._core.multiarray": "numpy.core.multiarray", "builtins": "__builtin__"}.get(
            obj.__module__, obj.__module__
        )
        self.write(f"c{module}\n{name or obj.__qualname__}\n".encode("ascii"))
        self.memoize(obj)


def _tube(
    chain: np.ndarray, stops: tuple[int, ...], size: tuple[int, int], radii: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray, int, int]:
    """Rings along a chain of points, closed by a point at each end (its base, then its tip).

    Returns vertices, faces, the number of rings and the vertices per ring. Ring `stops[i]` is
    centred on chain[i].
    """
    around, rings = size
    position = np.arange(rings)
    centres = np.stack([np.interp(position, stops, chain[:, c]) for c in range(3)], axis=1)
    along = chain[-1] - chain[0]
    across = np.cross(along, (0.0, 1.0, 0.0))
    across /= np.linalg.norm(across)
    up = np.cross(across, along) / np.linalg.norm(along)
    angle = 2 * np.pi * np.arange(around) / around
    ring = radii[0] * np.cos(angle)[:, None] * up + radii[1] * np.sin(angle)[:, None] * across
    taper = np.where(position == rings - 1, 0.6, 1.0)
    points = (centres[:, None] + taper[:, None, None] * ring).reshape(-1, 3)
    tip = centres[-1] + 0.004 * along / np.linalg.norm(along)
    points = np.concatenate([points, centres[:1], tip[None]])

    base, end, faces = len(points) - 2, len(points) - 1, []
    for i in range(around):
        j = (i + 1) % around
        last = (rings - 1) * around
        faces += [(base, j, i), (end, last + i, last + j)]
        for r in range(rings - 1):
            a, b, c, d = r * around + i, r * around + j, (r + 1) * around + i, (r + 1) * around + j
            faces += [(a, b, d), (a, d, c)]
    return points, np.array(faces), rings, around
