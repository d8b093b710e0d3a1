"""Rotation conversions in NumPy. Axis-angle in radians, quaternions as (w, x, y, z).

The differentiable layer in torch has a `rotvec_to_rotmat` of its own, checked against this one.
"""

from __future__ import annotations

import numpy as np


def rotvec_to_rotmat(rotvec: np.ndarray) -> np.ndarray:
    """Convert axis-angle (..., 3) in radians to rotation matrices (..., 3, 3), by Rodrigues' formula; exact
    at zero."""
    rotvec = np.asarray(rotvec, dtype=np.float64)
    angle = np.sqrt(np.square(rotvec).sum(axis=-1, keepdims=True))
    # For much larger angles than this one, sin(t) / t is exactly 1 already.
    safe = np.maximum(angle, 1e-150)
    half = np.sin(0.5 * safe) / safe
    outer = (rotvec * (2.0 * half * half))[..., None] * rotvec[..., None, :]
    return outer + skew(np.sin(safe) / safe * rotvec) + np.cos(angle)[..., None] * np.eye(3)


def euler_to_rotmat(angles: np.ndarray) -> np.ndarray:
    """Convert intrinsic Euler angles XYZ (..., 3) in radians to rotation matrices (..., 3, 3): Rx Ry Rz."""
    sines, cosines = np.sin(angles), np.cos(angles)
    (sx, sy, sz), (cx, cy, cz) = np.moveaxis(sines, -1, 0), np.moveaxis(cosines, -1, 0)
    rotmat = np.empty((*np.shape(angles), 3))
    rotmat[..., 0, 0], rotmat[..., 0, 1], rotmat[..., 0, 2] = cy * cz, -cy * sz, sy
    along, across = sy * cz, sy * sz
    rotmat[..., 1, 0], rotmat[..., 1, 1], rotmat[..., 1, 2] = (
        cx * sz + sx * along,
        cx * cz - sx * across,
        -sx * cy,
    )
    rotmat[..., 2, 0], rotmat[..., 2, 1], rotmat[..., 2, 2] = (
        sx * sz - cx * along,
        sx * cz + cx * across,
        cx * cy,
    )
    return rotmat


def rotmat_to_euler(rotmat: np.ndarray) -> np.ndarray:
    """Convert rotation matrices (..., 3, 3) to intrinsic Euler angles XYZ (..., 3) in radians, the second
    within 90 degrees of zero."""
    return np.stack(
        [
            np.arctan2(-rotmat[..., 1, 2], rotmat[..., 2, 2]),
            np.arcsin(np.clip(rotmat[..., 0, 2], -1.0, 1.0)),
            np.arctan2(-rotmat[..., 0, 1], rotmat[..., 0, 0]),
        ],
        axis=-1,
    )


def turn_from_axis(rays: np.ndarray) -> np.ndarray:
    """Return the smallest rotations (..., 3, 3) that lead from +z to unit vectors (..., 3)."""
    across = skew(np.stack([-rays[..., 1], rays[..., 0], np.zeros_like(rays[..., 0])], axis=-1))  # z x ray
    return np.eye(3) + across + across @ across / (1.0 + rays[..., 2])[..., None, None]


def skew(vector: np.ndarray) -> np.ndarray:
    """Return for vectors v (..., 3) the matrices (..., 3, 3) of their cross product: skew(v) @ u = v x u."""
    vector = np.asarray(vector, dtype=np.float64)
    matrix = np.zeros((*vector.shape, 3))
    matrix[..., 2, 1], matrix[..., 0, 2], matrix[..., 1, 0] = np.moveaxis(vector, -1, 0)
    matrix[..., 1, 2], matrix[..., 2, 0], matrix[..., 0, 1] = np.moveaxis(-vector, -1, 0)
    return matrix


def rotmat_to_quat(rotmat: np.ndarray) -> np.ndarray:
    """Convert rotation matrices (..., 3, 3) to unit quaternions (..., 4) as (w, x, y, z) with w >= 0.

    Takes the largest of the four candidate components first (Shepperd's method), so that no rotation is near
    a singular division.
    """
    m = np.asarray(rotmat, dtype=np.float64)
    trace = np.trace(m, axis1=-2, axis2=-1)[..., None, None]
    # Four times the outer product of the quaternion with itself; each row is the quaternion scaled.
    rows = np.empty((*m.shape[:-2], 4, 4))
    rows[..., :1, :1] = 1.0 + trace
    rows[..., 0, 1:] = rows[..., 1:, 0] = np.stack(
        [m[..., i, j] - m[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=-1
    )
    rows[..., 1:, 1:] = m + np.swapaxes(m, -1, -2) + (1.0 - trace) * np.eye(3)
    best = np.argmax(np.diagonal(rows, axis1=-2, axis2=-1), axis=-1)
    quat = np.take_along_axis(rows, best[..., None, None], axis=-2)[..., 0, :]
    quat = quat / np.linalg.norm(quat, axis=-1, keepdims=True)
    return np.where(quat[..., :1] < 0, -quat, quat)


def quat_to_rotmat(quat: np.ndarray) -> np.ndarray:
    """Convert quaternions (..., 4) as (w, x, y, z), which are normalised here, to rotation matrices
    (..., 3, 3)."""
    quat = np.asarray(quat, dtype=np.float64)
    quat = quat / np.linalg.norm(quat, axis=-1, keepdims=True)
    across = skew(quat[..., 1:])
    return np.eye(3) + 2.0 * (quat[..., :1, None] * across + across @ across)


def rotmat_to_rotvec(rotmat: np.ndarray) -> np.ndarray:
    """Convert rotation matrices (..., 3, 3) to axis-angle (..., 3) in radians, with an angle of at most
    pi."""
    return quat_to_rotvec(rotmat_to_quat(rotmat))


def quat_multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Multiply quaternions (..., 4) as (w, x, y, z): the Hamilton product a b, which turns by b first."""
    aw, av = a[..., :1], a[..., 1:]
    bw, bv = b[..., :1], b[..., 1:]
    scalar = aw * bw - np.sum(av * bv, axis=-1, keepdims=True)
    return np.concatenate([scalar, aw * bv + bw * av + np.cross(av, bv)], axis=-1)


def rotvec_to_quat(rotvec: np.ndarray) -> np.ndarray:
    """Convert axis-angle (..., 3) in radians to unit quaternions (..., 4) as (w, x, y, z); exact at zero."""
    half = np.linalg.norm(rotvec, axis=-1, keepdims=True) / 2.0
    # sin(x) / x, which numpy defines as sinc(x / pi)
    return np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * rotvec], axis=-1)


def channels_to_quat(values: np.ndarray, mode: str) -> np.ndarray:
    """Convert rotations (N, 3 or 4), as Blender's channels have them, to unit quaternions (N, 4) as
    (w, x, y, z).

    `mode` is Blender's: QUATERNION of any length (zero: no rotation), AXIS_ANGLE as (angle, x, y, z), or the
    order of Euler angles in radians, such as XYZ, whose first turn is about X.
    """
    if mode in ("QUATERNION", "AXIS_ANGLE"):
        vector = values if mode == "QUATERNION" else values[:, 1:]
        length = np.linalg.norm(vector, axis=-1, keepdims=True)
        nothing = np.eye(1, vector.shape[1])
        unit = np.where(length > 1e-9, vector / np.maximum(length, 1e-9), nothing)
        return unit if mode == "QUATERNION" else rotvec_to_quat(unit * values[:, :1])
    whole = np.eye(1, 4)
    for axis in mode:
        i = "XYZ".index(axis)
        whole = quat_multiply(rotvec_to_quat(values[:, i, None] * np.eye(3)[i]), whole)
    return whole


def quat_to_rotvec(quat: np.ndarray) -> np.ndarray:
    """Convert unit quaternions (..., 4) as (w, x, y, z) to axis-angle (..., 3) in radians, with an angle of
    at most pi."""
    quat = np.where(quat[..., :1] < 0.0, -quat, quat)
    sine = np.linalg.norm(quat[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, quat[..., :1])
    scale = np.where(sine < 1e-12, 2.0, angle / np.where(sine < 1e-12, 1.0, sine))
    return quat[..., 1:] * scale


def unflip_quats(quats: np.ndarray) -> np.ndarray:
    """Give consecutive quaternions of (T, ..., 4) the nearer sign, so that curves do not jump.

    q and -q are the same rotation, but keys of both signs interpolate through nonsense.
    """
    quats = np.array(quats, dtype=np.float64)
    flips = np.sum(quats[1:] * quats[:-1], axis=-1) < 0
    sign = np.where(np.cumsum(flips, axis=0) % 2 == 1, -1.0, 1.0)
    quats[1:] *= sign[..., None]
    return quats


def swings(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the smallest rotations (N, 3, 3) that take unit vectors `start`, (3,) or (N, 3), to unit vectors
    `end` (N, 3)."""
    start = np.broadcast_to(start, end.shape)
    across, cosine = np.cross(start, end), np.sum(start * end, axis=-1)
    turn = skew(across)
    found = np.eye(3) + turn + turn @ turn / np.maximum(1.0 + cosine, 1e-9)[:, None, None]
    opposite = cosine < -1.0 + 1e-9
    if opposite.any():
        aside = units(np.cross(start, np.eye(3)[np.argmin(np.abs(start), axis=-1)]))
        found[opposite] = (2.0 * aside[:, :, None] * aside[:, None] - np.eye(3))[opposite]
    return found


def perpendicular(vectors: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Return vectors (..., 3) without their part along unit vectors (..., 3), so that they stand
    perpendicular to these."""
    return vectors - np.sum(vectors * along, axis=-1, keepdims=True) * along


def units(vectors: np.ndarray) -> np.ndarray:
    """Scale vectors (..., 3) to length 1; zeros stay zeros."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def smoothstep(share: np.ndarray) -> np.ndarray:
    """Rise smoothly from 0, where a share is 0 or less, to 1, where it is 1 or more."""
    share = np.clip(share, 0.0, 1.0)
    return share * share * (3.0 - 2.0 * share)
