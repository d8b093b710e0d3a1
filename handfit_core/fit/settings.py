"""Weights, tolerances and limits of the fits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class SolverSettings:
    """Iterations, tolerances and batch sizes of the least-squares solver."""

    max_iterations: int = 20
    """Most iterations of a problem: most hands need four to seven, fists up to fifteen"""
    tolerance: float = 5e-3
    """Relative decrease of the cost at which to stop"""
    pinned_tolerance: float = 2e-3
    """Relative decrease of the cost at which to stop where an artist has pinned points or made them touch"""
    shape_frames: int = 48
    """Number of frames, evenly spread over a clip, that the hand's one shape is fitted to"""
    shape_evidence: float = 3.0
    """How many frames of a clip count as independent evidence of the shape: a landmark's error is much the
    same in all"""
    chunk_frames: int = 512
    """Number of frames that are fitted between two chances to stop; it bounds the memory"""
    solve_batch: int = 256
    """Number of frames whose matrices are made, or that are solved, at once; it bounds the memory"""
    clip_iterations: int = 8
    clip_min_gain: float = 3e-3
    """Relative decrease of the total cost after which a step was the last"""
    clip_damping: float = 1e-6
    """First damping of the fits of clips, whose slow motions a larger one would hold back"""
    window_frames: int = 600
    """Number of frames that each window of a long clip adds"""
    first_damping: float = 1e-3
    min_damping: float = 1e-7
    max_damping: float = 1e6
    damping_decrease: float = 0.1
    damping_increase: float = 10.0
    """Factors of the damping after a step that decreased the cost as predicted, and after one that did not
    decrease it. Between them the factor depends on the gain ratio (Nielsen, "Damping parameter in Marquardt's
    method", 1999)"""
    min_gain_of_tolerance: float = 0.1
    """Relative decrease of the cost, in parts of the tolerance, below which a step was the last: in a curved
    valley steps fall short of the predicted decrease again and again"""
    pack_below_share: float = 0.85
    """Share of the batch that is still running from which on finished problems are dropped from it"""
    diagonal_floor: float = 1e-6
    """Added to every diagonal element in addition to the relative damping"""


SOLVER: Final = SolverSettings()


@dataclass(frozen=True)
class MotionSettings:
    """Settings of how hands are expected to move in clips, and of where gaps and cuts are."""

    rotation_acceleration: float = 12.5
    """radians per second squared: the acceleration that a joint's rotation is expected to have at strength
    1"""
    wrist_acceleration: float = 1.05
    """metres per second squared: the acceleration that the wrist is expected to have at strength 1"""
    overlap_seconds: float = 2.4
    """seconds that two windows of a long clip share at strength 1"""
    depth_factor: float = 1.5
    """Factor of the expected errors of depth where motion is smoothed: from frame to frame the depth of the
    landmark network of December 2020 trembles three to four times as much as that of the present one"""
    distance_sigma: float = 0.002
    """Relative deviation of the wrist's distance from the one that `stationary` finds for the whole clip"""
    max_fps: float = 1000.0
    """Frames per second that clips are taken to have at most: beyond, changes from frame to frame vanish"""
    palm_motion: float = 0.01
    """Deviation of a palm's points within a quarter of a second, in parts of the hand's size in the picture,
    from which the palm counts as moving"""
    min_scale: float = 0.05
    """Least factor of the expected acceleration of a palm that holds still"""
    max_gap_seconds: float = 0.5
    """seconds of a gap in a track beyond which it stays empty, since nothing tells what the hand did"""
    max_shift_of_size: float = 1.0
    """Movement from one detection to the next, in parts of the hand's size, beyond which there is a cut
    between"""
    max_growth: float = 1.6
    """Ratio of the palm's sizes from one detection to the next beyond which there is a cut between"""


MOTION: Final = MotionSettings()


@dataclass(frozen=True)
class TermSettings:
    """Expected deviations and weights of the residual terms. A sigma is the deviation that costs as much as
    one unit."""

    touch_sigma: float = 0.0015
    """metres between the skins of fingertips that are seen to touch"""
    user_touch_sigma: float = 0.0001
    """metres between skins that an artist wants to touch; without a robust kernel, as it is never an
    outlier"""
    robust_scale: float = 0.02
    """metres: scale of Geman and McClure's kernel. Fingertips that are seen to pinch, and parts that are seen
    in contact, count as outliers when they are farther apart"""
    order_sigma: float = 0.004
    """metres along the line of sight by which parts lie in the wrong order"""
    contact_sigma: float = 0.0025
    """metres between the skins of parts that are seen in contact"""
    prop_touch_sigma: float = 0.0005
    """metres between a prop and a pad that is drawn to it"""
    prop_penetration_sigma: float = 0.00025
    """metres of a skin's depth inside a prop"""
    prop_softness: float = 0.0005
    """metres on either side of a prop's surface in which a skin's depth grows from nothing: residuals are
    smooth there"""
    grip_turn_sigma: float = math.radians(2.0)
    """radians by which a wrist gives way to a prop in the palm"""
    grip_place_sigma: float = 0.002
    """metres by which a wrist gives way to a prop in the palm"""
    penetration_sigma: float = 0.001
    """metres by which parts of a hand penetrate each other"""
    edit_penetration_sigma: float = 0.00025
    """metres, in place of `penetration_sigma` where an artist corrects a pose: pins are surer than landmarks,
    and would push parts into each other"""
    compression: float = 0.00075
    """metres by which flesh is compressed where parts touch"""
    coupling_sigma: float = math.radians(18.0)
    """radians by which the bend of a finger's last joint deviates from what the joint before it leads to
    expect"""
    limits_sigma: float = math.radians(1.0)
    """radians by which an angle lies outside its range of motion"""
    bent_spread_share: float = 0.3
    """Share of a knuckle's spread that is left when it is bent by 90 degrees: collateral ligaments tighten"""
    passive_range: float = math.radians(10.0)
    """radians beyond the active range of motion to which a joint of a pose that is corrected may be drawn: a
    finger that is pressed goes further than it does by itself. Without this, a drag would move the palm where
    a person would only bend the finger"""
    step_margin: float = math.radians(3.0)
    """radians beyond the range to which a solver's step may lead: no observation brings a joint back from
    farther out"""
    pose_weight: float = 0.15
    """Factor of the pose prior's squared distance: with more of it, closed hands open and others are drawn to
    usual poses"""
    pinned_pose_weight: float = 0.7
    """Factor of the pose prior's squared distance where an artist has pinned points: little else tells where
    the others are"""
    length_sigma: float = 0.001
    """metres by which a hand's length deviates from the measured one; with the betas' own spread alone,
    proportions would overrule it"""
    shape_weight: float = 0.2
    """Factor of the squared betas where the length is not known: hands' proportions differ more than the open
    hand's betas, of sigma 1, expect. Their size does not, and hardly any picture tells it from the
    distance"""
    nearest: float = 0.02
    """metres from the camera, nearer than which hands and points do not count, so that a wild step cannot
    divide by zero"""


TERMS: Final = TermSettings()


@dataclass(frozen=True)
class ViewSettings:
    """Settings of the search for the places of two cameras that film the same hands, and of the fit to both
    views."""

    pixel_sigma: float = 0.024
    """Least expected error of a landmark in parts of the hand's size in that view: points that the detector
    is surer of than usual weigh no more, which is worse with two views"""
    depth_factor: float = 10.0
    """Factor of the depth's expected errors while cameras are looked for, where depth only breaks ties"""
    pose_weight: float = 0.3
    """Factor of the pose prior's squared distance, in place of `TERMS.pose_weight`, while cameras are looked
    for"""
    focal_of_assumed: float = 0.72
    """Where a search for the focal length starts, in parts of the one that a single view assumes: wide
    webcams have 0.5 to 0.7 of the picture's longer side, phones 0.7 to 0.8"""
    focal_sigma: float = 0.35
    """Expected error of the logarithm of a focal length of which nothing is known"""
    focal_ratio_sigma: float = 0.2
    """Expected error of the logarithm of the ratio of both focal lengths: two cameras of one shot are of
    similar kinds, and the direction between them hangs on this ratio"""
    known_focal_sigma: float = 0.02
    """Expected error of the logarithm of a focal length that the file or a person tells"""
    evidence: float = 10.0
    """Number of frames that count as one piece of evidence against what is expected of cameras: errors
    last"""
    offset_sigma: float = 1.0
    """frames of the slower view: expected error of the offset in time that a search starts from"""
    told_offset_sigma: float = 0.3
    """frames of the slower view: expected error of an offset in time that a person has given"""
    start_frames: int = 30
    """Number of common frames of both views on which different starts are compared"""
    frames: int = 60
    """Number of common frames, evenly spread, that cameras are found from"""
    start_iterations: int = 12
    iterations: int = 40
    longest_step: float = 0.5
    """radians that a step turns a finger's joint, at most"""
    tolerance: float = 1e-4
    """Relative decrease of the cost at which the search for cameras stops"""
    least_overlap: float = 0.4
    """Least share of the shorter view that an offset in time must leave common to both"""
    peaks: int = 3
    """How many offsets in time are tried, at the highest peaks of the agreement"""
    peaks_apart: float = 8.0
    """frames of the slower view by which these peaks of the agreement must lie apart"""
    longest_view: float = 3600.0
    """seconds of a view beyond which its offset in time is not looked for"""
    weak_score: float = 0.15
    """Agreement of the fingers' motions in both views below which an offset in time is not believed, and more
    starts are tried"""
    most_starts: int = 16
    """How many offsets in time are tried at most in place of peaks that are too weak to be believed"""
    seen_within: float = 0.75
    """frames from a detection of the second view within which that detection counts"""
    least_frames: int = 20
    """Least number of common frames; with fewer the search is not tried"""
    enough_frames: int = 40
    """Number of common frames below which the result is doubtful"""
    good_residual: float = 1.8
    """Root mean square of residuals of both views, in sigmas, up to which views agree"""
    doubtful_residual: float = 2.1
    """Root mean square of residuals of both views, in sigmas, beyond which views do not agree"""
    worst_residual: float = 4.0
    """sigmas; larger residuals count as this one when agreement is judged"""
    least_hand_frames: int = 8
    """Number of detections that a hand of one view needs, to be looked for in the other"""
    most_dropped: float = 0.6
    """Share of common frames that were dropped, as they show different hands, beyond which the views do not
    belong together"""
    same_place: float = 3.0
    """degrees between the lines of sight below which both views are one"""
    halves_apart: float = 18.0
    """degrees between the cameras that both halves of the frames give, beyond which a camera may have been
    moved"""
    most_halves_apart: float = 40.0
    """degrees between the cameras that both halves of the frames give, beyond which both are wrong"""
    different_hand: float = 4.5
    """Root mean square of a frame's residuals, in sigmas, beyond which the views show different hands"""
    many_dropped: float = 0.1
    """Share of common frames with different hands from which on the user is told of them"""
    least_apart: float = 15.0
    """degrees between the lines of sight below which depth is hardly seen"""
    open_rotation: float = 0.95
    """degrees that the normal equations leave open of the second camera's rotation, beyond which it is
    doubtful: rotations err by three to four times that"""
    open_direction: float = 6.5
    """degrees that the normal equations leave open of the direction to the second camera, beyond which it is
    doubtful: directions err by two to four times that"""
    both_factor: float = 0.75
    """Factor of the expected error where both views see the hand and agree as usual: rendered clips err by
    6.4 mm there, and by 8.7 in one view"""
    usual_residual: float = 0.85
    """Median over the frames of the root mean square of a frame's residuals, in sigmas, as usual where views
    agree"""
    residual_power: float = 0.25
    """Power of the residual, relative to `usual_residual`, with which the expected error grows: the rank
    correlation of expected and true errors is best so"""
    fit_depth_factor: float = 6.0
    """Factor of the depth's expected errors in the final fit to both views"""


VIEWS: Final = ViewSettings()
