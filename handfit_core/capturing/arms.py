"""The arms of a take's hands: bodies are found in its pictures, and arms fitted to both."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from handfit_core.capturing.options import CaptureOptions
from handfit_core.capturing.sources import Found
from handfit_core.common.batch import scatter
from handfit_core.common.errors import InputError
from handfit_core.common.skeleton import SIDES, Side
from handfit_core.detect.bodies import find_bodies
from handfit_core.detect.body import ELBOWS, SHOULDERS, WRISTS, BodyTrack
from handfit_core.detect.body_sides import with_body_sides
from handfit_core.fit.arms import ARMS, ArmsSeen, fit_arms
from handfit_core.fit.gaps import detect_cuts
from handfit_core.fit.solvers import ShouldStop
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.arm import ArmMotion
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.opening import open_media
from handfit_core.media.source import Media
from handfit_core.take import HandTrack, Take


@dataclass(frozen=True)
class GateSettings:
    """What a body must be like over a whole shot for a hand's arm to be fitted to it, since a raised forearm
    alone scores as a person, too."""

    max_distance: float = 0.5
    """Largest distance in the picture between the body's wrist and the hand's, in hand lengths"""
    min_score: float = 0.65
    """Least score of the body detector, 0..1, in the best quarter of the frames in which it was asked"""
    body_scale: float = 0.19
    """Length of a hand, in metres of a body's own coordinates"""
    min_scale: float = 0.5
    max_scale: float = 2.5
    """Largest ratio of the hand's length in the picture to the length that the body gives it"""
    min_visibility: float = 0.5
    """Least visibility, 0..1, of shoulder, elbow and wrist"""
    max_jump: float = 1.5
    """Hand lengths that shoulders may move from one frame to the next one with that body; beyond, there is a
    cut"""
    max_gap_seconds: float = 0.5
    max_end_seconds: float = 0.4
    """Most seconds from a frame with a body at which there is an arm: between two such frames, and before the
    first or after the last"""
    max_residual: float = 0.4
    """Largest median distance in the picture, in hand lengths, of fitted elbows and shoulders from the
    body's: beyond, body and hand do not belong together"""
    max_longer: float = 1.2
    """Largest ratio of an arm's lengths to those that its hand tells, since people differ"""
    errors: tuple[float, float] = (0.19, 0.35)
    """Median errors in radians of the directions of upper arms and forearms, against a truth of four
    cameras"""


GATES: Final = GateSettings()

NO_PICTURES: Final = "no arm: there are no pictures in which one could be found"
NO_BODY: Final = "no arm: no body is in the picture"
APART: Final = "no arm: no body's wrist is at this hand"
OTHER_SIDE: Final = "no arm: the body in the picture has its other hand here; is this hand's side right?"
NO_PERSON: Final = "no arm: what looks like a body may be none"
FOREARM_ONLY: Final = "no arm: only a forearm is in the picture"
HIDDEN: Final = (
    "no arm: the shoulder is not in the picture, or hidden",
    "no arm: the elbow is not in the picture, or hidden",
    "no arm: the wrist is not in the picture, or hidden",
)
NO_FIT: Final = "no arm: the body in the picture and the hand do not fit together"


def reopened(take: Take, max_megapixels: float | None = None) -> Media:
    """Open the pictures that the take was made from, in its frames. Raises InputError where they are gone,
    are others now, or where the take never had any."""
    source, numbers = take.source, take.frame_numbers
    if source.kind == "data":
        raise InputError(
            f"{source.name}: this take was made of another program's hands, without pictures in which arms "
            "could be found; capture the footage with --keypoints and --arms"
        )
    frames = None
    if source.kind == "video":
        step = int(numbers[1] - numbers[0]) if len(numbers) > 1 else 1
        frames = FrameRange(int(numbers[0]), int(numbers[-1]), step)
    given = source.files if source.kind == "sequence" else source.files[0]
    media = open_media(given, frames, max_megapixels=max_megapixels)
    if (media.width, media.height) != (take.width, take.height):
        raise InputError(
            f"{source.files[0]}: has {media.width}x{media.height} pixels, and the take was made of pictures "
            f"of {take.width}x{take.height}; put the former file back, or capture this one"
        )
    return media


def with_arms(take: Take, bodies: Sequence[BodyTrack]) -> Take:
    """Return the take with the arms that its hands have on these bodies; each hand gets one, or a sentence
    why there is none."""
    if take.source.kind == "data":
        return replace(take, hands=tuple(replace(hand, no_arm=NO_PICTURES) for hand in take.hands))
    step = np.median(np.diff(take.frame_numbers)) if len(take.frame_numbers) > 1 else 1.0
    return replace(take, hands=arms_of(take.hands, bodies, take.intrinsics, take.fps / float(step)))


def with_bodies(
    found: Found,
    media: Media,
    options: CaptureOptions,
    on_frame: Callable[[int], None],
    should_stop: ShouldStop,
) -> tuple[Found, tuple[BodyTrack, ...]]:
    """Return the hands with the sides that their bodies tell, where they are yet to be fitted, and these
    bodies.

    `on_frame` gets the count of frames that are done. Once it is to stop, the hands come back as they were.
    """
    if media.source.kind == "data":
        return found, ()
    points = [
        scatter(track.detections.keypoints_2d, track.detections.frame, track.frame_count, np.nan)
        for track in found.tracks
    ]
    camera = options.measured_lens(media.width, media.height) or found.intrinsics
    bodies = find_bodies(media, found.numbers, points, camera, options.processes, on_frame, should_stop)
    if found.fits is None and not should_stop():
        found = replace(found, tracks=with_body_sides(found.tracks, bodies, options.hands))
    return found, bodies


def arms_of(
    hands: Sequence[HandTrack], bodies: Sequence[BodyTrack], camera: Intrinsics, fps: float
) -> tuple[HandTrack, ...]:
    """Return the hands with the arms that they have on these bodies, or with a sentence why they have
    none."""
    count = max((len(hand.detected) for hand in hands), default=0)
    directions = np.full((len(hands), count, 2, 3), np.nan)
    errors, bones = np.full((2, len(hands), count, 2), np.nan)
    whys: list[list[tuple[int, str]]] = [[] for _ in hands]
    for shot in _shots(hands, bodies, camera):
        for body, chosen in _belonging(hands, bodies, camera, shot, whys):
            found = _fitted([hands[i] for i in chosen], body, camera, shot, fps)
            if found is None:
                for i in chosen:
                    whys[i].append((int(hands[i].present[shot].sum()), NO_FIT))
            else:
                directions[chosen, shot], errors[chosen, shot], bones[chosen, shot] = found
    made = []
    for hand, of_arm, off, long, why in zip(hands, directions, errors, bones, whys, strict=True):
        there = np.isfinite(long[:, 0])
        if there.any():
            lengths = np.median(long[there], axis=0)
            wrist = np.where(there[:, None], hand.joints_3d[:, 0], np.nan)
            elbow = wrist - lengths[1] * of_arm[:, 1]
            arm = ArmMotion(elbow - lengths[0] * of_arm[:, 0], elbow, wrist, lengths, there, off)
            made.append(replace(hand, arm=arm, no_arm=""))
        else:  # of several shots the longest one tells why
            made.append(replace(hand, arm=None, no_arm=max(why, default=(0, NO_BODY))[1]))
    return tuple(made)


def _belonging(
    hands: Sequence[HandTrack],
    bodies: Sequence[BodyTrack],
    camera: Intrinsics,
    shot: slice,
    whys: list[list[tuple[int, str]]],
) -> list[tuple[BodyTrack, list[int]]]:
    """Return the bodies of a shot that hands hang on, each with the numbers of its hands: one hand of each
    side at most. What keeps the other hands from a body is added to `whys`, with how many frames they
    have."""
    groups: list[dict[Side, int]] = [{} for _ in bodies]
    judged = []
    for i, hand in enumerate(hands):
        found = [(*_judged(hand, body, camera, shot), b) for b, body in enumerate(bodies)]
        judged.append((*min(found, key=lambda each: each[0], default=(np.inf, NO_BODY, 0)), i))
    for _, why, b, i in sorted(judged):  # the nearest first
        if not why and groups[b].setdefault(hands[i].side, i) != i:
            why = APART
        if why and (frames := int(hands[i].present[shot].sum())):
            whys[i].append((frames, why))
    return [(body, [*group.values()]) for body, group in zip(bodies, groups, strict=True) if group]


def _judged(hand: HandTrack, body: BodyTrack, camera: Intrinsics, shot: slice) -> tuple[float, str]:
    """Return the median distance in a shot between the body's wrist and the hand's, in hand lengths, and a
    sentence that says what keeps the hand from hanging on the body; empty where nothing does."""
    both = hand.present[shot] & body.present[shot]
    if not both.any():
        return np.inf, NO_BODY
    distance, other = (
        float(np.median(_distance(hand, body, camera, side)[shot][both]))
        for side in (hand.side, SIDES[1 - SIDES.index(hand.side)])
    )
    # Of the points that arms have, pixels a metre of the body's own coordinates
    used = [index for of in (SHOULDERS, ELBOWS, WRISTS) for index in of.values()]
    spread = [
        np.linalg.norm(each - each.mean(axis=1, keepdims=True), axis=2).sum(axis=1)
        for each in (body.keypoints[shot][both][:, used], body.world[shot][both][:, used, :2])
    ]
    scale = _size(hand, camera)[shot][both] / (GATES.body_scale * spread[0] / np.maximum(spread[1], 1e-6))
    is_forearm = not GATES.min_scale <= np.median(scale) <= GATES.max_scale
    if distance > GATES.max_distance:
        if is_forearm and min(distance, other) <= 2.0 * GATES.max_distance:
            return distance, FOREARM_ONLY
        return distance, OTHER_SIDE if other <= GATES.max_distance else APART
    if is_forearm:
        return distance, FOREARM_ONLY
    # The detector is asked once in a while, and arms before the chest hide a person from it.
    score = np.sort(body.score[shot][np.isfinite(body.score[shot])])
    if not len(score) or score[3 * len(score) // 4] < GATES.min_score:
        return distance, NO_PERSON
    of_arm = [of[hand.side] for of in (SHOULDERS, ELBOWS, WRISTS)]
    visible = np.median(body.visibility[shot][both][:, of_arm], axis=0)
    hidden = np.flatnonzero(visible <= GATES.min_visibility)
    return distance, HIDDEN[hidden[0]] if len(hidden) else ""


def _fitted(
    hands: Sequence[HandTrack], body: BodyTrack, camera: Intrinsics, shot: slice, fps: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Fit the A arms that hang on a body in the T frames of a shot; NaN in frames without. Returns the
    directions of upper arm and forearm (A, T, 2, 3), their expected errors (A, T, 2), and their lengths (A,
    T, 2), metres, to reach from this body to the hands as they are. None where hands and body do not fit."""
    seen = _seen(hands, body, camera, shot)
    arms = fit_arms(seen, fps)
    points = arms.points[:, :, :2]
    size = np.stack([_size(hand, camera)[shot] for hand in hands], axis=1)
    off = np.linalg.norm(camera.project(points) - seen.pixels[..., :2, :], axis=-1).mean(axis=-1) / size
    body_seen = seen.visibility[..., 0] > 0.0
    sure = body_seen & seen.with_hand
    if not np.median(off[sure]) <= GATES.max_residual:
        return None
    nearer = np.linalg.norm(seen.wrist, axis=-1) / np.linalg.norm(arms.wrist, axis=-1)
    scale = np.clip(np.median(nearer[sure]), 1.0 / GATES.max_longer, GATES.max_longer)
    directions = np.stack([arms.upper, arms.forearm], axis=2)
    disagreement = np.arccos(np.clip((directions * seen.directions).sum(axis=-1), -1.0, 1.0))
    visible = np.clip(np.minimum(seen.visibility[..., :2], seen.visibility[..., 1:]), 0.3, 1.0)
    errors = np.hypot(np.array(GATES.errors) / visible, 0.5 * np.nan_to_num(disagreement))
    there = _near(sure, fps) & seen.with_hand
    # What the arm says of the hand's distance tells its lengths: the hand stays where it is.
    lengths = scale * arms.lengths
    directions[~there] = errors[~there] = lengths[~there] = np.nan
    return directions.swapaxes(0, 1), errors.swapaxes(0, 1), lengths.swapaxes(0, 1)


def _seen(hands: Sequence[HandTrack], body: BodyTrack, camera: Intrinsics, shot: slice) -> ArmsSeen:
    """Return what the fit is given of the hands that hang on a body. In frames in which the body is not at
    the hand, it is another hand's body, and does not count."""
    of_arms = [[of[hand.side] for of in (SHOULDERS, ELBOWS, WRISTS)] for hand in hands]
    pixels = np.stack([body.keypoints[shot][:, points] for points in of_arms], axis=1)
    world = np.stack([body.world[shot][:, points] for points in of_arms], axis=1)
    visibility = np.stack([body.visibility[shot][:, points] for points in of_arms], axis=1)
    distance = np.stack([_distance(hand, body, camera, hand.side)[shot] for hand in hands], axis=1)
    other = ~body.present[shot, None] | (distance > 2.0 * GATES.max_distance)
    bones = np.diff(world, axis=2)
    count, of_hands = len(visibility), [_hand_length(hand) for hand in hands]
    return ArmsSeen(
        wrist=np.stack(
            [np.where(h.present[shot, None], h.joints_3d[shot, 0], np.nan) for h in hands], axis=1
        ),
        hand=np.stack([_axes(hand)[shot] for hand in hands], axis=1),
        pixels=pixels,
        visibility=np.where(other[..., None], 0.0, visibility),
        directions=bones / np.maximum(np.linalg.norm(bones, axis=-1, keepdims=True), 1e-9),
        lengths=np.repeat([np.outer(of_hands, [ARMS.upper_arm, ARMS.forearm])], count, axis=0),
        hand_length=float(np.mean(of_hands)),
        camera=camera,
    )


def _shots(hands: Sequence[HandTrack], bodies: Sequence[BodyTrack], camera: Intrinsics) -> list[slice]:
    """Return the frames between cuts, a slice for each shot: at cuts that were seen, and where the shoulders
    of a body jump, or a hand while no body is there."""
    sizes = [np.nanmedian(_size(hand, camera)) for hand in hands if hand.present.any()]
    if not sizes:
        return []
    count = len(hands[0].detected)
    cuts, followed = {0, count}, np.zeros(count, dtype=bool)
    for body in bodies:
        rows = np.flatnonzero(body.present)
        middle = body.keypoints[rows][:, [*SHOULDERS.values()]].mean(axis=1)
        jumps = np.linalg.norm(np.diff(middle, axis=0), axis=1) > GATES.max_jump * np.median(sizes)
        cuts.update([*rows[1:][jumps].tolist(), *np.flatnonzero(body.cut).tolist()])
        followed[1:] |= body.present[1:] & body.present[:-1]
    for hand in hands:
        rows = np.flatnonzero(hand.detected)
        jumps = detect_cuts(hand.keypoints_2d[rows]) & (np.diff(rows) == 1) & ~followed[rows[1:]]
        cuts.update(rows[1:][jumps].tolist())
    return [slice(*each) for each in pairwise(sorted(cuts))]


def _hand_length(hand: HandTrack) -> float:
    """Return the metres from the wrist along the bones to the tip of the middle finger."""
    bones = np.diff(hand.joints_3d[hand.present][:, [0, 9, 10, 11, 12]], axis=1)
    return float(np.median(np.linalg.norm(bones, axis=2).sum(axis=1)))


def _size(hand: HandTrack, camera: Intrinsics) -> np.ndarray:
    """Return (T,) the pixels that the hand's length has at the wrist's distance."""
    return 0.5 * (camera.fx + camera.fy) * _hand_length(hand) / hand.joints_3d[:, 0, 2]


def _distance(hand: HandTrack, body: BodyTrack, camera: Intrinsics, side: Side) -> np.ndarray:
    """Return (T,) the distance in the picture from the body's wrist of that side to the hand's, in hand
    lengths."""
    wrist = camera.project(hand.joints_3d[:, 0])
    return np.linalg.norm(body.keypoints[:, WRISTS[side]] - wrist, axis=1) / _size(hand, camera)


def _axes(hand: HandTrack) -> np.ndarray:
    """Return (T, 3, 3) the hand's axes as unit rows: along the palm, across it, and towards the thumb."""
    along, across = hand.joints_3d[:, 9] - hand.joints_3d[:, 0], hand.joints_3d[:, 5] - hand.joints_3d[:, 17]
    normal = np.cross(along, across)
    axes = np.stack([along, normal, np.cross(normal, along)], axis=1)
    return axes / np.linalg.norm(axes, axis=2, keepdims=True)


def _near(there: np.ndarray, fps: float) -> np.ndarray:
    """Return (T, A) bool: True in frames that are between frames `there` which are not far apart, or next to
    one."""
    rows = np.arange(len(there))[:, None]
    since = rows - np.maximum.accumulate(np.where(there, rows, -np.inf), axis=0)
    until = np.minimum.accumulate(np.where(there, rows, np.inf)[::-1], axis=0)[::-1] - rows
    near = np.maximum(since, until) <= GATES.max_gap_seconds * fps
    return near | (np.minimum(since, until) <= max(GATES.max_end_seconds * fps, 1.0))
