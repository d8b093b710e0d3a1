"""One of two views, and how the second one can be read: as it is, mirrored, or as of the other side."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from handfit_core.capturing.fitting import hand_track
from handfit_core.capturing.options import CaptureOptions
from handfit_core.common.skeleton import SIDES, Side
from handfit_core.detect.keypoints import Detections, Track
from handfit_core.fit.fast import fit_observed, fitter_of
from handfit_core.hand_model import load_model
from handfit_core.take import HandTrack, Take
from handfit_core.take.fit_quality import error_is_known


@dataclass(frozen=True, eq=False)
class ViewTake:
    """One view: its take, and whether the file or a person has told the focal length."""

    take: Take
    lens_known: bool = False

    @property
    def times(self) -> np.ndarray:
        """(T,) seconds after its first frame."""
        numbers = np.asarray(self.take.frame_numbers)
        return (numbers - numbers[0]) / self.take.fps


def readings(first: ViewTake, second: ViewTake, options: CaptureOptions) -> Iterator[tuple[ViewTake, bool]]:
    """The second view as it is, and turned back where it may be mirrored."""
    sides = [{hand.side for hand in clip.take.hands} for clip in (first, second)]
    if sides[0] & sides[1]:
        yield second, False
    turned = _turned_back(second, options)
    if sides[0] & {hand.side for hand in turned.take.hands}:
        yield turned, True
    if len(second.take.hands) == 1 and not sides[0] & sides[1]:
        side = first.take.hands[0].side
        yield _refitted(second, options, lambda hand: (side, hand.detections)), False


def _turned_back(clip: ViewTake, options: CaptureOptions) -> ViewTake:
    """The view mirrored, with hands of the other sides."""
    take = clip.take
    camera = replace(take.intrinsics, cx=take.width - take.intrinsics.cx)
    mirror = np.array([-1.0, 1.0, 1.0])

    def mirrored(hand: HandTrack) -> tuple[Side, Detections]:
        found = hand.detections
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


def _refitted(
    clip: ViewTake, options: CaptureOptions, read: Callable[[HandTrack], tuple[Side, Detections]]
) -> ViewTake:
    """The view with its hands fitted anew, to what `read` makes of their detections."""
    take, hands = clip.take, []
    for hand in take.hands:
        side, found = read(hand)
        model, track = load_model(options.model, side), track_of(take, hand, side, found)
        fitter = fitter_of(model, options.hand_length)
        fit = fit_observed(options.smoothing, fitter, track, fitter.observe(found, take.intrinsics))
        hands.append(hand_track(model, track, fit, take.intrinsics))
    return replace(clip, take=replace(take, hands=tuple(hands)))


def track_of(take: Take, hand: HandTrack, side: Side, found: Detections) -> Track:
    """What was `found` of a take's hand, as of that side, for a fit over the take's frames."""
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
