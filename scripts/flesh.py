"""Pose correctives that keep a hand's flesh, in MANO's form: an elastic hand is bent, its skin is regressed.

Linear blend skinning loses a twelfth of a fist's volume. Here the space between skin and bones is filled with
tetrahedra of a nearly incompressible rubber (stable Neo-Hookean: Smith, de Goes, Kim 2018), the bones are
turned by random poses of the whole hand, and the rubber is brought to rest; where a joint folds, neither side
passes the plane that halves the bend. How the skin then differs from skinning is regressed to products of
each joint's quaternion, which are linear in MANO's features R - I.

That leaves folds of single quads where the weights of several bones meet. `smooth_folds` takes them away:
the web and the thumb's base are smoothed as delta mush does (Mancewicz et al. 2014), bent knuckles are
rounded, both at the height that the skin around has, and the difference is regressed in the same way.

Millimetres, right hand, model frame.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from scipy.sparse import coo_matrix, diags
from scipy.sparse.linalg import splu
from scipy.spatial import Delaunay, KDTree

from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, JOINTS_BY_FINGER, NUM_JOINTS, PARENTS
from handfit_core.geometry.rotations import rotmat_to_quat, rotmat_to_rotvec
from handfit_core.hand_model.anatomy import anatomical_axes, joint_limits, rotmats_from_angles
from handfit_core.hand_model.axes import QUATERNION_PRODUCTS, REST_FROM_MODEL, bone_frames, posedirs_of
from handfit_core.hand_model.data import HandModel, forward_kinematics
from handfit_core.hand_model.forearm import with_wrist, wrist_ring
from scripts.benchmark.meshes import vertex_normals

POSES: Final = 60
SEED: Final = 20250612

BONE_RADIUS: Final = 0.42
"""of the distance from a bone's axis to the skin"""
HEAD_RADIUS: Final = 0.7
"""the same of the ball in which a bone ends"""
SPACING: Final = 5.0
"""of the points in the flesh"""
INCOMPRESSIBLE: Final = 80.0
"""Resistance to changes of volume over that to shear"""
CONTACT: Final = 5.0
"""Resistance to passing a joint's halving plane, per mm, over that to shear"""
FOLD_REACH: Final = 25.0
"""How far from a joint the halving plane holds"""
PARTS: Final = 4
"""in which a pose is approached, so that the rubber does not turn inside out"""
MOST_STEPS: Final = 40

REACH: Final = {"thumb": (46.0, 32.0, 20.0), "finger": (40.0, 26.0, 19.0)}
"""How far from each of a finger's joints it moves skin"""
TIP: Final = (0.3, 0.65)
"""Parts of the distal bone between which the correctives end: nail and pulp beyond are of one piece"""
RIDGE: Final = 2e-4
"""of the mean square of a product"""
SMOOTHING: Final = 5
"""Rounds of averaging that take the tetrahedra's grain off the skin"""
FOLD_POSES: Final = 150
MUSH: Final = 10
"""Rounds of averaging of the web and the thumb's base"""
ROUNDING: Final = 3
"""the same of the knuckles"""
HINGE: Final = ("w*x", "x*x")
KNUCKLE: Final = (*HINGE, "w*z", "z*z", "x*z")
"""The products of two joints: bones bend about X and spread about Z. The thumb's saddle uses all"""


def inside(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(N,) whether points (N, 3) lie in a closed mesh (F, 3, 3): winding numbers, van Oosterom 1983."""
    angle = np.empty(len(points))
    for first in range(0, len(points), 256):
        a, b, c = np.moveaxis(triangles - points[first : first + 256, None, None], 2, 0)
        la, lb, lc = (np.sqrt(np.einsum("nfk,nfk->nf", x, x)) for x in (a, b, c))
        above = np.einsum("nfk,nfk->nf", a, np.cross(b, c))
        below = la * lb * lc + np.einsum("nfk,nfk->nf", a, b) * lc
        below += np.einsum("nfk,nfk->nf", b, c) * la + np.einsum("nfk,nfk->nf", c, a) * lb
        angle[first : first + 256] = np.arctan2(above, below).sum(axis=1)
    return angle > np.pi


class ElasticHand:
    """A hand's flesh as tetrahedra between its skin and its bones."""

    def __init__(self, model: HandModel) -> None:
        shaped = model.shaped()
        self.skin, self.joints, tips = 1000.0 * shaped.vertices, 1000.0 * shaped.joints, 1000.0 * shaped.tips
        self.axes = anatomical_axes(model)
        closed = with_wrist(model, "cap")
        triangles = 1000.0 * closed.v_template[closed.faces]
        depth = KDTree(self.skin).query
        bones, owners = self._bones(tips, depth)

        low, high = self.skin.min(axis=0), self.skin.max(axis=0)
        grid = np.stack(np.meshgrid(*map(np.arange, low, high, [SPACING] * 3), indexing="ij"), axis=-1)
        grid = grid.reshape(-1, 3)
        # On a regular grid every cube could be cut in several ways.
        grid += np.random.default_rng(0).uniform(-0.3, 0.3, grid.shape)
        grid = grid[np.minimum(depth(grid)[0], KDTree(bones).query(grid)[0]) > 0.6 * SPACING]
        grid = grid[inside(grid, triangles)]
        self.nodes = np.concatenate([self.skin, bones, grid])
        self.tetrahedra, inverse, self.volumes = self._tetrahedra(triangles, len(self.skin), len(bones))
        # Row 3 T c + t takes the nodes to column c of the deformation gradient of tetrahedron t.
        slopes = np.concatenate([-inverse.sum(axis=2, keepdims=True), inverse], axis=2).swapaxes(0, 1)
        rows, columns = np.repeat(np.arange(3 * len(inverse)), 4), np.tile(self.tetrahedra, (3, 1)).ravel()
        shape = (3 * len(inverse), len(self.nodes))
        self.slopes = coo_matrix((slopes.ravel(), (rows, columns)), shape).tocsr()
        self.lumped = np.bincount(self.tetrahedra.ravel(), np.repeat(self.volumes / 4, 4), len(self.nodes))

        owner = np.full(len(self.nodes), -1)
        owner[len(self.skin) :][: len(bones)] = owners
        owner[: len(self.skin)][self.skin[:, 0] > self.joints[0, 0] + 6.0] = 0
        for chain, tip in zip(JOINTS_BY_FINGER, tips, strict=True):
            beyond = along_bone(self.skin, self.joints[chain[2]], tip)
            owner[: len(self.skin)][(beyond > TIP[1]) & (model.weights[:, chain[2]] > 0.9)] = chain[2]
        self.owner, self.free = owner, np.flatnonzero((owner < 0) & (self.lumped > 0))

        stiffness = (self.slopes.T @ diags(np.tile(self.volumes, 3)) @ self.slopes).tocsc()
        # Skin weights go on into the flesh as heat would, from skin and bones.
        self.weights = np.eye(NUM_JOINTS)[owner]
        self.weights[: len(self.skin)] = model.weights
        known, within = np.split(np.arange(len(self.nodes)), [-len(grid)])
        heat = -(stiffness[within][:, known] @ self.weights[known])
        self.weights[within] = splu(stiffness[within][:, within]).solve(heat)
        self.precondition = splu(stiffness[self.free][:, self.free] * (1.0 + INCOMPRESSIBLE / 2)).solve

    def _bones(self, tips: np.ndarray, depth) -> tuple[np.ndarray, list[int]]:
        """Points (B, 3) on the bones and their joints."""
        points, owners = [], []
        around = np.arange(6)[:, None] * np.pi / 3
        z = 1.0 - (2.0 * np.arange(24) + 1.0) / 24
        turn = np.arange(24) * np.pi * (3.0 - np.sqrt(5.0))
        ball = np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], axis=1)
        for finger, chain, tip in zip(FINGERS, JOINTS_BY_FINGER, tips, strict=True):
            ends = [*self.joints[chain], tip]
            bones = list(zip(chain, ends[:-1], ends[1:], strict=True))
            if finger != "thumb":
                bones.append((0, self.joints[0], ends[0]))
            for owner, start, end in bones:
                length = np.linalg.norm(end - start)
                along = (end - start) / length
                first = 12.0 if owner == 0 else HEAD_RADIUS * depth(start)[0] + 2.5
                last = 0.7 * length if owner == chain[2] else length - 2.0
                up = self.axes[max(owner, chain[0]) - 1][:, 1]
                side = np.cross(along, up)
                side /= np.linalg.norm(side)
                ring = np.cos(around) * side + np.sin(around) * np.cross(side, along)
                for place in np.linspace(first, last, max(2, int((last - first) / 3.5) + 1)):
                    centre = start + place * along
                    points += [centre[None], centre + BONE_RADIUS * depth(centre)[0] * ring]
                    owners += [owner] * 7
            for joint in chain:  # the back of the head; its palm's side is where the next bone goes
                back = ball[ball @ self.axes[joint - 1][:, 1] > 0]
                points.append(self.joints[joint] + HEAD_RADIUS * depth(self.joints[joint])[0] * back)
                owners += [PARENTS[joint]] * len(back)
        return np.concatenate(points), owners

    def _tetrahedra(self, triangles: np.ndarray, skin: int, bones: int):
        """(T, 4) nodes, (T, 3, 3) inverse edges and (T,) volumes of those that fill the flesh."""
        found = Delaunay(self.nodes).simplices
        corners = self.nodes[found]
        longest = np.linalg.norm(corners[:, :, None] - corners[:, None], axis=-1).max(axis=(1, 2))
        edges = corners[:, 1:] - corners[:, :1]
        volumes = np.linalg.det(edges) / 6.0
        of_bone = (found >= skin) & (found < skin + bones)
        kept = (np.abs(volumes) > 1e-3 * longest**3) & ~of_bone.all(axis=1)
        doubtful = kept & (((found < skin).sum(axis=1) >= 3) | (longest > 2 * SPACING))
        kept[doubtful] = inside(corners[doubtful].mean(axis=1), triangles)
        return found[kept], np.linalg.inv(edges[kept]), np.abs(volumes[kept])

    def bent(self, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The skin at rest under (15, 3) angles: (V, 3), and its offsets before skinning (V, 3)."""
        points, moved = self.nodes, np.zeros_like(self.nodes)
        for part in range(1, PARTS + 1):
            rotmats = np.concatenate([np.eye(3)[None], rotmats_from_angles(angles * part / PARTS, self.axes)])
            turned, places = forward_kinematics(rotmats, self.joints)
            offsets = places - np.einsum("jab,jb->ja", turned, self.joints)
            blend = np.einsum("nj,jab->nab", self.weights, turned)
            start = np.einsum("nab,nb->na", blend, self.nodes + moved) + self.weights @ offsets
            fixed = np.flatnonzero(self.owner >= 0)
            of = self.owner[fixed]
            start[fixed] = np.einsum("nab,nb->na", turned[of], self.nodes[fixed]) + offsets[of]
            points = self._at_rest(start, self._folds(turned, places))
            moved = np.linalg.solve(blend, (points - self.weights @ offsets)[..., None])[..., 0] - self.nodes
        return points[: len(self.skin)], moved[: len(self.skin)]

    def _folds(self, turned: np.ndarray, places: np.ndarray) -> list:
        """The halving plane of each bent joint: its nodes, its centre, normals towards the nodes' own
        sides, and the direction into which the joint bends."""
        folds = []
        for chain in JOINTS_BY_FINGER:
            for place, joint in enumerate(chain):
                if joint == FINGER_JOINTS["thumb"][0]:
                    continue  # a saddle deep in the palm folds nowhere
                forward = -self.axes[joint - 1][:, 0]
                before, after = turned[PARENTS[joint]] @ forward, turned[joint] @ forward
                inner = after - before
                if np.linalg.norm(inner) < 0.2:
                    continue
                own = self.weights[:, chain].sum(axis=1) + (self.weights[:, 0] if place == 0 else 0.0)
                arm = self.nodes - self.joints[joint]
                close = np.linalg.norm(arm, axis=1) < FOLD_REACH
                near = np.flatnonzero(close & (own > 0.6) & (self.owner < 0))
                normal = (before + after) / np.linalg.norm(before + after)
                folds.append((near, places[joint], np.sign(arm[near] @ forward)[:, None] * normal, inner))
        return folds

    def _energy(self, points: np.ndarray, folds: list) -> tuple[float, np.ndarray]:
        """Energy over the modulus of shear, and its gradient by the free nodes (N, 3)."""
        f = (self.slopes @ points).reshape(3, -1, 3)  # the columns of the deformation gradient
        cofactor = np.stack([np.cross(f[i - 2], f[i - 1]) for i in range(3)])
        grown = np.einsum("ti,ti->t", f[0], cofactor[0]) - 1.0
        sheared = 0.5 * (np.einsum("cti,cti->t", f, f) - 3.0)
        value = self.volumes @ (sheared - grown + 0.5 * INCOMPRESSIBLE * grown**2)
        cofactor *= (INCOMPRESSIBLE * grown - 1.0)[:, None]
        cofactor += f
        cofactor *= self.volumes[:, None]
        gradient = self.slopes.T @ cofactor.reshape(-1, 3)
        for near, centre, normals, inner in folds:
            arm = points[near] - centre
            deep = np.where(arm @ inner > 0, np.minimum(np.einsum("na,na->n", arm, normals), 0.0), 0.0)
            push = CONTACT * self.lumped[near] * deep
            value += 0.5 * push @ deep
            gradient[near] += push[:, None] * normals
        return float(value), gradient[self.free]

    def _at_rest(self, points: np.ndarray, folds: list) -> np.ndarray:
        """Minimise the energy by L-BFGS, preconditioned with the Laplacian."""
        value, gradient = self._energy(points, folds)
        history, values = [], [value]
        for _ in range(MOST_STEPS):
            step = gradient.copy()
            shares = []
            for s, y, scale in reversed(history):
                shares.append(scale * np.sum(s * step))
                step -= shares[-1] * y
            step = self.precondition(step)
            for (s, y, scale), share in zip(history, reversed(shares), strict=True):
                step += (share - scale * np.sum(y * step)) * s
            slope, length = np.sum(gradient * step), 1.0
            while length > 1e-3:
                trial = points.copy()
                trial[self.free] -= length * step
                found, steeper = self._energy(trial, folds)
                if found <= value - 1e-4 * length * slope:
                    break
                length *= 0.5
            else:
                if not history:
                    break
                history = []
                continue
            s, y = trial[self.free] - points[self.free], steeper - gradient
            if (along := np.sum(s * y)) > 1e-12:
                history = [*history[-7:], (s, y, 1.0 / along)]
            points, value, gradient = trial, found, steeper
            values.append(value)
            if len(values) > 6 and values[-6] - value < 1e-4 * abs(value):
                break
        return points


def neighbour_mean(quads: np.ndarray, count: int):
    """(V, V) sparse matrix that averages each vertex's neighbours along edges."""
    pairs = np.concatenate([quads[:, [i, (i + 1) % 4]] for i in range(4)])
    pairs = np.unique(np.sort(pairs, axis=1), axis=0)
    rows, columns = np.concatenate([pairs, pairs[:, ::-1]]).T
    adjacency = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(count, count)).tocsr()
    return diags(1.0 / np.asarray(adjacency.sum(axis=1)).ravel()) @ adjacency


def smoothed(field: np.ndarray, average, rounds: int) -> np.ndarray:
    """The field, averaged with its neighbours' `rounds` times."""
    for _ in range(rounds):
        field = 0.5 * field + 0.5 * (average @ field)
    return field


def along_bone(points: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """(N,) how far along a bone points lie, 0 at its start and 1 at its end."""
    return (points - start) @ (end - start) / np.sum((end - start) ** 2)


def smooth_step(values: np.ndarray) -> np.ndarray:
    """0 below 0, 1 above 1, smooth between."""
    values = np.clip(values, 0.0, 1.0)
    return values * values * (3.0 - 2.0 * values)


def reaches(model: HandModel, wider: float = 1.0) -> np.ndarray:
    """(V, 15) how far each joint may move each vertex, 0..1; `wider` multiplies the distances."""
    shaped = model.shaped()
    skin, joints = 1000.0 * shaped.vertices, 1000.0 * shaped.joints
    fingers = np.stack([model.weights[:, chain].sum(axis=1) for chain in JOINTS_BY_FINGER], axis=1)
    mask = np.zeros((len(skin), NUM_JOINTS - 1))
    for i, (finger, chain) in enumerate(zip(FINGERS, JOINTS_BY_FINGER, strict=True)):
        beyond = along_bone(skin, joints[chain[2]], 1000.0 * shaped.tips[i])
        on_tip = np.where(model.weights[:, chain[2]] > 0.5, (TIP[1] - beyond) / (TIP[1] - TIP[0]), 1.0)
        others = fingers.sum(axis=1) - fingers[:, i]
        for place, joint in enumerate(chain):
            reach = wider * REACH["thumb" if finger == "thumb" else "finger"][place]
            near = (reach - np.linalg.norm(skin - joints[joint], axis=1)) / (0.5 * reach)
            own = 1.0 - 2.0 * others if place == 0 else 2.0 * fingers[:, i]
            mask[:, joint - 1] = smooth_step(near) * smooth_step(own) * smooth_step(on_tip)
    return mask


def random_angles(rng: np.random.Generator) -> np.ndarray:
    """(15, 3) radians of a pose within the active ranges: every finger closes as far as it likes."""
    limits = joint_limits("right")
    angles = rng.uniform(limits.lower, limits.upper)
    for chain in JOINTS_BY_FINGER:
        rows = chain - 1
        closed = np.clip(rng.uniform(-0.1, 1.1) + rng.normal(0.0, 0.3, 3), 0.0, 1.0)
        low, high = limits.lower[rows, 2], limits.upper[rows, 2]
        angles[rows, 2] = low + closed * (high - low)
        if chain[0] != FINGER_JOINTS["thumb"][0]:
            angles[rows[0], 1] *= 1.0 - 0.8 * closed[0]
    return angles


def regressed(
    model: HandModel, angles: np.ndarray, offsets: np.ndarray, reach: np.ndarray, smoothing: int
) -> np.ndarray:
    """(15, 9, V, 3) metres, what `posedirs_of` takes, from poses (S, 15, 3) and their offsets (S, V, 3), of
    joints that move the skin by `reach` (V, 15)."""
    frames = bone_frames(model.shaped(), model.side)
    rotmats = REST_FROM_MODEL @ rotmats_from_angles(angles, anatomical_axes(model)) @ REST_FROM_MODEL.T
    quats = rotmat_to_quat(np.swapaxes(frames[1:], -1, -2) @ rotmats @ frames[1:])
    factors = dict(zip("wxyz", np.moveaxis(quats, -1, 0), strict=True))
    columns = []
    for chain in JOINTS_BY_FINGER:
        first = QUATERNION_PRODUCTS if chain[0] == FINGER_JOINTS["thumb"][0] else KNUCKLE
        for joint, products in zip(chain - 1, (first, HINGE, HINGE), strict=True):
            columns += [(joint, product) for product in products]
    values = np.stack([factors[p[0]][:, j] * factors[p[2]][:, j] for j, p in columns], axis=1)  # (S, P)
    mask = reach[:, [joint for joint, _ in columns]]  # (V, P)
    found = np.zeros((len(mask), NUM_JOINTS - 1, len(QUATERNION_PRODUCTS), 3))
    for v in range(len(mask)):
        used = np.flatnonzero(mask[v])
        known = values[:, used] * mask[v, used]
        square = known.T @ known + RIDGE * len(values) * np.eye(len(used))
        shares = np.linalg.solve(square, known.T @ offsets[:, v]) * mask[v, used, None]
        for column, share in zip(used, shares, strict=True):
            joint, product = columns[column]
            found[v, joint, QUATERNION_PRODUCTS.index(product)] = share
    average = neighbour_mean(model.polygons, len(mask))
    found = smoothed(found.reshape(len(mask), -1), average, smoothing).reshape(found.shape)
    found[model.tip_vertices] = 0.0
    return found.transpose(1, 2, 0, 3) @ REST_FROM_MODEL.T / 1000.0


def volumes(model: HandModel, vertices: np.ndarray) -> np.ndarray:
    """(S,) volumes between the skins (S, V, 3) and the wrist joint, about which all of them end alike."""
    a, b, c = np.moveaxis(vertices[:, model.faces] - model.shaped().joints[0], 2, 0)
    return np.einsum("sfk,sfk->s", a, np.cross(b, c)) / 6.0


def pose_correctives(model: HandModel) -> np.ndarray:
    """(V, 3, 135) posedirs in metres of a right hand that has none.

    A regression says less than what it was made from: it is enlarged until its hands have the mean volume of
    the elastic ones.
    """
    hand, rng = ElasticHand(model), np.random.default_rng(SEED)
    angles = np.stack([random_angles(rng) for _ in range(POSES)])
    skins, offsets = map(np.stack, zip(*map(hand.bent, angles), strict=True))
    found = regressed(model, angles, offsets, reaches(model), SMOOTHING)
    frames = bone_frames(model.shaped(), model.side)
    skinned, corrected = (
        volumes(model, bent_skins(each, angles) / 1000.0).mean()
        for each in (model, replace(model, posedirs=posedirs_of(found, frames)))
    )
    gain = (volumes(model, skins / 1000.0).mean() - skinned) / (corrected - skinned)
    print(f"regressed to {POSES} poses, enlarged by {gain:.2f}", flush=True)
    return posedirs_of(gain * found, frames)


def bent_skins(model: HandModel, angles: np.ndarray) -> np.ndarray:
    """(S, V, 3) the model's skin under angles (S, 15, 3)."""
    poses = rotmat_to_rotvec(rotmats_from_angles(angles, anatomical_axes(model))).reshape(-1, 45)
    still = np.zeros((len(poses), 3))
    return 1000.0 * model.posed(None, still, poses, still).vertices


def smooth_folds(model: HandModel) -> np.ndarray:
    """(V, 3, 135) posedirs in metres of a right hand: its own, and what smooths the web, the thumb's base and
    the bent knuckles."""
    rest, joints = 1000.0 * model.v_template, 1000.0 * model.shaped().joints
    average = neighbour_mean(model.polygons, len(rest))
    inner = np.ones((len(rest), 1))
    inner[wrist_ring(model.polygons)] = 0.0  # the edge stays

    def averaged(field: np.ndarray, rounds: int) -> np.ndarray:
        for _ in range(rounds):
            field = field + 0.5 * inner * (average @ field - field)
        return field

    thumb = model.weights[:, list(FINGER_JOINTS["thumb"])]
    meets = (thumb.sum(axis=1) > 0.03) & (thumb.sum(axis=1) < 0.97) & (thumb[:, 1:].max(axis=1) < 0.9)
    web = np.clip(1.3 * smoothed(meets.astype(float), average, 3), 0.0, 1.0)
    web *= np.clip(1.5 - 2.0 * thumb[:, 2], 0.0, 1.0)
    back = smooth_step((vertex_normals(rest, model.polygons)[:, 1] - 0.1) / 0.5) * (1.0 - web)
    first = [chain[0] for chain in JOINTS_BY_FINGER[1:]]
    distance = np.linalg.norm(rest[:, None] - joints[first], axis=2)  # (V, 4)
    knuckle = back * smooth_step((20.0 - distance.min(axis=1)) / 8.0)
    nearest = np.exp(-((distance / 8.0) ** 2)) + 1e-30
    nearest /= nearest.sum(axis=1, keepdims=True)

    rng = np.random.default_rng(SEED)
    angles = np.stack([random_angles(rng) for _ in range(FOLD_POSES)])
    skins, axes, detail = bent_skins(model, angles), anatomical_axes(model), rest - averaged(rest, MUSH)
    offsets = np.empty_like(skins)
    for angle, skin, offset in zip(angles, skins, offsets, strict=True):
        rotmats = np.concatenate([np.eye(3)[None], rotmats_from_angles(angle, axes)])
        blend = np.einsum("vj,jab->vab", model.weights, forward_kinematics(rotmats, joints)[0])
        left, _, right = np.linalg.svd(blend)
        mush = averaged(skin, MUSH) + np.einsum("vab,vb->va", left @ right, detail) - skin
        rounder = smoothed(skin, average, ROUNDING) - skin
        bent = nearest @ smooth_step(angle[[joint - 1 for joint in first], 2] / np.radians(75.0))
        moved = web[:, None] * mush + (knuckle * bent)[:, None] * rounder
        normals = vertex_normals(skin, model.polygons)
        # What is not a fold but the height of the skin around stays.
        moved -= smoothed(np.sum(moved * normals, axis=1), average, 10)[:, None] * normals
        offset[:] = np.linalg.solve(blend, moved[..., None])[..., 0]
    reach = reaches(model, 1.5)
    # The palm's capsules (`hand_model/surface.py`) are measured here, on a hand whose thumb is flat.
    reach[:, : FINGER_JOINTS["thumb"][0] - 1] *= 1.0 - measured_palm(model, average)[:, None]
    found = regressed(model, angles, offsets, reach, 0)
    return model.posedirs + posedirs_of(found, bone_frames(model.shaped(), model.side))


def measured_palm(model: HandModel, average) -> np.ndarray:
    """(V,) 1 where the palm's skin decides about its capsules, falling to 0 around."""
    bends = np.zeros((NUM_JOINTS - 1, 3))
    bends[: FINGER_JOINTS["thumb"][0] - 1, 2] = np.radians(np.tile((75.0, 90.0, 55.0), 4))
    joints = 1000.0 * model.shaped().joints
    skin = bent_skins(model, bends[None])[0] - joints[0]
    measured = np.zeros(len(skin), dtype=bool)
    for chain in JOINTS_BY_FINGER[1:]:
        knuckle = joints[chain[0]] - joints[0]
        across = np.cross(knuckle, [0.0, 1.0, 0.0])
        along = skin @ knuckle / (knuckle @ knuckle)
        near = np.abs(skin @ across) < 9.5 * np.linalg.norm(across)
        measured |= near & (along > 0.2) & (along < 1.0)
    measured &= model.weights.argmax(axis=1) == 0
    return np.clip(2.0 * smoothed(measured.astype(float), average, 1), 0.0, 1.0)
