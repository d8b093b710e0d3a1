"""Settings of how hands are corrected, added, and laid on props."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class PinSettings:
    """Settings of how sure pins are, and how uncertain they make the points around them."""

    pin_sigma: float = 0.2
    """pixels: expected error of a pin"""
    reached_pixels: float = 0.5
    """pixels between a point and its pin up to which the point has reached it"""
    limits_sigma: float = math.radians(0.3)
    """radians beyond a joint's passive range that cost one sigma, as in `PoseAnchor`: pins are surer than a
    capture's landmarks, and would bend fingers far beyond it"""
    pose_sigma: float = 0.005
    """Expected error in the picture of the landmarks of a corrected pose, in parts of the hand's size"""
    pose_depth_sigma: float = 0.02
    """Expected error in depth of the landmarks of a corrected pose, in parts of the hand's size"""
    min_pose_sigma: float = 0.5
    """pixels: least expected error in the picture of the landmarks of a corrected pose"""
    sigma_per_pixel: float = 0.5
    """pixels of expected error in the picture that a pixel of uncertainty adds"""
    depth_sigma_per_pixel: float = 1.0
    """pixels of expected error in depth that a pixel of uncertainty adds"""
    wrist_share: float = 0.5
    """Share of the wrist's displacement that is the uncertainty of all other points"""
    half_blend: float = 0.05
    """Uncertainty of a point, in hand sizes, at which it is taken half from the pose and half from the
    detector"""
    distance_sigma: float = 0.002
    """Relative deviation of the wrist's distance from the one that is kept"""
    palm_distance_sigma: float = 0.5
    """Increase of the deviation `distance_sigma` when a pin displaces the palm by the hand's size in the
    picture"""
    angle_sigma: float = 8.0
    """radians: deviation of a finger's angles from those that are kept, when its points are uncertain by the
    hand's size in the picture"""
    idle_share: float = 0.25
    """Share of `angle_sigma` for fingers without pins, which ride on a palm that is moved"""
    min_angle_sigma: float = 0.002
    """radians: least deviation of a finger's angles from those that are kept"""
    neighbour_seconds: float = 0.25
    """seconds from a pin's frame within which other frames' landmarks become uncertain, too; the less, the
    farther they are"""


PINS: Final = PinSettings()


@dataclass(frozen=True)
class EditSettings:
    """Settings of the search for the pose of a hand that an artist corrects or adds."""

    stand_in_factor: float = 4.0
    """Factor of the expected errors of a pose's landmarks where they stand in for a detection among others"""
    max_iterations: int = 50
    """Most iterations of a fit after a drag, more than captures take. Even where they are too few, a drag's
    result does not depend on its way: from the frame's own pose the steps are the same every time"""
    draft_iterations: int = 6
    """Most iterations while a point is dragged; few, as each answer continues from the one before"""
    frames_around: float = 4.0
    """Number of a second view's frames that are taken along before and after the time of the frames that are
    fitted again"""
    most_remembered: int = 32
    """Number of detections whose landmarks are kept for the next draft"""
    free_draft_iterations: int = 10
    """Most iterations for drafts of added hands, which start anew each time, from all sides"""
    restart_cost_ratio: float = 0.9
    """Share of the first start's cost below which the result of another start is taken instead"""
    restart_bends: tuple[tuple[float, float, float], ...] = (
        (0.0, 0.1, 0.1),
        (0.5, 0.5, 0.5),
        (0.9, 0.2, 0.2),
        (0.2, 0.9, 0.7),
    )
    """Other bends of its joints, in parts of their range, from which a finger that does not reach its pin is
    started again"""
    min_palm_pins: int = 2
    """Pins of palm points, fewer of which do not tell how a hand lies: then its pose is corrected like a
    captured one's"""
    rolls: tuple[float, ...] = tuple(map(math.radians, (0.0, 50.0, -50.0, 180.0, 230.0, 130.0)))
    """radians about the palm's long axis by which the starts of an added hand are turned"""
    pitches: tuple[float, ...] = tuple(map(math.radians, (0.0, 45.0, -45.0)))
    """radians about the axis across the palm in the picture by which the starts of an added hand are
    turned"""
    max_resize: float = 2.0
    """Largest ratio of a start's size in the picture to the hand's, and of the hand's to it"""
    palm_sigma: float = 0.5
    """Expected error of palm points without a pin, in the picture and in depth, in hand sizes"""
    distance_sigma: float = 0.15
    """Standard deviation of an added hand's wrist distance, relative to it: a palm that looks short is
    tilted, or farther away"""
    turned_over_cost: float = 4.0
    """squared sigmas that the other side of the hand costs"""
    neighbour_bend_share: float = 0.7
    """Share of a finger's bends that the next one takes over; the second next takes over its square"""
    first_pin_sigma: float = 0.02
    """Expected error of pins in the first round, in parts of the hand's size"""
    unseen_sigma: float = 1e9
    """pixels: expected error of points that are neither pinned nor kept"""


EDITS: Final = EditSettings()


@dataclass(frozen=True)
class GripSettings:
    """Settings of how a hand is laid on a prop."""

    reach: tuple[float, float] = (0.015, 0.02)
    """metres from the prop up to which a fingertip is drawn to it, and from which it is not"""
    middle_reach: tuple[float, float] = (0.0045, 0.006)
    """metres from the prop up to which a finger's middle bone is drawn to it, and from which it is not"""
    middle_share: float = 0.3
    """How firmly the middle bone is drawn, in parts of the fingertip's firmness"""
    loosened: float = 2.5
    """Factor of the expected errors of the landmarks of the pose that is corrected"""
    angle_sigma: float = math.radians(15.0)
    """radians: standard deviation of a finger's angles from those of the pose"""
    palm_gives_way: float = 0.002
    """metres of the palm's depth in the prop from which the wrist moves"""
    deepest_palm: float = 0.008
    """metres of the palm's depth in the prop from which on the wrist would have to move too far"""
    deepest_root: float = 0.02
    """metres of the depth of a finger's first bone in the prop from which on its knuckle would have to bend
    too far"""
    skin_reach: float = 0.008
    """metres from the prop, once fingers are roughly laid on it, in which the skin's vertices count"""
    tolerances: tuple[float, float] = (0.03, 0.003)
    """Relative decreases of the cost at which fingers are roughly laid on a prop, and at which they lie on
    it"""
    first_damping: float = 0.01
    margin: float = 0.04
    """metres around the hand, and around the middle of a finger, in which the prop's faces count"""


GRIPS: Final = GripSettings()
