#!/usr/bin/env python3
"""Measure what needs no labels in takes: how deep hands stand in themselves by their skin, and how still in
depth they lie where they rest.

    python scripts/measure_takes.py TAKE [...]

Parts are the palm, the thumb's metacarpal with it, and the five fingers, each cut out of the mesh by its
skin weights and closed. A vertex is as deep in another part as its nearest skin is far. What has grown
together does not count: skin less than 30 mm apart along the flat hand's, and a finger's first bone and the
palm.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from handfit_core.errors import HandfitError
from handfit_core.hand_model import HandModel, load_model
from handfit_core.skeleton import JOINTS_BY_FINGER, NUM_JOINTS, PALM_KEYPOINTS, WRIST_KEYPOINT
from handfit_core.take import HandTrack, Take

PALM: Final = 5
"""The part after the five fingers"""
GROWN: Final = 0.030
"""metres along the skin"""
RESTS: Final = 0.01
"""hand sizes a frame that the palm moves at most in the picture, over seven frames, where a hand rests"""
_AT_ONCE: Final = 256
"""points against a part's triangles"""


def main(argv: Sequence[str] | None = None) -> int:
    """Print a line per hand; returns the exit code."""
    parser = argparse.ArgumentParser(prog="measure_takes.py", description="What takes are worth, unlabelled.")
    parser.add_argument("takes", nargs="+", type=Path, metavar="TAKE")
    args = parser.parse_args(argv)
    try:
        for path in args.takes:
            take = Take.load(path)
            for hand in take.hands:
                said = told(hand, load_model(take.model, hand.side))
                print(f"{path}, {hand.side} hand: {said}", flush=True)
    except HandfitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def told(hand: HandTrack, model: HandModel) -> str:
    """What a line says of one hand."""
    rows = np.flatnonzero(hand.present)
    if not len(rows):
        return "in no frame"
    zero = np.zeros((1, 3))
    skin = Skin(model)
    poses = (model.posed(hand.betas, zero, hand.hand_pose[[row]], zero).vertices[0] for row in rows)
    depths = 1000.0 * np.array([skin.depth(vertices) for vertices in poses])
    said = (
        f"{len(rows)} frames, {(depths > 2.0).mean():.3f} of them more than 2 mm in itself, "
        f"{(depths > 4.0).mean():.3f} more than 4 mm, 95th percentile {np.percentile(depths, 95):.1f} mm"
    )
    steps = 1000.0 * depth_steps_at_rest(hand)
    if len(steps):
        said += f"; {len(steps)} steps in depth at rest, 95th percentile {np.percentile(steps, 95):.1f} mm"
    return said


def depth_steps_at_rest(hand: HandTrack) -> np.ndarray:
    """(N,) metres that the wrist's distance changes from frame to frame, where the palm rests in the
    picture."""
    size = np.nanmedian(np.ptp(hand.keypoints_2d, axis=1).max(axis=1))
    moved = np.diff(hand.keypoints_2d[:, list(PALM_KEYPOINTS)], axis=0) / size
    energy = np.square(moved).sum(axis=-1).mean(axis=-1)
    speed = [np.sqrt(energy[max(0, t - 3) : t + 4].mean()) for t in range(len(energy))]
    steps = np.abs(np.diff(hand.joints_3d[:, WRIST_KEYPOINT, 2]))
    return steps[np.array(speed, dtype=float) < RESTS]


class Skin:
    """One model's mesh in parts."""

    def __init__(self, model: HandModel) -> None:
        owner, faces = model.weights.argmax(axis=1), model.faces
        part_of_joint, first = np.full(NUM_JOINTS, PALM), np.zeros(NUM_JOINTS, dtype=bool)
        for finger, joints in enumerate(JOINTS_BY_FINGER):
            outer = joints[1:] if finger == 0 else joints
            part_of_joint[outer] = finger
            first[joints[0]] = finger > 0
        self._part, self._first = part_of_joint[owner], first[owner]
        # A face is where most of its corners are; where all three differ, anywhere.
        of_face = np.median(self._part[faces], axis=1).astype(int)
        self._faces = [faces[of_face == part] for part in range(PALM + 1)]
        self._rims = [rims(part) for part in self._faces]
        edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)), axis=0)
        lengths = np.linalg.norm(np.diff(model.v_template[edges], axis=1)[:, 0], axis=-1)
        graph = coo_array((lengths, (edges[:, 0], edges[:, 1])), shape=(len(owner),) * 2)
        self._way = dijkstra(graph.tocsr(), directed=False)

    def depth(self, vertices: np.ndarray) -> float:
        """Metres that the deepest of (V, 3) vertices in metres stands in a part that is not its own."""
        return max(self._depth_in(part, vertices) for part in range(PALM + 1))

    def _depth_in(self, part: int, vertices: np.ndarray) -> float:
        skin = vertices[self._faces[part]]
        corners = skin.reshape(-1, 3)
        other = (self._part != part) & ~((part == PALM) & self._first)
        boxed = ((vertices > corners.min(axis=0)) & (vertices < corners.max(axis=0))).all(axis=1)
        found = np.flatnonzero(other & boxed)
        closed = np.concatenate([skin, *(lid(vertices[rim]) for rim in self._rims[part])])
        found = found[winding_numbers(vertices[found], closed) > 0.5]
        if not len(found):
            return 0.0
        distances, nearest = distances_to(vertices[found], skin)
        there = self._faces[part][nearest]
        grown = self._way[found[:, None], there].min(axis=1) < GROWN
        grown |= (self._part[found] == PALM) & self._first[there].all(axis=1)
        return float(distances[~grown].max(initial=0.0))


def rims(faces: np.ndarray) -> list[np.ndarray]:
    """The loops of vertices that an open mesh of (F, 3) faces ends at, turning as a face that closes it."""
    edges = set(map(tuple, faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).tolist()))
    onwards: dict[int, list[int]] = {}
    for start, end in sorted(edges):
        if (end, start) not in edges:
            onwards.setdefault(end, []).append(start)
    loops = []
    while onwards:
        loop = [next(iter(onwards))]
        while not (len(loop) > 1 and loop[-1] == loop[0]):
            here = onwards[loop[-1]]
            loop.append(here.pop())
            if not here:
                del onwards[loop[-2]]
        loops.append(np.array(loop[:-1]))
    return loops


def lid(rim: np.ndarray) -> np.ndarray:
    """(N, 3, 3) triangles from a rim's points (N, 3) to their middle."""
    return np.stack([rim, np.roll(rim, -1, axis=0), np.broadcast_to(rim.mean(axis=0), rim.shape)], axis=1)


def winding_numbers(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(N,) how often a closed mesh of (M, 3, 3) triangles, counter-clockwise from outside, surrounds points
    (N, 3), by solid angles (van Oosterom and Strackee 1983)."""
    found = np.empty(len(points))
    for first in range(0, len(points), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        a, b, c = np.moveaxis(triangles[None] - points[part, None, None], 2, 0)
        la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
        ab, bc, ca = ((v * w).sum(axis=-1) for v, w in ((a, b), (b, c), (c, a)))
        volume = (a * np.cross(b, c)).sum(axis=-1)
        found[part] = np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb).sum(axis=1)
    return found / (2.0 * np.pi)


def distances_to(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N,) distances of points (N, 3) to the nearest of (M, 3, 3) triangles, and which one that is."""
    p, corners = points[:, None], np.moveaxis(triangles, 1, 0)
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    square = np.maximum((normal**2).sum(axis=-1), 1e-24)
    above = ((p - corners[0]) * normal).sum(axis=-1) / square
    foot = p - above[..., None] * normal
    inside = np.ones(above.shape, dtype=bool)
    least = np.full(above.shape, np.inf)
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        edge = end - start
        inside &= (np.cross(edge, foot - start) * normal).sum(axis=-1) >= 0.0
        along = ((p - start) * edge).sum(axis=-1) / np.maximum((edge**2).sum(axis=-1), 1e-24)
        off = p - (start + np.clip(along, 0.0, 1.0)[..., None] * edge)
        least = np.minimum(least, (off**2).sum(axis=-1))
    least = np.where(inside, above**2 * square, least)
    nearest = least.argmin(axis=1)
    return np.sqrt(least[np.arange(len(points)), nearest]), nearest


if __name__ == "__main__":
    sys.exit(main())
