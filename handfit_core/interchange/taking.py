"""The material of a take out of a recording: detections that are fitted, or hands that are posed already."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from handfit_core.common.batch import slices
from handfit_core.common.skeleton import KEYPOINT_PARENTS, NUM_KEYPOINTS, SIDES, Side
from handfit_core.detect.detector import Detected
from handfit_core.detect.keypoints import Detections, Track
from handfit_core.fit.observation import lines_of_sight
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.chain import Chain
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.landmarks import NO_OFFSETS, detector_landmarks
from handfit_core.hand_model.motion import HandMotion
from handfit_core.interchange.lift import lifted
from handfit_core.interchange.recording import LEAST_POINTS, VIRTUAL_DISTANCE, PointsHand, Recording, known


def detected_in(recording: Recording) -> Detected:
    """Return the hands of a recording's pictures, as if a detector had found them; those with too few points
    are left out."""
    assert recording.seen is not None
    hands = recording.seen.select(known(recording.seen.keypoints).sum(axis=1) >= LEAST_POINTS)
    found = Detections.collect(len(hands), (lifted(hands.select(part)) for part in slices(len(hands))))
    return Detected([int(number) for number in recording.frame_numbers], found)


def tracks_of(recording: Recording, intrinsics: Intrinsics) -> list[Track]:
    """Return each hand of points in space as if it had been seen by that camera, before which it must lie
    (`before_camera`)."""
    return [_track_of(hand, intrinsics, recording.fps) for hand in recording.points]


def _track_of(hand: PointsHand, intrinsics: Intrinsics, fps: float) -> Track:
    found = np.flatnonzero(hand.present)
    points = hand.points[found]
    sigma = _sigma_of(points) if hand.sigma is None else hand.sigma
    seen = _seen_point_by_point(hand.side, found, points, sigma, intrinsics)
    landmarks = hand.landmarks or (NO_OFFSETS if hand.on_joints else None)
    return Track(hand.side, seen, len(hand.points), fps, landmarks=landmarks, calibrated=False)


def _sigma_of(points: np.ndarray) -> float:
    """Return how many metres points (T, 21, 3) err by, told by how much the lengths of a hand's bones change,
    which they truly do not."""
    lengths = np.linalg.norm(points[:, 1:] - points[:, KEYPOINT_PARENTS[1:]], axis=-1)
    lengths = lengths[:, np.isfinite(lengths).any(axis=0)]
    change = np.abs(lengths - np.nanmedian(lengths, axis=0))
    change = change[np.isfinite(change)]
    if len(points) < 10 or not len(change):
        # Metres that points are expected to be off where too few frames tell
        return 0.002
    # Of a normal distribution's deviations half are less than 0.6745; two ends of a bone err.
    # Metres: the least and the most that they are told to be
    return float(np.clip(np.median(change) / 0.6745 / np.sqrt(2.0), 0.0005, 0.02))


def _seen_point_by_point(
    side: Side, frame: np.ndarray, points: np.ndarray, sigma: float, intrinsics: Intrinsics
) -> Detections:
    """Return points (N, 21, 3) in metres, in the frames `frame` (N,), as a detector would tell of them;
    `sigma` is their expected error in metres."""
    sure, index = known(points), np.full(len(points), SIDES.index(side))
    middle = np.where(sure[..., None], points, 0.0).sum(axis=1) / sure.sum(axis=1)[:, None]
    filled = np.where(sure[..., None], points, middle[:, None])
    pixels = intrinsics.project(filled)
    along = (filled @ lines_of_sight(pixels, intrinsics)[..., None])[..., 0]
    distance = along.mean(axis=1)
    scale = (0.5 * (intrinsics.fx + intrinsics.fy) / distance)[:, None]
    depth = scale * (filled[..., 2] - filled[:, :1, 2])
    # Pixels: what is known of a point that is missing
    expected = np.where(sure, scale * sigma, 1e4)[..., None]
    off = (scale * (along - distance[:, None]))[..., None]
    return Detections(
        frame,
        index,
        sure.mean(axis=1),
        np.concatenate([pixels, depth[..., None]], axis=2),
        filled - filled.mean(axis=1, keepdims=True),
        overlapped=None if sure.all() else ~sure,
        given_side=index,
        distance=distance,
        corrected_side=index,
        corrected=np.concatenate([pixels, expected, expected, off, expected], axis=2),
    )


def only_present(recording: Recording) -> Recording:
    """Return the recording without hands that are in none of its frames."""
    seen = recording.seen
    if seen is not None:
        seen = seen.select(known(seen.keypoints).sum(axis=1) >= LEAST_POINTS)
    points, posed = (
        tuple(h for h in hands if h.present.any()) for hands in (recording.points, recording.posed)
    )
    return replace(recording, seen=seen, points=points, posed=posed)


def before_camera(recording: Recording, *, placed: bool) -> Recording:
    """Return the recording with its hands before a camera. Hands without a place get one. Others stay where
    they are if they are `placed`, that is, lie beside pictures or as a camera that is known has them, and not
    behind it; else they are brought into a virtual camera's view, all by the same shift, which `assumed`
    tells."""
    posed = [hand.posed_at(hand.present) for hand in recording.posed]
    places = [hand.transl[hand.present] for hand in posed]
    places += [np.nanmean(hand.points[hand.present], axis=1) for hand in recording.points]
    offset = _before_camera(np.concatenate(places), placed) if places else np.zeros(3)
    if not offset.any():
        return replace(recording, posed=tuple(posed))
    way = ", ".join(f"{metres:.2f}" for metres in offset)
    why = "behind the camera" if placed else "outside the view of a virtual camera"
    return replace(
        recording,
        posed=tuple(replace(hand, transl=hand.transl + offset) for hand in posed),
        points=tuple(replace(hand, points=hand.points + offset) for hand in recording.points),
        assumed=(*recording.assumed, f"its hands lie {why}: all are moved before it, by {way} m"),
    )


def _before_camera(places: np.ndarray, placed: bool) -> np.ndarray:
    """Return the shift (3,) in metres that brings hands at places (N, 3) into a camera's view; zeros where
    they stay."""
    low, high = places.min(axis=0), places.max(axis=0)
    in_view = low[2] >= 0.25 and np.abs([low[:2], high[:2]]).max() < 0.4 * low[2]
    if in_view or (placed and np.median(places[:, 2]) > 0.0):
        return np.zeros(3)
    middle, reach = (low + high) / 2.0, (high - low).max() / 2.0
    return np.array([0.0, 0.0, VIRTUAL_DISTANCE + 2.0 * reach]) - middle


def seen_of(
    model: HandModel,
    motion: HandMotion,
    intrinsics: Intrinsics,
    fps: float,
    score: np.ndarray | None = None,
) -> Track:
    """Return what a detector that errs nowhere would see of a hand: with it a take's hand can be fitted
    again. `score` (T,): how sure each frame is, 0..1; None where all are certain."""
    rows = np.flatnonzero(motion.present)
    points = np.empty((len(rows), NUM_KEYPOINTS, 3))
    if len(rows):
        chain = Chain(model, detector_landmarks())
        orient, pose, transl = (each[rows] for each in motion.pose)
        betas = np.tile(motion.betas, (len(rows), 1))
        points = chain.points(chain.state(betas, orient, pose, transl, transl[:, 2]))
    seen = _seen_point_by_point(motion.side, rows, points, 0.001, intrinsics)
    if score is not None:
        seen = replace(seen, score=np.nan_to_num(score[rows], nan=0.5).clip(0.0, 1.0))
    return Track(motion.side, seen, len(motion.transl), fps, calibrated=False)
