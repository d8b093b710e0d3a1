"""Touch: bring two points of a hand together over a range of frames, skin to skin."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from handfit_core.common.errors import HandfitError, OptionError
from handfit_core.edit import POINT_NAMES, touching_pair

from ..common.wording import capitalised, counted
from ..scene.corrections import correct_frames
from ..scene.timing import frame_rate
from ..session.refiner import Refiner
from .base import polled_hand
from .refit_range import RangeFit, RangeFitOperator, rows_within, suggested_range

_MAX_TOUCH_GAP = 0.001
"""metres between skins that touch"""
_MAX_EXTRA_GAP = 0.005
"""metres: frames around the present one in which the points are no farther apart than here and so much are
suggested"""
_SEARCH_SECONDS = 2.0
"""seconds before and after that are looked at for these"""
_POINTS = [(str(point), name, f"The {name.lower()}") for point, name in enumerate(POINT_NAMES)]


class MANIENT_OT_touch(RangeFitOperator, bpy.types.Operator):
    """Make two points of the hand touch, skin to skin, over a range of frames: two fingers, or a finger and
    the palm. Other fingers stay; before and after it fades out over Spread. Asks for the points and the range
    first."""

    bl_label = "Touch"
    progress_text = "Making points touch"

    point: bpy.props.EnumProperty(name="Point", items=_POINTS, default="4")  # type: ignore
    other: bpy.props.EnumProperty(name="Touches", items=_POINTS, default="8")  # type: ignore

    _suggested: tuple[str, str] | None = None
    """The points that the range was suggested for"""

    def suggest(self, context):
        """The frames in which these points are nearly together; else those that Re-fit Range suggests."""
        self._suggested = self.point, self.other
        self.first, self.last = touching_range(context, int(self.point), int(self.other))

    def check(self, context):
        """Suggest frames anew for other points."""
        if self._suggested != (self.point, self.other):
            self.suggest(context)
        return True

    def draw_properties(self):
        row = self.layout.row(align=True)
        row.prop(self, "point", text="")
        row.prop(self, "other", text="")

    def summary(self, context):
        """How far apart the points are."""
        try:
            gaps = _TouchFit(self, context).gaps
        except HandfitError as error:
            return capitalised(str(error)), True
        if np.isnan(gaps).all():
            return "There is no hand in these frames", True
        ends = 1000 * np.maximum([np.nanmin(gaps), np.nanmax(gaps)], 0.0)
        far = " to ".join(dict.fromkeys(f"{millimetres:.0f}" for millimetres in ends))
        return f"{counted(len(gaps), 'frame')}. The points are {far} mm apart there", False

    def make_fit(self, context):
        return _TouchFit(self, context)

    def other_properties(self) -> dict[str, Any]:
        return {"point": self.point, "other": self.other}

    def report_text(self, fit):
        names = " and ".join(POINT_NAMES[point] for point in fit.pair)
        apart = np.flatnonzero(~(np.abs(fit.gaps) <= _MAX_TOUCH_GAP))
        if not len(apart):
            return "INFO", f"{names} touch in {counted(fit.fitted, 'frame')}"
        most = 1000 * np.nanmax(np.abs(fit.gaps))
        return "WARNING", (
            f"{names} stay up to {most:.0f} mm apart in {counted(len(apart), 'frame')}: other fingers or "
            "locked joints are in the way"
        )


def touching_range(context: bpy.types.Context, point: int, other: int) -> tuple[int, int]:
    """First and last scene frame around the present one in which two points are about as near as here; the
    preview range where it is used. Raises HandfitError."""
    scene, refiner = context.scene, Refiner(polled_hand(context).armature)
    frames, around = refiner.scene_frames(), _SEARCH_SECONDS * frame_rate(scene)
    rows = rows_within(frames, scene.frame_current - around, scene.frame_current + around)
    try:
        pair = touching_pair(point, other)
    except OptionError:
        return suggested_range(context)
    if scene.use_preview_range or not len(rows):
        return suggested_range(context)
    here = int(np.abs(frames[rows] - scene.frame_current).argmin())
    gaps = refiner.gaps(refiner.keyed_poses(rows.tolist()), pair)
    far = np.flatnonzero(~(gaps <= gaps[here] + _MAX_EXTRA_GAP))
    first = max([-1, *far[far < here]]) + 1
    last = min([len(rows), *far[far > here]]) - 1
    if first > last:
        return suggested_range(context)
    return round(float(frames[rows[first]])), round(float(frames[rows[last]]))


class _TouchFit(RangeFit):
    """The frames of a range, fitted so that two points of the hand touch."""

    def __init__(self, operator: MANIENT_OT_touch, context: bpy.types.Context) -> None:
        self.pair = touching_pair(int(operator.point), int(operator.other))
        super().__init__(operator, context)
        rows, refiner = self.rows.tolist(), self.refiner
        start = refiner.start_poses(rows)
        self.gaps = refiner.gaps(start, self.pair)
        """(N,) metres between the two points"""
        point, other = self.pair
        self._touches = [{**refiner.touches(row), point: other} for row in rows]
        pins = list(map(refiner.pins, rows))
        self.requests = [(len(rows), refiner.request(rows, pins, start, touches=self._touches))]

    def received(self, poses):
        super().received(poses)
        self.gaps = self.refiner.gaps(poses, self.pair)[poses.present]

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
