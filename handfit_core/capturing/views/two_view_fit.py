"""The first view's take with its hands fitted to both views."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from handfit_core.capturing.fitting import hand_track
from handfit_core.capturing.options import CaptureOptions
from handfit_core.capturing.retiming import sampled
from handfit_core.capturing.views.pairing import PairingAttempt
from handfit_core.capturing.views.readings import ViewTake, track_of
from handfit_core.common.skeleton import SIDES
from handfit_core.detect.keypoints import Detections
from handfit_core.fit.fast import Guess, fit_observed, fitter_of
from handfit_core.fit.settings import VIEWS
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.hand_model.length import flat_hand_length
from handfit_core.hand_model.motion import HandMotion
from handfit_core.take import HandTrack, Take
from handfit_core.take.views import Cameras, SeenHand, Verdict, View


def fitted_to_both(
    attempt: PairingAttempt,
    first: ViewTake,
    options: CaptureOptions,
    verdict: Verdict,
    on_step: Callable[[], None],
) -> Take:
    """The first view's take with its paired hands fitted to both views. `on_step` is called before each hand,
    and may raise to stop."""
    take, other, found = first.take, attempt.second.take, attempt.found
    cameras, hands = attempt.cameras, []
    for i, hand in enumerate(take.hands):
        on_step()
        at = next((k for k, (mine, _) in enumerate(attempt.hands) if mine == i), None)
        if at is None:
            hands.append(_fit_alone(hand, take, cameras[0], options))
            continue
        fit, used = _fit(take, hand, at, attempt, options)
        fit, more = _filled(fit, first, at, attempt)
        used = np.union1d(used, more)
        track = track_of(take, hand, hand.side, _kept(hand, attempt.pairs[at].first.rows))
        whole = hand_track(attempt.pairs[at].fitter.model, track, fit, cameras[0])
        hands.append(replace(whole, seen_by=(_seen(other.hands[attempt.hands[at][1]], used),)))
    numbers = np.asarray(other.frame_numbers)
    view = View(other.source, other.fps, other.width, other.height, numbers, None, attempt.mirrored)
    return replace(
        take,
        intrinsics=cameras[0],
        hands=tuple(hands),
        cameras=Cameras(
            np.stack([np.eye(3), found.rotation]),
            np.stack([np.zeros(3), found.translation]),
            np.array([list(vars(camera).values()) for camera in cameras]),
            np.array([0.0, found.offset]),
            (view,),
        ),
        verdict=verdict,
    )


def _kept(hand: HandTrack, rows: np.ndarray) -> Detections:
    return hand.detections.select(np.isin(hand.detections.frame, rows))


def _fit_alone(hand: HandTrack, take: Take, camera: Intrinsics, options: CaptureOptions) -> HandTrack:
    """A hand that the first view alone has, seen through the camera that was found."""
    if not hand.refinable:
        return replace(hand, seen_by=(None,))
    model = load_model(options.model, hand.side)
    fitter = fitter_of(model, options.hand_length)
    track = track_of(take, hand, hand.side, hand.detections)
    fit = fit_observed(options.smoothing, fitter, track, fitter.observe(track.detections, camera))
    return replace(hand_track(model, track, fit, camera), seen_by=(None,))


def _fit(
    take: Take, hand: HandTrack, at: int, attempt: PairingAttempt, options: CaptureOptions
) -> tuple[HandMotion, np.ndarray]:
    """The hand fitted to both views, and the second view's rows (K,) that counted."""
    first, second = attempt.pairs[at].first, attempt.pairs[at].second
    seen, state, residual = attempt.posed(at)
    assert seen.second is not None
    agreement = VIEWS.both_factor * (residual / VIEWS.usual_residual) ** VIEWS.residual_power
    track = track_of(take, hand, hand.side, _kept(hand, first.rows))
    error_factor = np.where(seen.second.saw, agreement, 1.0)
    guess = Guess(state, first.observed(attempt.cameras[0]), error_factor)
    fit = fit_observed(options.smoothing, attempt.pairs[at].fitter, track, seen, guess=guess)
    times = (first.times - attempt.found.offset)[seen.second.saw]
    near = np.abs(second.times[:, None] - times).min(axis=1, initial=np.inf)
    # Pixels between its frames come from both neighbours.
    return fit, second.rows[near * min(first.fps, second.fps) < 1.0 - 1e-6]


def _filled(
    fit: HandMotion, first: ViewTake, at: int, attempt: PairingAttempt
) -> tuple[HandMotion, np.ndarray]:
    """The motion with the second view's hand, turned into the first camera's frame, where the first view has
    none, and the second view's rows (K,) that gave it. Next to frames that both views have, it is turned and
    moved by what lies between them, and so on up to the next such frames."""
    pair, found = attempt.pairs[at], attempt.found
    moments = first.times - found.offset
    missing = np.setdiff1d(np.flatnonzero(pair.second.seen_at(moments)), pair.first.rows)
    both = np.intersect1d(pair.first.rows, np.flatnonzero(pair.second.seen_at(moments) & fit.present))
    if not len(missing) or not len(both):
        return fit, missing[:0]
    place = np.searchsorted(both, missing)
    before, after = both[np.maximum(place - 1, 0)], both[np.minimum(place, len(both) - 1)]
    rows = np.unique(np.concatenate([missing, before, after]))
    clip, hand = attempt.second, attempt.second.take.hands[attempt.hands[at][1]]
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
    found = hand.detections
    named = replace(found, side=np.full(len(found), SIDES.index(hand.side)), right_side=None)
    return SeenHand(np.isin(np.arange(len(hand.detected)), used), named)
