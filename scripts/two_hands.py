#!/usr/bin/env python3
"""Two hands of one person that meet in many ways: how well captures tell them apart.

    python scripts/two_hands.py [--clips 5] [--detector direct] [--fps 25] [--away 0.6]

Clips are painted, so that the truth is known; the same numbers paint the same clips. For each kind:

* near, apart: shares of hands that have a pose, in frames in which points of one hand lie on the other, and
  in other frames; PA-MPJPE in mm; mean distance of their keypoints from the truth in the picture, in percent
  of the hand's size;
* switched: how often a track goes on with the other hand; sides: frames of tracks of the wrong side;
* astray: poses that are nearer to no hand than 0.4 of its size;
* own: share of the hands, in all frames, that are in a track of their side.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from handfit_core import capture
from handfit_core.detect.keypoints import Detections, HandDetection
from handfit_core.detect.matching import covers
from handfit_core.errors import NoHandFoundError
from handfit_core.evaluate.metrics import similarity_aligned_distances
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.skeleton import SIDES, Side
from handfit_core.take import HandTrack
from scripts.benchmark.arm import build_arm, forearm_direction
from scripts.benchmark.kinematics import RightHand, hand_pose_from_angles, model_of, within_limits
from scripts.benchmark.people import random_betas
from scripts.benchmark.poses import random_pose
from scripts.benchmark.shots import FPS, Shot, ShotHand
from scripts.training.painter import paint

SIZE: Final = 512
"""pixels a side"""
FRAMES: Final = 75
PERIOD: Final = 50
"""Frames from one crossing to the second next"""
AWAY: Final = 0.6
"""metres from the camera to the middle between the hands"""

INWARDS: Final = {"right": np.array([1.0, 0.0, 0.0]), "left": np.array([-1.0, 0.0, 0.0])}
"""Of a person who faces the camera; x to the picture's right, y down, z away"""

ASTRAY: Final = 0.4
"""of a hand's size: what is farther off is not that hand"""

UP, AHEAD = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True, eq=False)
class Way:
    """How one hand moves, over T frames."""

    fingers: np.ndarray
    """(T, 3) where they point"""
    back: np.ndarray
    """(T, 3) where the hand's back looks"""
    palm: np.ndarray
    """(T, 3) metres, where its middle is"""
    pose: str = "relaxed"
    bend: np.ndarray | float = 0.0
    """(T,) radians that all knuckles are bent more"""


def _cross(side: Side, t: np.ndarray, rng: np.random.Generator) -> Way:
    """Each goes to the other's place, and back."""
    depth = 0.035 * (1 if side == "left" else -1)
    palm = -0.14 * np.cos(2 * np.pi * t / PERIOD)[:, None] * INWARDS[side] + [0.0, rng.normal(0, 0.01), depth]
    return Way(UP + rng.normal(0, 0.25, 3), rng.choice([-1, 1]) * AHEAD, palm)


def _pass(side: Side, t: np.ndarray, rng: np.random.Generator) -> Way:
    """The right hand sweeps to and fro before the left one, which stays."""
    if side == "left":
        return Way(UP + rng.normal(0, 0.25, 3), rng.choice([-1, 1]) * AHEAD, np.zeros((len(t), 3)))
    palm = -0.17 * np.cos(2 * np.pi * t / PERIOD)[:, None] * INWARDS[side] + 0.07 * AHEAD
    return Way(UP + rng.normal(0, 0.35, 3), rng.choice([-1, 1]) * AHEAD, palm, "open")


def _clap(side: Side, t: np.ndarray, rng: np.random.Generator) -> Way:
    open_by = np.abs(np.cos(2 * np.pi * t / PERIOD))
    return Way(
        UP + 0.5 * AHEAD + rng.normal(0, 0.1, 3),
        -INWARDS[side],
        -(0.018 + 0.11 * open_by)[:, None] * INWARDS[side],
        "open",
    )


def _wring(side: Side, t: np.ndarray, rng: np.random.Generator) -> Way:
    apart = np.clip(np.cos(2 * np.pi * t / len(t)), 0, 1)
    rub = 0.025 * np.sin(2 * np.pi * t / 20) * (1 if side == "left" else -1)
    across = (0.9 if side == "left" else -0.5) * AHEAD
    return Way(
        UP + across + rng.normal(0, 0.1, 3),
        -INWARDS[side],
        -(0.02 + 0.11 * apart)[:, None] * INWARDS[side] + rub[:, None] * UP,
        bend=0.6 * (1 - apart),
    )


def _interlock(side: Side, t: np.ndarray, rng: np.random.Generator) -> Way:
    """Fingers between fingers."""
    apart = np.clip(1.3 * np.cos(2 * np.pi * t / len(t)) + 0.2, 0, 1)
    palm = -(0.055 + 0.09 * apart)[:, None] * INWARDS[side] + (0.009 if side == "left" else 0.0) * UP
    return Way(INWARDS[side] + 0.35 * UP, AHEAD + rng.normal(0, 0.1, 3), palm, "open", 0.7 * (1 - apart))


def _hide(side: Side, t: np.ndarray, rng: np.random.Generator) -> Way:
    """The left hand goes behind the right one, waits there, and comes out where it went in or beyond."""
    through = rng.random() < 0.5
    if side == "right":
        palm = np.tile(0.08 * AHEAD, (len(t), 1))
    else:
        phase = (t % (2 * PERIOD)) / (2 * PERIOD)
        out = np.clip(np.stack([1 - 4 * phase, 4 * phase - 3]), 0.0, 1.0)
        palm = 0.2 * (out[0] + (-1 if through else 1) * out[1])[:, None] * INWARDS["right"] - 0.03 * AHEAD
    return Way(UP + rng.normal(0, 0.25, 3), rng.choice([-1, 1]) * AHEAD, palm)


def _leave(side: Side, t: np.ndarray, rng: np.random.Generator) -> Way:
    """The right hand leaves the picture; the left one moves to where that was, and it comes back to where the
    left one was."""
    phase = 1 - np.abs(1 - t / (1.5 * PERIOD) % 2)
    if side == "left":
        x = 0.1 - 0.2 * np.clip(5 * phase - 2, 0, 1)
        palm = x[:, None] * INWARDS["right"]
    else:
        out = np.clip(4 * phase - 0.4, 0, 1) - np.clip(4 * phase - 2.8, 0, 1)
        x = np.where(phase < 0.5, -0.1, 0.1)
        palm = x[:, None] * INWARDS["right"] + 0.5 * out[:, None] * np.array([0.0, 1.0, 0.0])
    return Way(UP + rng.normal(0, 0.25, 3), rng.choice([-1, 1]) * AHEAD, palm)


def _roam(side: Side, t: np.ndarray, rng: np.random.Generator) -> Way:
    """Both move about widely, each on its own way, which often cross."""
    depth = 0.06 * (1 if side == "left" else -1)
    turns, phases = PERIOD * rng.uniform(0.6, 1.4, (3, 2)), rng.uniform(0, 2 * np.pi, (3, 2))
    waves = np.sin(2 * np.pi * t[:, None, None] / turns + phases).mean(axis=1)
    palm = np.column_stack([0.35 * waves, np.full(len(t), depth)]) - 0.06 * INWARDS[side]
    return Way(UP + rng.normal(0, 0.3, 3), rng.choice([-1, 1]) * AHEAD, palm)


KINDS: Final[dict[str, Callable[[Side, np.ndarray, np.random.Generator], Way]]] = {
    "cross": _cross,
    "pass": _pass,
    "clap": _clap,
    "wring": _wring,
    "interlock": _interlock,
    "hide": _hide,
    "leave": _leave,
    "roam": _roam,
}


def clip(
    kind: str, seed: int, frames: int = FRAMES, size: int = SIZE, fps: float = FPS, away: float = AWAY
) -> Shot:
    """Two hands over `frames` key frames, which are its pictures, so many metres from the camera."""
    rng = np.random.default_rng([seed, list(KINDS).index(kind)])
    betas = random_betas(rng)
    # From the front, or over the person's own shoulder; a little from the side.
    turn = np.pi * (rng.random() < 0.4) + rng.normal(0, 0.35)
    camera_turn = rotvec_to_rotmat(np.array([rng.normal(0, 0.2), 0.0, 0.0])) @ rotvec_to_rotmat(
        np.array([0.0, turn, 0.0])
    )
    t = np.arange(frames) * FPS / fps
    hands = []
    for side in SIDES:
        way = KINDS[kind](side, t, rng)
        fingers, back, palm = (
            np.broadcast_to(v, (frames, 3)) @ camera_turn.T for v in (way.fingers, way.back, way.palm)
        )
        hands.append(_hand(side, betas, replace(way, fingers=fingers, back=back, palm=palm), t, away, rng))
    return Shot(
        files=tuple(f"{kind}/{seed}/{n:04d}" for n in range(frames)),
        clip=None,
        size=size,
        camera=Intrinsics(1.1 * size, 1.1 * size, size / 2, size / 2),
        hands=tuple(hands),
        props=(),
        surroundings=np.tile(np.eye(4), (frames, 1, 1)),
        tags=({},) * frames,
        look_seed=(seed, 99),
    )


def _hand(
    side: Side, betas: np.ndarray, way: Way, t: np.ndarray, away: float, rng: np.random.Generator
) -> ShotHand:
    model = model_of(side)
    shaped = model.shaped(betas)
    along = way.fingers / np.linalg.norm(way.fingers, axis=1, keepdims=True)
    up = way.back - (way.back * along).sum(axis=1, keepdims=True) * along
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    # The model's fingers point to -x (right) or x (left), its back to y.
    x = along if side == "left" else -along
    trembling = rotvec_to_rotmat(0.04 * np.sin(t[:, None] / 6.0 + rng.uniform(0, 6, 3)))
    rotation = trembling @ np.stack([x, up, np.cross(x, up)], axis=-1)
    angles = np.repeat(random_pose(way.pose, RightHand(betas), rng)[None], len(x), axis=0)
    angles[:, [0, 3, 6, 9], 2] += np.broadcast_to(way.bend, len(x))[:, None]
    angles[:, :, 2] += 0.08 * np.sin(t[:, None] / 8.0 + rng.uniform(0, 6, 15))
    middle = (shaped.joints[4] - shaped.joints[0]) / 2.0
    centre = np.array([0.0, 0.0, away]) + way.palm
    flexion, deviation = np.clip(rng.normal(0, [0.3, 0.12]), -0.6, 0.6)
    direction = forearm_direction(flexion, deviation, side)
    sleeve = (rng.uniform(0.0, 0.1), rng.uniform(0.004, 0.012)) if rng.random() < 0.6 else None
    return ShotHand(
        side,
        betas,
        rotmat_to_rotvec(rotation),
        hand_pose_from_angles(within_limits(angles), side),
        centre - rotation @ middle - shaped.joints[0],
        build_arm(shaped, side, direction, sleeve),
    )


def pictures(shot: Shot) -> Iterator[np.ndarray]:
    """(size, size, 3) uint8 RGB, one after the other; light, colours and background stay."""
    for t in range(len(shot.files)):
        now = [
            replace(h, **{k: getattr(h, k)[t : t + 1] for k in ("global_orient", "hand_pose", "transl")})
            for h in shot.hands
        ]
        yield paint(replace(shot, hands=tuple(now)), np.random.default_rng(shot.look_seed))


def measured(shot: Shot, detector: str) -> Counter[str]:
    """Sums over the clip's frames."""
    points = np.array([hand.keypoints() for hand in shot.hands])  # (2, T, 21, 3)
    pixels = shot.camera.project(points)
    size = np.ptp(pixels, axis=2).max(axis=-1)
    with TemporaryDirectory() as folder:
        for t, rgb in enumerate(pictures(shot)):
            cv2.imwrite(f"{folder}/{t:04}.png", rgb[..., ::-1])
        try:
            tracks = capture(folder, intrinsics=shot.camera, detector=detector).hands
        except NoHandFoundError:
            tracks = ()
    sums: Counter[str] = Counter()
    near = np.array([_meet(*pixels[:, t]) for t in range(pixels.shape[1])])
    best = np.full((2, 2, len(near)), np.nan)  # 2D and 3D error of each hand
    for track in tracks:
        own = _whose(track, pixels, size)
        known = own[own >= 0]
        hand = int(np.bincount(known, minlength=2).argmax())
        sums["switched"] += int(np.count_nonzero(np.diff(known)))
        sums["own"] += int(np.count_nonzero(known == SIDES.index(track.side)))
        sums["sides"] += int(track.detected.sum()) * int(track.side != SIDES[hand])
        for t in np.flatnonzero(track.present):
            posed = track.joints_3d[t]
            off = np.linalg.norm(shot.camera.project(posed) - pixels[hand, t], axis=-1).mean() / size[hand, t]
            sums["astray"] += int(off >= ASTRAY)
            if off < ASTRAY and not best[0, hand, t] <= off:
                best[:, hand, t] = off, similarity_aligned_distances(posed, points[hand, t]).mean()
    for name, frames in (("near", near), ("apart", ~near)):
        there = np.isfinite(best[0]) & frames
        sums[f"{name} hands"] += 2 * int(frames.sum())
        sums[f"{name} posed"] += int(there.sum())
        sums[f"{name} 2D"] += 100.0 * best[0][there].sum()
        sums[f"{name} PA"] += 1000.0 * best[1][there].sum()
    return sums


def _meet(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether a keypoint (21, 2) of one of two hands lies on the other."""
    flat = np.zeros((21, 3))
    both = [HandDetection("left", 1.0, np.pad(p, ((0, 0), (0, 1))), flat) for p in (one, other)]
    hands = Detections.of([both])
    return any(covers(hands, np.array([1 - i]), hands.keypoints_2d[i]).any() for i in (0, 1))


def _whose(track: HandTrack, pixels: np.ndarray, size: np.ndarray) -> np.ndarray:
    """(T,) which hand each detection is of; -1: none."""
    off = np.linalg.norm(track.keypoints_2d - pixels, axis=-1).mean(axis=-1) / size  # (2, T)
    off = np.where(track.detected, off, np.inf)
    return np.where(off.min(axis=0) < ASTRAY, off.argmin(axis=0), -1)


def main(argv: list[str] | None = None) -> int:
    """Run the script; returns the exit code."""
    parser = argparse.ArgumentParser(prog="two_hands.py", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--clips", type=int, default=5, help="clips of each kind (default 5)")
    parser.add_argument("--detector", default="direct", help="as of a capture (default direct)")
    parser.add_argument("--fps", type=float, default=FPS, help="pictures a second (default 25)")
    parser.add_argument("--away", type=float, default=AWAY, help="metres to the hands (default 0.6)")
    parser.add_argument("--kinds", nargs="+", choices=tuple(KINDS), default=tuple(KINDS), help="default all")
    args = parser.parse_args(argv)
    print("| clips | near: posed | PA | 2D % | apart: posed | PA | 2D % | switched | sides | astray | own |")
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    whole: Counter[str] = Counter()
    for kind in args.kinds:
        sums: Counter[str] = Counter()
        for seed in range(args.clips):
            sums += measured(clip(kind, seed, fps=args.fps, away=args.away), args.detector)
        whole += sums
        print(_row(kind, sums), flush=True)
    print(_row("all", whole))
    return 0


def _row(name: str, sums: Counter[str]) -> str:
    cells = [name]
    for frames in ("near", "apart"):
        posed = sums[f"{frames} posed"]
        cells.append(f"{posed / sums[f'{frames} hands']:.3f}" if sums[f"{frames} hands"] else "-")
        cells += [f"{sums[f'{frames} {what}'] / posed:.2f}" if posed else "-" for what in ("PA", "2D")]
    cells += [str(sums[name]) for name in ("switched", "sides", "astray")]
    hands = sums["near hands"] + sums["apart hands"]
    return "| " + " | ".join([*cells, f"{sums['own'] / hands:.3f}"]) + " |"


if __name__ == "__main__":
    raise SystemExit(main())
