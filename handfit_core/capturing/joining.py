"""Two takes of the same hands, filmed by two cameras, made one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from handfit_core.capturing.fitting import hand_track
from handfit_core.capturing.options import CaptureOptions
from handfit_core.capturing.retiming import sampled
from handfit_core.common.batch import slices
from handfit_core.common.skeleton import SIDES, Side
from handfit_core.detect.keypoints import Detections, Track
from handfit_core.fit.fast import FastFitter, Guess, fit_observed, fitter_of
from handfit_core.fit.observation import Observation
from handfit_core.fit.settings import VIEWS
from handfit_core.fit.terms import reprojection, second_view
from handfit_core.fit.views.cameras import Adjusted, HandPair, Known, adjust
from handfit_core.fit.views.courses import OffsetScore, offset_scores
from handfit_core.fit.views.hands import ViewedHand
from handfit_core.fit.views.rig_file import Rig
from handfit_core.fit.views.verdict import Evidence, degrees_apart, rotation_between, verdict_of
from handfit_core.geometry.camera import Intrinsics, PlacedCamera
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.hand_model.chain import State
from handfit_core.hand_model.length import flat_hand_length
from handfit_core.hand_model.motion import HandMotion
from handfit_core.take import HandTrack, Take
from handfit_core.take.fit_quality import error_is_known, mean_expected_error
from handfit_core.take.views import Cameras, SeenHand, Verdict, View

HAND_LENGTHS: Final = (0.06, 0.28)
"""metres, between which a measured distance of the cameras may make a hand"""


@dataclass(frozen=True, eq=False)
class Clip:
    """One view: its take, and whether the file or a person has told the focal length."""

    take: Take
    lens_known: bool = False
    stamps: np.ndarray | None = None
    """(T,) seconds after its first frame, as the file tells them; None: as its rate says"""

    @property
    def even_times(self) -> np.ndarray:
        """(T,) seconds after its first frame, as its rate says."""
        numbers = np.asarray(self.take.frame_numbers)
        return (numbers - numbers[0]) / self.take.fps

    @property
    def times(self) -> np.ndarray:
        """(T,) seconds after its first frame."""
        return self.even_times if self.stamps is None else self.stamps


@dataclass(frozen=True, eq=False)
class _Tried:
    """One way to pair the hands of two views, and what came of it."""

    second: Clip
    mirrored: bool
    hands: list[tuple[int, int]]
    """Indices in both takes, of each pair"""
    pairs: list[HandPair]
    known: Known
    found: Adjusted
    score: float
    """of the offset; NaN where it was given"""
    dropped: float = 0.0


def joined(
    first: Clip,
    second: Clip,
    options: CaptureOptions,
    rig: Rig | None = None,
    on_step: Callable[[], None] = lambda: None,
) -> Take:
    """The first view's take with hands fitted to both views, their cameras and the verdict; where the views
    do not belong together, the better view's take with the verdict alone. `rig`: the cameras, with whose
    lenses both were captured. `on_step` is called before each step, and may raise to stop."""
    tried: list[_Tried] = []
    for other, mirrored in _readings(first, second, options):
        attempt = _tried(first, other, options, rig, on_step, mirrored=mirrored)
        if attempt is not None:
            tried.append(attempt)
            if attempt.found.residual <= VIEWS.good_residual:
                break
    if not tried:
        when = "" if options.offset is None else f" with an offset of {options.offset:g} seconds"
        return _better(first, second, f"No hand is seen in both views at the same time{when}")
    best = min(tried, key=lambda each: each.found.cost)
    if rig is None and options.baseline is not None:
        best = _scaled(best, options)
    on_step()
    verdict = _verdict(best, first, options)
    if verdict.agreement == "failed":
        return _better(first, second, verdict.text)
    return _fitted(best, first, options, verdict, on_step)


def _readings(first: Clip, second: Clip, options: CaptureOptions) -> Iterator[tuple[Clip, bool]]:
    """The second view as it is, and turned back where it may be mirrored."""
    sides = [{hand.side for hand in clip.take.hands} for clip in (first, second)]
    if sides[0] & sides[1]:
        yield second, False
    turned = _turned_back(second, options)
    if sides[0] & {hand.side for hand in turned.take.hands}:
        yield turned, True
    if len(second.take.hands) == 1 and not sides[0] & sides[1]:
        yield _refitted(second, options, lambda hand: _as_side(hand, first.take.hands[0].side)), False


def _turned_back(clip: Clip, options: CaptureOptions) -> Clip:
    take = clip.take
    camera = replace(take.intrinsics, cx=take.width - take.intrinsics.cx)
    mirror = np.array([-1.0, 1.0, 1.0])

    def mirrored(hand: HandTrack) -> tuple[Side, Detections]:
        found = hand.detections()
        there = np.array([take.width, 0.0, 0.0])
        older = found.keypoints_2020
        return SIDES[1 - SIDES.index(hand.side)], replace(
            found,
            side=1 - found.side,
            keypoints=found.keypoints * mirror + there,
            world=found.world * mirror,
            keypoints_2020=None if older is None else older * mirror + there,
        )

    return _refitted(replace(clip, take=replace(take, intrinsics=camera)), options, mirrored)


def _as_side(hand: HandTrack, side: Side) -> tuple[Side, Detections]:
    return side, hand.detections()


def _refitted(
    clip: Clip, options: CaptureOptions, read: Callable[[HandTrack], tuple[Side, Detections]]
) -> Clip:
    """The view with its hands fitted anew, to what `read` makes of their detections."""
    take, hands = clip.take, []
    for hand in take.hands:
        side, found = read(hand)
        model, track = load_model(options.model, side), _track(take, hand, side, found)
        fitter = fitter_of(model, options.hand_length)
        fit = fit_observed(options.smoothing, fitter, track, fitter.observe(found, take.intrinsics))
        hands.append(hand_track(model, track, fit, take.intrinsics))
    return replace(clip, take=replace(take, hands=tuple(hands)))


def _track(take: Take, hand: HandTrack, side: Side, found: Detections) -> Track:
    steps = np.diff(take.frame_numbers)
    usual = float(np.median(steps)) if len(steps) else 1.0
    return Track(
        side,
        found,
        len(take.frame_numbers),
        take.fps / usual,
        tuple(np.flatnonzero(steps > usual).tolist()),
        calibrated=error_is_known(hand),
    )


def _tried(
    first: Clip,
    second: Clip,
    options: CaptureOptions,
    rig: Rig | None,
    on_step: Callable[[], None],
    *,
    mirrored: bool,
) -> _Tried | None:
    """The cameras of hands that are paired by their sides; None where nothing is in common."""
    hands: list[tuple[int, int]] = []
    pairs: list[HandPair] = []
    for side in SIDES:
        at = _surest(first.take, side), _surest(second.take, side)
        if at[0] is None or at[1] is None:
            continue
        fitter = fitter_of(load_model(options.model, side), options.hand_length)
        pair = HandPair(fitter, _viewed(fitter, first, at[0]), _viewed(fitter, second, at[1]))
        if min(len(pair.first), len(pair.second)) >= VIEWS.least_hand_frames:
            hands.append((at[0], at[1]))
            pairs.append(pair)
    if not pairs:
        return None
    known = _known(first, second, options, rig)
    starts = _starts(pairs, options)
    found = []
    for start in starts:
        on_step()
        adjusted = adjust(
            pairs,
            start.offset,
            known,
            frames=VIEWS.start_frames if len(starts) > 1 else VIEWS.frames,
        )
        if adjusted is not None and _common(pairs, adjusted.offset) >= min(
            VIEWS.least_frames, 0.5 * _common(pairs, start.offset)
        ):
            found.append((adjusted, start.score))
    if not found:
        return None
    adjusted, score = min(found, key=lambda each: each[0].cost)
    if len(starts) > 1:
        adjusted = adjust(pairs, adjusted.offset, known, adjusted) or adjusted
    on_step()
    return _without_others(_Tried(second, mirrored, hands, pairs, known, adjusted, score))


def _viewed(fitter: FastFitter, clip: Clip, hand: int) -> ViewedHand:
    take = clip.take
    return ViewedHand.of(fitter, take.hands[hand], clip.times, take.fps, take.intrinsics)


def _surest(take: Take, side: Side) -> int | None:
    """The index of the take's hand of that side that was seen best."""
    of_side = [i for i, hand in enumerate(take.hands) if hand.side == side and hand.refinable]
    return max(of_side, key=lambda i: float(np.nansum(take.hands[i].score)), default=None)


def _known(first: Clip, second: Clip, options: CaptureOptions, rig: Rig | None) -> Known:
    offset_sigma = None if options.offset is None else VIEWS.told_offset_sigma
    if rig is not None:
        focal = tuple(lens.intrinsics.fx for lens in rig.lenses)
        return Known(focal, (0.0, 0.0), rig.rotation, rig.translation, offset_sigma)  # type: ignore[arg-type]
    focal, sigma = [], []
    for clip in (first, second):
        camera = clip.take.intrinsics
        focal.append(camera.fx if clip.lens_known else camera.fx * VIEWS.focal_of_assumed)
        sigma.append(VIEWS.known_focal_sigma if clip.lens_known else VIEWS.focal_sigma)
    return Known(tuple(focal), tuple(sigma), offset_sigma=offset_sigma)


def _starts(pairs: list[HandPair], options: CaptureOptions) -> list[OffsetScore]:
    if options.offset is not None:
        return [OffsetScore(options.offset, np.nan)]
    found = offset_scores(pairs)
    if found and found[0].score >= VIEWS.weak_score:
        return found
    # Fingers that hardly move tell no offset: any that leaves enough in common may be the one.
    rate = min(pairs[0].first.fps, pairs[0].second.fps)
    ends = max(pair.first.times[-1] for pair in pairs), max(pair.second.times[-1] for pair in pairs)
    shorter = min(ends)
    least, most = -ends[1] + VIEWS.least_overlap * shorter, ends[0] - VIEWS.least_overlap * shorter
    count = int(np.clip((most - least) * rate / VIEWS.peaks_apart, 1, VIEWS.most_starts))
    grid = np.linspace(least, most, count + 2)[1:-1]
    return [*found, *(OffsetScore(float(offset), 0.0) for offset in grid)]


def _common(pairs: list[HandPair], offset: float) -> int:
    """Frames of the slower view in which both have a hand."""
    slower = min(1.0, pairs[0].second.fps / pairs[0].first.fps)
    return round(max(len(pair.common(offset)) for pair in pairs) * slower)


def _seen_by_both(tried: _Tried, at: int) -> tuple[Observation, State]:
    """One pair's hand in all frames of the first view, as both cameras see it, and roughly its poses."""
    first, second, found = tried.pairs[at].first, tried.pairs[at].second, tried.found
    own, other = _cameras(tried)
    placed = PlacedCamera(other, found.rotation, found.translation)
    seen = second.in_second_view(first.observed(own), first.sigmas, first.times - found.offset, placed)
    start = first.placed(found.focal[0])
    return seen, replace(start, betas=np.broadcast_to(found.betas, start.betas.shape))


def _posed_by_both(tried: _Tried, at: int) -> tuple[Observation, State, np.ndarray]:
    """What `_seen_by_both` gives, with the poses solved frame by frame, and the root mean squares (N,) of
    both views' residuals, in sigmas."""
    seen, start = _seen_by_both(tried, at)
    fitter = tried.pairs[at].fitter
    state = fitter.solve_each(fitter.problem(seen), start).state
    residual = np.empty(len(state))
    for rows in slices(len(state)):
        posed, here = fitter.chain.pose(state.select(rows)), seen.select(rows)
        squares = [np.square(term(posed, here).residual).sum(axis=2) for term in (reprojection, second_view)]
        residual[rows] = np.sqrt(np.concatenate(squares, axis=1).mean(axis=1))
    return seen, state, residual


def _cameras(tried: _Tried) -> list[Intrinsics]:
    found = []
    pair = tried.pairs[0]
    for hand, focal in zip((pair.first, pair.second), tried.found.focal, strict=True):
        camera = hand.intrinsics
        found.append(replace(camera, fx=float(focal), fy=float(focal) * camera.fy / camera.fx))
    return found


def _without_others(tried: _Tried) -> _Tried:
    """The cameras without frames in which the views show different hands."""
    pairs, dropped, total = [], 0, 0
    for at, pair in enumerate(tried.pairs):
        seen, _, residual = _posed_by_both(tried, at)
        assert seen.second is not None
        second, saw = pair.second, seen.second.saw
        other = saw & (residual > VIEWS.different_hand)
        total, dropped = total + int(saw.sum()), dropped + int(other.sum())
        times = pair.first.times[other] - tried.found.offset
        near = np.abs(second.times[:, None] - times).min(axis=1, initial=np.inf) * second.fps
        left = near > VIEWS.seen_within
        enough = left.sum() >= VIEWS.least_hand_frames
        pairs.append(replace(pair, second=second.select(left)) if enough else pair)
    share = dropped / max(total, 1)
    if not 0.0 < share < VIEWS.most_dropped:
        return tried
    again = adjust(pairs, tried.found.offset, tried.known, tried.found)
    return tried if again is None else replace(tried, pairs=pairs, found=again, dropped=share)


def _scaled(tried: _Tried, options: CaptureOptions) -> _Tried:
    """Cameras and hands of the size that a measured distance between the cameras tells."""
    assert options.baseline is not None
    factor = options.baseline / max(float(np.linalg.norm(tried.found.translation)), 1e-6)
    length = flat_hand_length(tried.pairs[0].fitter.model, tried.found.betas) * factor
    length = float(np.clip(length, *HAND_LENGTHS))
    pairs = [replace(pair, fitter=fitter_of(pair.fitter.model, length)) for pair in tried.pairs]
    start = replace(tried.found, translation=tried.found.translation * factor)
    again = adjust(pairs, tried.found.offset, tried.known, start)
    if again is None:
        return tried
    exact = options.baseline / max(float(np.linalg.norm(again.translation)), 1e-6)
    found = replace(again, translation=again.translation * exact)
    return replace(tried, pairs=pairs, found=found)


def _verdict(tried: _Tried, first: Clip, options: CaptureOptions) -> Verdict:
    found = tried.found
    return verdict_of(
        Evidence(
            offset_frames=_by_even_frames(first, tried.second, found.offset)[0] * first.take.fps,
            error=max(found.error),
            residual=found.residual,
            common=_common(tried.pairs, found.offset),
            apart=degrees_apart(found.rotation, found.translation, found.state.wrist),
            halves=_halves(tried) if tried.known.rotation is None else np.nan,
            score=np.nan if options.offset is not None else tried.score,
            dropped=tried.dropped,
            cameras_known=tried.known.rotation is not None,
            left_open=found.left_open,
        )
    )


def _halves(tried: _Tried) -> float:
    """degrees between the cameras that both halves of the common frames give; NaN where one is too short."""
    found = []
    for half in (0, 1):
        pairs = []
        for pair in tried.pairs:
            rows = pair.common(tried.found.offset)
            middle = len(rows) // 2
            pairs.append(pair.at(rows[middle:] if half else rows[:middle]))
        if min(len(pair.first) for pair in pairs) < VIEWS.least_hand_frames:
            return np.nan
        alone = adjust(
            pairs,
            tried.found.offset,
            tried.known,
            tried.found,
            frames=VIEWS.start_frames,
            iterations=VIEWS.start_iterations,
        )
        if alone is None:
            return np.nan
        found.append(alone.rotation)
    return rotation_between(*found)


def _better(first: Clip, second: Clip, why: str) -> Take:
    """The take of the view whose hands are likelier right, of one that is not much shorter than the first,
    with a verdict that says why it is alone."""
    takes = first.take, second.take
    errors = [[mean_expected_error(hand) for hand in take.hands] for take in takes]
    known = [[error for error in each if error is not None] for each in errors]
    seen = [max(int(np.sum(hand.detected)) for hand in take.hands) for take in takes]
    is_second = all(known) and np.mean(known[1]) < np.mean(known[0]) and 2 * seen[1] >= seen[0]
    return alone(takes, 1 if is_second else 0, why)


def alone(views: Sequence[Take | None], number: int, why: str) -> Take:
    """The take of one of two views, counted from 0, with a verdict that says why it is alone."""
    take = views[number]
    assert take is not None
    text = f"{why}. The {('first', 'second')[number]} view, {take.source.name}, was used alone."
    return replace(take, verdict=Verdict("failed", text))


def _fitted(
    tried: _Tried, first: Clip, options: CaptureOptions, verdict: Verdict, on_step: Callable[[], None]
) -> Take:
    """The first view's take with its paired hands fitted to both views."""
    take, other, found = first.take, tried.second.take, tried.found
    cameras, hands = _cameras(tried), []
    for i, hand in enumerate(take.hands):
        on_step()
        at = next((k for k, (mine, _) in enumerate(tried.hands) if mine == i), None)
        if at is None:
            hands.append(_alone(hand, take, cameras[0], options))
            continue
        fit, used = _fit(take, hand, at, tried, options)
        fit, more = _filled(fit, first, at, tried)
        used = np.union1d(used, more)
        track = _track(take, hand, hand.side, _kept(hand, tried.pairs[at].first.rows))
        whole = hand_track(tried.pairs[at].fitter.model, track, fit, cameras[0])
        hands.append(replace(whole, seen_by=(_seen(other.hands[tried.hands[at][1]], used),)))
    offset, rate, times = _by_even_frames(first, tried.second, found.offset)
    numbers = np.asarray(other.frame_numbers)
    view = View(other.source, rate, other.width, other.height, numbers, times, tried.mirrored)
    return replace(
        take,
        intrinsics=cameras[0],
        hands=tuple(hands),
        cameras=Cameras(
            np.stack([np.eye(3), found.rotation]),
            np.stack([np.zeros(3), found.translation]),
            np.array([list(vars(camera).values()) for camera in cameras]),
            np.array([0.0, offset]),
            (view,),
        ),
        verdict=verdict,
    )


def _kept(hand: HandTrack, rows: np.ndarray) -> Detections:
    found = hand.detections()
    return found.select(np.isin(found.frame, rows))


def _alone(hand: HandTrack, take: Take, camera: Intrinsics, options: CaptureOptions) -> HandTrack:
    """A hand that the first view alone has, seen through the camera that was found."""
    if not hand.refinable:
        return replace(hand, seen_by=(None,))
    model = load_model(options.model, hand.side)
    fitter = fitter_of(model, options.hand_length)
    track = _track(take, hand, hand.side, hand.detections())
    fit = fit_observed(options.smoothing, fitter, track, fitter.observe(track.detections, camera))
    return replace(hand_track(model, track, fit, camera), seen_by=(None,))


def _fit(
    take: Take, hand: HandTrack, at: int, tried: _Tried, options: CaptureOptions
) -> tuple[HandMotion, np.ndarray]:
    """The hand fitted to both views, and the second view's rows (K,) that counted."""
    first, second = tried.pairs[at].first, tried.pairs[at].second
    seen, state, residual = _posed_by_both(tried, at)
    assert seen.second is not None
    agreement = VIEWS.both_factor * (residual / VIEWS.usual_residual) ** VIEWS.residual_power
    track = _track(take, hand, hand.side, _kept(hand, first.rows))
    error_factor = np.where(seen.second.saw, agreement, 1.0)
    guess = Guess(state, first.observed(_cameras(tried)[0]), error_factor)
    fit = fit_observed(options.smoothing, tried.pairs[at].fitter, track, seen, guess=guess)
    times = (first.times - tried.found.offset)[seen.second.saw]
    near = np.abs(second.times[:, None] - times).min(axis=1, initial=np.inf)
    # Pixels between its frames come from both neighbours.
    return fit, second.rows[near * min(first.fps, second.fps) < 1.0 - 1e-6]


def _by_even_frames(first: Clip, second: Clip, offset: float) -> tuple[float, float, np.ndarray | None]:
    """Offset and frames per second of the second view, and the times (S,) of its frames where they stray from
    that, by a clock by which the first view's frames are even, as a take has them."""
    if first.stamps is None and second.stamps is None:
        return offset, second.take.fps, None
    moments = offset + second.times
    inside = np.clip(moments, 0.0, first.times[-1])
    moments = np.interp(inside, first.times, first.even_times) + moments - inside
    times, even = moments - moments[0], second.even_times
    rate = float((even @ even) / max(even @ times, 1e-9))
    strays = np.abs(times - even / rate).max() * second.take.fps > VIEWS.stray_frames
    return float(moments[0]), second.take.fps * rate, times if strays else None


def _filled(fit: HandMotion, first: Clip, at: int, tried: _Tried) -> tuple[HandMotion, np.ndarray]:
    """The motion with the second view's hand, turned into the first camera's frame, where the first view has
    none, and the second view's rows (K,) that gave it. Next to frames that both views have, it is turned and
    moved by what lies between them, and so on up to the next such frames."""
    pair, found = tried.pairs[at], tried.found
    moments = first.times - found.offset
    missing = np.setdiff1d(np.flatnonzero(pair.second.seen_at(moments)), pair.first.rows)
    both = np.intersect1d(pair.first.rows, np.flatnonzero(pair.second.seen_at(moments) & fit.present))
    if not len(missing) or not len(both):
        return fit, missing[:0]
    place = np.searchsorted(both, missing)
    before, after = both[np.maximum(place - 1, 0)], both[np.minimum(place, len(both) - 1)]
    rows = np.unique(np.concatenate([missing, before, after]))
    clip, hand = tried.second, tried.second.take.hands[tried.hands[at][1]]
    at_rows = np.interp(moments[rows], clip.times, np.arange(len(clip.times)))
    own = sampled(hand, np.arange(len(clip.times)), at_rows)
    turns = rotvec_to_rotmat(np.concatenate(own.pose[:2], axis=1).reshape(len(rows), -1, 3))
    turns[:, 0] = found.rotation.T @ turns[:, 0]
    size = flat_hand_length(pair.fitter.model, fit.betas) / flat_hand_length(pair.fitter.model, hand.betas)
    scale = size * np.array([1.0, 1.0, found.focal[1] / clip.take.intrinsics.fx])
    places = (own.transl * scale) @ found.rotation
    there = np.searchsorted(rows, missing)

    def beside(known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What turns (N, 16, 3, 3) and moves (N, 3) the second view's hand onto that of both views."""
        here = np.searchsorted(rows, known)
        pose = np.concatenate([fit.global_orient[known], fit.hand_pose[known]], axis=1)
        turn = rotvec_to_rotmat(pose.reshape(len(known), -1, 3)) @ turns[here].swapaxes(2, 3)
        return turn, fit.transl[known] - places[here]

    (turn, shift), (last_turn, last_shift) = beside(before), beside(after)
    part = np.clip((missing - before) / np.maximum(after - before, 1), 0.0, 1.0)[:, None]
    way = rotmat_to_rotvec(turn.swapaxes(2, 3) @ last_turn)
    turned = rotmat_to_rotvec(turn @ rotvec_to_rotmat(part[..., None] * way) @ turns[there])
    pose = turned.reshape(len(missing), -1)
    values = {
        "global_orient": pose[:, :3],
        "hand_pose": pose[:, 3:],
        "transl": places[there] + shift + part * (last_shift - shift),
    }
    filled = {name: getattr(fit, name).copy() for name in values}
    for name, value in values.items():
        filled[name][missing] = value
    return replace(fit, **filled), pair.second.rows[np.unique(pair.second.nearest(moments[missing]))]


def _seen(hand: HandTrack, used: np.ndarray) -> SeenHand:
    assert hand.keypoints_depth is not None
    assert hand.world_landmarks is not None
    return SeenHand(
        hand.keypoints_2d,
        np.asarray(hand.detected),
        np.isin(np.arange(len(hand.detected)), used),
        hand.score,
        hand.keypoints_depth,
        hand.world_landmarks,
        hand.keypoints_2020,
        hand.overlapped,
    )
