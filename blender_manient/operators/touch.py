"""Touch: bring two points of a hand together over a range of frames, skin to skin."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from handfit_core.common.errors import OptionError
from handfit_core.common.skeleton import FINGERS
from handfit_core.edit import POINT_NAMES, touching_pair
from handfit_core.edit.corrections import Touches

from ..common.wording import counted
from ..scene.corrections import correct_frames
from ..scene.timing import frame_rate
from ..session.refiner import Refiner
from .base import polled_hand
from .refit_range import RangeFit, RangeFitOperator, rows_within, suggested_range

_MAX_TOUCH_GAP = 0.001
"""Metres between skins that count as touching, at most"""
_MAX_EXTRA_GAP = 0.005
"""Metres by which two points may be farther apart than on the present frame, in the frames around it that are
suggested"""
_SEARCH_SECONDS = 2.0
"""Seconds before and after the present frame in which such frames are looked for"""
_POINTS = [(str(point), name, f"The {name.lower()}") for point, name in enumerate(POINT_NAMES)]


class MANIENT_OT_touch(RangeFitOperator, bpy.types.Operator):
    """Make two points of the hand touch, skin to skin, over a range of frames: two fingers, or a finger and
    the palm. Other fingers stay; before and after it fades out over Spread. Asks for the points and the range
    first."""

    bl_label = "Touch"
    progress_text = "Making points touch"

    point: bpy.props.EnumProperty(name="Point", items=_POINTS, default="4")
    other: bpy.props.EnumProperty(name="Touches", items=_POINTS, default="8")

    _suggested: tuple[str, str] | None = None
    """The two points that the range was suggested for; None before"""

    def suggest(self, context):
        """Suggest the frames in which these points are nearly together; else those that Re-fit Range
        suggests."""
        self._suggested = self.point, self.other
        self.first, self.last = touching_range(context, int(self.point), int(self.other))

    def check(self, context):
        """Suggest frames anew for other points."""
        if self._suggested != (self.point, self.other):
            self.suggest(context)
        return super().check(context)

    def draw_properties(self):
        row = self.layout.row(align=True)
        row.prop(self, "point", text="")
        row.prop(self, "other", text="")

    def summary(self, context):
        """Return a sentence about how far apart the points are, and whether it is a warning."""
        gaps = _TouchFit(self, context).gaps
        if np.isnan(gaps).all():
            return "There is no hand in these frames", True
        return f"{counted(len(gaps), 'frame')}. {_far_apart(gaps, 'The points')} apart there", False

    def make_fit(self, context):
        return _TouchFit(self, context)

    def report_text(self, fit):
        return _touch_report(fit, " and ".join(POINT_NAMES[point] for point in fit.pair))


class MANIENT_OT_press_together(RangeFitOperator, bpy.types.Operator):
    """Press together, skin to skin, what lies over each other in the picture over a range of frames: thumb
    and fingers that cross, and fingertips on the palm. One camera cannot tell whether they touch: you can.
    Asks for the range first."""

    bl_label = "Press Together"
    progress_text = "Pressing together"

    def suggest(self, context):
        """Suggest the frames around the present one in which fingers lie over each other, or over the
        palm."""
        refiner, near = _refiner_near(context)
        touches = refiner.lying_over(refiner.keyed_poses(near.rows))
        self.first, self.last = near.around(np.array([not of_row for of_row in touches]), context)

    def summary(self, context):
        """Return a sentence about what would be pressed together and how far apart it is, and whether it is a
        warning."""
        fit = _PressFit(self, context)
        return f"{counted(fit.count, 'frame')}. {_far_apart(fit.gaps, fit.names)} apart there", False

    def make_fit(self, context):
        return _PressFit(self, context)

    def report_text(self, fit):
        return _touch_report(fit, fit.names)


class _Near:
    """The rows of a take within some seconds of the scene's current frame."""

    def __init__(self, scene: bpy.types.Scene, refiner: Refiner) -> None:
        self._frames, span = refiner.scene_frames(), _SEARCH_SECONDS * frame_rate(scene)
        now = scene.frame_current
        self._rows = rows_within(self._frames, now - span, now + span)
        self.rows: list[int] = self._rows.tolist()
        self.here = int(np.abs(self._frames[self._rows] - now).argmin()) if self.rows else -1
        """The current one's index among the rows"""

    def around(self, others: np.ndarray, context: bpy.types.Context) -> tuple[int, int]:
        """First and last scene frame of the rows around the current one that are not among the `others` (N,)
        bool; what Re-fit Range suggests where the current one is, and the preview range where it is used."""
        if context.scene.use_preview_range or not self.rows or others[self.here]:
            return suggested_range(context)
        far = np.flatnonzero(others)
        first = max([-1, *far[far < self.here]]) + 1
        last = min([len(self.rows), *far[far > self.here]]) - 1
        ends = self._frames[self._rows[[first, last]]]
        return round(float(ends[0])), round(float(ends[1]))


def _refiner_near(context: bpy.types.Context) -> tuple[Refiner, _Near]:
    refiner = Refiner(polled_hand(context).armature)
    return refiner, _Near(context.scene, refiner)


def touching_range(context: bpy.types.Context, point: int, other: int) -> tuple[int, int]:
    """First and last scene frame around the present one in which two points are about as near as here; the
    preview range where it is used. Raises HandfitError."""
    refiner, near = _refiner_near(context)
    try:
        first, second = touching_pair(point, other)
    except OptionError:
        return suggested_range(context)
    gaps = refiner.gaps(refiner.keyed_poses(near.rows), [{first: second}] * len(near.rows))
    far = ~(gaps <= gaps[near.here] + _MAX_EXTRA_GAP) if near.rows else gaps
    return near.around(far, context)


def _far_apart(gaps: np.ndarray, what: str) -> str:
    """Return how far apart these parts are, as gaps (N,) in metres have it, in words."""
    ends = 1000 * np.maximum([np.nanmin(gaps), np.nanmax(gaps)], 0.0)
    far = " to ".join(dict.fromkeys(f"{millimetres:.0f}" for millimetres in ends))
    return f"{what} are {far} mm"


def _touch_report(fit: _TouchFit, names: str) -> tuple[str, str]:
    """Return the kind and the text of the report of a fit in which these parts were to touch."""
    apart = np.flatnonzero(~(np.abs(fit.gaps) <= _MAX_TOUCH_GAP))
    if not len(apart):
        return "INFO", f"{names} touch in {counted(fit.fitted, 'frame')}"
    most = 1000 * np.nanmax(np.abs(fit.gaps))
    return "WARNING", (
        f"{names} stay up to {most:.0f} mm apart in {counted(len(apart), 'frame')}: other fingers or "
        "locked joints are in the way"
    )


class _TouchFit(RangeFit):
    """The frames of a range, fitted so that two points of the hand touch."""

    def __init__(self, operator: RangeFitOperator, context: bpy.types.Context) -> None:
        super().__init__(operator, context)
        refiner = self.refiner
        new = self.new_touches(operator)
        self.rows = self.rows[[bool(of_row) for of_row in new]]
        rows, self.count = self.rows.tolist(), len(self.rows)
        self._new = list(filter(None, new))
        """The points that are made to touch, for each frame"""
        start = refiner.start_poses(rows)
        self.gaps = refiner.gaps(start, self._new)
        """(N,) metres between what is to touch, at the widest"""
        self._touches = [{**refiner.touches(row), **new} for row, new in zip(rows, self._new, strict=True)]
        pins = list(map(refiner.pins, rows))
        self.requests = [(len(rows), refiner.request(rows, pins, start, touches=self._touches))]

    def new_touches(self, operator: Any) -> list[Touches]:
        """Return the touches that each frame of the range is to have; frames without any are left out. Raises
        OptionError."""
        self.pair = touching_pair(int(operator.point), int(operator.other))
        return [dict([self.pair])] * self.count

    def received(self, poses):
        super().received(poses)
        self.gaps = self.refiner.gaps(poses, self._new)[poses.present]

    def writing(self):
        there, poses = self.poses.present, self.poses
        correct_frames(
            self.refiner.armature,
            [self.refiner.source_frame(row) for row in self.rows[there]],
            poses.quats[there],
            poses.locations[there],
            self.spread,
            touches=[touched for touched, is_there in zip(self._touches, there, strict=True) if is_there],
        )
        yield 1.0


class _PressFit(_TouchFit):
    """The frames of a range in which parts lie over each other in the picture, fitted so that these touch."""

    def new_touches(self, operator):
        touches = self.refiner.lying_over(self.refiner.start_poses(self.rows.tolist()))
        if not any(touches):
            raise OptionError(
                "nothing lies over each other in these frames, no finger and thumb, no fingertip and palm: "
                "choose two points with Touch"
            )
        points = {abs(point) for of_row in touches for pair in of_row.items() for point in pair}
        fingers = sorted({(point - 1) // 4 % 6 for point in points})  # the palm, of point 0, is the last
        named = [(*FINGERS, "palm")[finger].capitalize() for finger in fingers]
        self.names = " and ".join(filter(None, (", ".join(named[:-1]), named[-1])))
        """Names of the fingers, and the palm, that are pressed together"""
        return touches
