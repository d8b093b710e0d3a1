"""Decides which side a hand is of by the body that it hangs on, and drops frames in which its track has
jumped to the person's other hand."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from handfit_core.common.batch import scatter
from handfit_core.common.skeleton import SIDES, HandChoice, other_side
from handfit_core.detect.body import ELBOWS, SHOULDERS, WRISTS, BodyTrack
from handfit_core.detect.keypoints import Track

log = logging.getLogger("handfit")


@dataclass(frozen=True)
class VoteSettings:
    """When a body tells the side of a hand. Distances are in sizes of the hand."""

    min_score: float = 0.65
    """Median score of the body over its frames, by the people's detector, 0..1, that it must have to vote"""
    min_visibility: float = 0.5
    """Visibility, 0..1, that the shoulder, elbow and wrist of the arm must have"""
    max_distance: float = 0.5
    """Farthest that the hand's wrist may lie from the body's"""
    min_margin: float = 0.5
    """How much farther away the body's other wrist must be"""
    min_share: float = 0.8
    """Share of the votes that must name a side for a track to take it. Of 20 hands in photos that a body
    voted on, all were of the side that it named, among them three that the hands' detector had named
    wrongly"""
    min_voted: float = 0.25
    """Share of a track's frames that must have a vote"""


VOTES: Final = VoteSettings()


def with_body_sides(tracks: Sequence[Track], bodies: Sequence[BodyTrack], hands: HandChoice) -> list[Track]:
    """Return the tracks with the sides that their bodies tell, and without the frames in which a track is on
    the other hand: there, both the body and the hands' detector name the other side.

    `hands` is the user's choice of hands: where it names a side, that stays. So do sides that a person has
    given, and two hands of one side are not made of a left and a right one.
    """
    votes = [_votes(track, bodies) for track in tracks]
    sides = [track.side for track in tracks]
    for i, (track, vote) in enumerate(zip(tracks, votes, strict=True)):
        against = float(np.mean(vote[vote >= 0] != SIDES.index(track.side))) if (vote >= 0).any() else 0.0
        voted = float(np.mean(vote[track.detected] >= 0))
        given = (track.detections.given_side >= 0).any()
        if hands in SIDES or given or against < VOTES.min_share or voted < VOTES.min_voted:
            continue
        sides[i] = other_side(track.side)
    if len(set(sides)) < len({track.side for track in tracks}):
        sides = [track.side for track in tracks]
    return [_on_side(replace(t, side=s), v) for t, s, v in zip(tracks, sides, votes, strict=True)]


def _on_side(track: Track, votes: np.ndarray) -> Track:
    """Return the track without the frames in which it is on the other hand, by the bodies' `votes` (T,)."""
    other = 1 - SIDES.index(track.side)
    found = track.detections
    astray = (votes[found.frame] == other) & (found.likely_side == other) & (found.given_side < 0)
    if not astray.any() or astray.all():
        return track
    log.warning("in %d frames the %s hand was followed on the other one: left out", astray.sum(), track.side)
    return replace(track, detections=found.select(~astray))


def _votes(track: Track, bodies: Sequence[BodyTrack]) -> np.ndarray:
    """Return (T,) the index in `SIDES` of the side that a body names in each frame; -1 where no body does."""
    found, count = track.detections, track.frame_count
    hand = scatter(found.keypoints_2d[:, 0], found.frame, count, np.nan)
    size = scatter(found.extent, found.frame, count, np.nan)
    votes, nearest = np.full(count, -1), np.full(count, VOTES.max_distance)
    for body in bodies:
        scores = body.score[np.isfinite(body.score)]
        if not len(scores) or np.median(scores) < VOTES.min_score:
            continue
        wrists = body.keypoints[:, [WRISTS[side] for side in SIDES]]
        off = np.linalg.norm(wrists - hand[:, None], axis=-1) / size[:, None]
        arms = [[of[side] for of in (SHOULDERS, ELBOWS, WRISTS)] for side in SIDES]
        visible = body.visibility[:, arms].min(axis=-1)
        for side in range(len(SIDES)):
            named = (off[:, side] < nearest) & (off[:, 1 - side] > off[:, side] + VOTES.min_margin)
            named &= visible[:, side] > VOTES.min_visibility
            votes[named], nearest[named] = side, off[named, side]
    return votes
