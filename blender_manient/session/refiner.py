"""Re-fitting frames of one captured hand through the worker: what is asked, and what becomes of the answer.

Used by the Edit Keypoints mode, Move Keypoint and Re-fit Range alike. Objects are named, never held: an
undo replaces them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import bpy
import numpy as np

from handfit_core.capturing.options import CaptureOptions
from handfit_core.common.batch import Batch
from handfit_core.common.errors import OptionError, TakeError
from handfit_core.common.skeleton import NUM_JOINTS, NUM_KEYPOINTS, Side
from handfit_core.edit import (
    RefineHand,
    gaps_between,
    landmark_points,
    lying_over,
    result_from_message,
    second_sight,
    to_message,
)
from handfit_core.edit.corrections import Pins, Touches, changed_quats, point_rows
from handfit_core.fit.solvers import SOLVERS
from handfit_core.hand_model import HandModel, ShapedHand
from handfit_core.hand_model.files import kept_model
from handfit_core.take import HandTrack, Take

from ..common.block_reference import BlockReference
from ..common.wording import capitalised
from ..scene import captures, corrections
from ..scene.editable import why_not_keyable
from ..scene.keys import displayed_pose, pose_at
from ..scene.own_keys import note_fitted
from ..scene.store import CapturedHand, hand_of, row_of_view
from . import jobs

_ON_ROW = 0.01
"""Scene frames: the scene stands on a source frame when it is no farther from it"""
_NEAREST = 1e-3
"""Metres before the camera; what is nearer, or behind it, is not seen"""


@dataclass(frozen=True, eq=False)
class BonePoses(Batch):
    """The poses of the bones in N frames; NaN rows where there is no hand."""

    quats: np.ndarray
    """(N, 16, 4) as (w, x, y, z), relative to the bones' rest"""
    locations: np.ndarray
    """(N, 3) metres along the wrist bone's axes"""
    landmarks: np.ndarray
    """(N, 21, 2) pixels of the picture: where the points that can be dragged lie"""

    @property
    def present(self) -> np.ndarray:
        """Return (N,) bool: the frames with a hand."""
        return np.asarray(np.isfinite(self.locations).all(axis=1))


class Refiner:
    """One captured hand that can be re-fitted.

    Rows are the take's frames, 0 to T - 1. Raises OptionError for what is no captured hand, TakeError for
    takes without detections, HandModelError where the hand model cannot be read.
    """

    def __init__(self, armature: bpy.types.Object) -> None:
        hand = hand_of(armature)
        if hand is None:
            raise OptionError(f"{armature.name!r} is no captured hand: select one, or capture it again")
        why = why_not_refinable(hand.track)
        if why is not None:
            raise TakeError(f"{armature.name!r}: {why}")
        self._reference = BlockReference.of("objects", armature)
        self.name = armature.name
        self.take, self.track = hand.take, hand.track
        self.side: Side = hand.side
        self.model: HandModel = kept_model(hand.take.model, hand.side)
        self._shaped: tuple[tuple[float, ...], ShapedHand] | None = None

    @property
    def hand(self) -> CapturedHand:
        """Return the hand as it is now. Raises OptionError where it is gone."""
        armature = self.armature_or_none
        hand = hand_of(armature) if armature is not None else None
        if hand is None:
            raise OptionError(f"the hand {self.name!r} is gone: select another captured hand")
        return hand

    @property
    def armature_or_none(self) -> bpy.types.Object | None:
        """Return the hand's armature, under whatever name it has now; None where it is gone."""
        return self._reference.find()

    @property
    def armature(self) -> bpy.types.Object:
        """Return the hand's armature. Raises OptionError where it is gone."""
        return self.hand.armature

    def shaped(self) -> ShapedHand:
        """Return the model in the hand's present shape; computed when that changes."""
        betas = self.hand.betas
        if self._shaped is None or self._shaped[0] != tuple(betas):
            self._shaped = tuple(betas), self.model.shaped(betas)
        return self._shaped[1]

    def scene_frames(self) -> np.ndarray:
        """Return (T,) scene frames of the take's rows."""
        return corrections.timing_of(self.armature).scene_frames(self.take.frame_numbers)

    def row_at(self, frame: float) -> int | None:
        """Return the row, an index, that a scene frame shows; None between and beyond the source's frames."""
        frames = self.scene_frames()
        row = int(np.argmin(np.abs(frames - frame)))
        return row if abs(frames[row] - frame) <= _ON_ROW else None

    def source_frame(self, row: int) -> int:
        """Return the source frame number of a row."""
        return int(self.take.frame_numbers[row])

    @property
    def cameras(self) -> tuple[bpy.types.Object, ...]:
        """Return the existing cameras of the capture's views, the first one's before the second one's; none
        where the first one's is gone. Raises OptionError where the hand is gone."""
        hand = self.hand
        if hand.camera is None:
            return ()
        second = hand.collection.manient.view_camera
        there = self.take.cameras is not None and second in captures.cameras_of(hand.collection)
        return (hand.camera, second) if there else (hand.camera,)

    def clip(self, view: int) -> Take:
        """Return the take, or for the second view its clip and camera."""
        return self.take.view(view) if view else self.take

    def row_of_view(self, frame: float) -> int | None:
        """Return the row of the second view's picture that is shown on a scene frame; None where it has
        none."""
        return row_of_view(self.hand.collection, frame)

    def motion_until(self, row: int, shown: int) -> np.ndarray:
        """Return (21, 2) pixels of the second view by which the captured hand moves from a row's moment to
        that of the picture in row `shown` of that view, up to half a frame away."""
        cameras = self.take.cameras
        assert cameras is not None
        there, camera = self.track.present, cameras.camera(1)
        ends = [r if 0 <= r < len(there) and there[r] else row for r in (row - 1, row + 1)]
        points = self.track.joints_3d[ends]
        if ends[0] == ends[1] or not (camera.seen_from(points)[..., 2] > _NEAREST).all():
            return np.zeros((NUM_KEYPOINTS, 2))
        numbers = np.asarray(self.take.frame_numbers)
        moments = (numbers[[*ends, row]] - numbers[0]) / self.take.fps
        before, after = camera.project(points)
        share = (cameras.seconds(1)[shown] - moments[2]) / (moments[1] - moments[0])
        return np.asarray(share * (after - before))

    def pins(self, row: int) -> Pins:
        """Return the pins of a row. Raises TakeError where corrections cannot be read."""
        return corrections.corrections_of(self.armature).pins(self.source_frame(row))

    def touches(self, row: int) -> Touches:
        """Return the touches of a row. Raises TakeError where corrections cannot be read."""
        return corrections.corrections_of(self.armature).touching(self.source_frame(row))

    def is_corrected(self, row: int) -> bool:
        """True if the row was re-fitted with pins or touches."""
        return self.source_frame(row) in corrections.corrections_of(self.armature).corrected

    def is_beside_correction(self, row: int) -> bool:
        """True if corrections of other frames move the hand in this row, so that it is no more what was
        detected."""
        field = corrections.corrections_of(self.armature)
        rotation, location = field.at(np.array([self.source_frame(row)]))
        return not self.is_corrected(row) and bool(rotation.any() or location.any())

    def keyed_poses(self, rows: Sequence[int]) -> BonePoses:
        """Return the poses that the keys have on these rows, corrections included."""
        quats, locations = pose_at(self.hand.rig, self.scene_frames()[list(rows)])
        return BonePoses(quats, locations, self.landmarks(quats, locations))

    def start_poses(self, rows: Sequence[int]) -> BonePoses:
        """Return the poses that pins on these rows are measured against: the keys, as they were before the
        rows' own pins.

        So a hand depends on where its pins are and not on the way there. What corrections of neighbouring
        frames did here stays in."""
        quats, locations = pose_at(self.hand.rig, self.scene_frames()[list(rows)])
        field = corrections.corrections_of(self.armature)
        for at, row in enumerate(rows):
            own = field.corrections.get(self.source_frame(row))
            if own is not None and not own.is_anchor and own.is_in(quats[at], locations[at]):
                quats[at] = changed_quats(quats[at], own.rotation, own.start_rotation)
                locations[at] += own.start_location - own.location
        return BonePoses(quats, locations, self.landmarks(quats, locations))

    def landmarks(self, quats: np.ndarray, locations: np.ndarray, view: int = 0) -> np.ndarray:
        """Return (N, 21, 2) pixels of a view: where the points lie of bones with rotations (N, 16, 4) and
        wrist locations (N, 3); NaN behind its camera."""
        pose = self.hand.rig.from_bones(self.shaped(), quats, locations)
        # Wherever armature and camera have been moved: the take's own frame is the picture's.
        points = landmark_points(self.model, self.hand.betas, *pose)
        intrinsics = self.take.intrinsics
        if view and self.take.cameras is not None:
            camera = self.take.cameras.camera(view)
            points, intrinsics = camera.seen_from(points), camera.intrinsics
        behind = points[..., 2] < _NEAREST
        points[behind] = [0.0, 0.0, 1.0]
        return np.where(behind[..., None], np.nan, intrinsics.project(points))

    def shown_landmarks(self, view: int = 0) -> np.ndarray:
        """Return (21, 2) pixels of a view: where the points of the bones lie as they stand now, keyed or
        not."""
        rig = self.hand.rig
        location = np.array(rig.armature.pose.bones[rig.bones[0]].location, dtype=np.float64)
        return self.landmarks(displayed_pose(rig)[None], location[None], view)[0]

    def request(
        self,
        rows: Sequence[int],
        pins: Sequence[Pins],
        poses: BonePoses,
        mode: Literal["each", "draft", "range", "grip"] = "each",
        smoothing: float = CaptureOptions.smoothing,
        touches: Sequence[Touches] | None = None,
    ) -> Callable[[], dict[str, Any]]:
        """Return a function that makes the fields of a `refit` request: these rows, their pins, the poses to
        start from.

        `touches`: None for those that are kept. The function asks nothing of Blender any more, so that for
        many frames its call can wait for a later moment."""
        shaped, rest, betas = self.shaped(), self.hand.rig.rest, self.hand.betas
        locked = np.array(self.armature.manient.locked, dtype=bool)
        rows = list(rows)
        touching = [self.touches(row) for row in rows] if touches is None else touches

        def fields() -> dict[str, Any]:
            places, others = point_rows(pins, touching)
            start = rest.from_bones(shaped, poses.quats, poses.locations)
            step, holes = _steps(np.asarray(self.take.frame_numbers), rows)
            hand = RefineHand(
                side=self.side,
                betas=betas,
                intrinsics=self.take.intrinsics,
                detections=self.track.detections_at(np.array(rows)),
                pins=places,
                global_orient=start[0],
                hand_pose=start[1],
                transl=start[2],
                locked=locked,
                model=self.take.model,
                fps=self.take.fps / step,
                smoothing=smoothing,
                holes=holes,
                added=self.track.added,
                touches=others if np.isfinite(others).any() else None,
                second=second_sight(self.take, self.track, np.array(rows)) if mode == "range" else None,
            )
            return {"mode": mode, "hand": to_message(hand)}

        return fields

    def poses(self, done: Mapping[str, Any], count: int = 1) -> BonePoses:
        """Return the poses of `count` frames in a `done` event, as the bones have them. Raises
        ProtocolError."""
        result = result_from_message(done, count)
        count = len(result.transl)
        quats = np.full((count, NUM_JOINTS, 4), np.nan)
        locations = np.full((count, 3), np.nan)
        at = result.present
        quats[at], locations[at] = self.hand.rig.to_bones(self.shaped(), *(rows[at] for rows in result.pose))
        landmarks = np.full((count, NUM_KEYPOINTS, 2), np.nan)
        landmarks[at] = self.landmarks(quats[at], locations[at])
        return BonePoses(quats, locations, landmarks)

    def gaps(self, poses: BonePoses, touches: Sequence[Touches]) -> np.ndarray:
        """Return (N,) metres between the skins at the points that touch in each of N poses, those of the
        widest gap; NaN where there is no hand, or nothing touches."""
        gaps, there = np.full(len(touches), np.nan), poses.present
        rows = np.array([row for row, of_row in enumerate(touches) for _ in of_row if there[row]], dtype=int)
        if len(rows):
            points = np.array([p for row in np.flatnonzero(there) for p in touches[int(row)].items()])
            pose = self._hand_poses(poses)[rows]
            np.fmax.at(gaps, rows, gaps_between(self.model, self.hand.betas, pose, points))
        return gaps

    def lying_over(self, poses: BonePoses) -> list[Touches]:
        """Return for each of N poses the touches of finger bones that cross the thumb in the picture, and of
        fingertips on the palm."""
        there, found = np.flatnonzero(poses.present), list[Touches]({} for _ in poses.locations)
        pose, pixels = self._hand_poses(poses)[there], poses.landmarks[there]
        touches = lying_over(self.model, self.hand.betas, pose, pixels)
        for row, of_row in zip(there.tolist(), touches, strict=True):
            found[row] = of_row
        return found

    def _hand_poses(self, poses: BonePoses) -> np.ndarray:
        """Return (N, 45) hand_pose, axis-angle in radians; NaN where there is no hand."""
        there, found = poses.present, np.full((len(poses.locations), 45), np.nan)
        bones = poses.quats[there], poses.locations[there]
        _, found[there], _ = self.hand.rig.from_bones(self.shaped(), *bones)
        return found

    def correct(self, row: int, pins: Pins, poses: BonePoses, spread: float) -> None:
        """Put the one pose that was re-fitted to `pins` into the keys, and let it fade out over `spread`
        frames."""
        at = [self.source_frame(row)], poses.quats, poses.locations
        corrections.correct_frames(self.armature, *at, spread, pins=[pins])

    def unpin(self, row: int) -> None:
        """Free all pins of a row: its pose becomes what it was before them."""
        frame = self.source_frame(row)
        own = corrections.corrections_of(self.armature).corrections.get(frame)
        if own is not None and own.posed:
            self.correct(row, {}, self.start_poses([row]), own.spread)
        else:
            corrections.clear_corrections(self.armature, [frame])

    def replacing(self, rows: Sequence[int], poses: BonePoses) -> Iterator[float]:
        """Put re-fitted poses of a range into the keys, bone by bone; yields how much is done, 0..1.

        Frames without a hand keep what keys they have.
        """
        there = poses.present
        chosen = [int(f) for f in np.asarray(self.take.frame_numbers)[list(rows)][there]]
        quats, locations = poses.quats[there], poses.locations[there]
        yield from corrections.replacing_poses(self.armature, chosen, quats, locations)
        note_fitted(self.armature, chosen, quats, locations)


def _steps(frame_numbers: np.ndarray, rows: Sequence[int]) -> tuple[int, tuple[int, ...]]:
    """Return every how many-th frame of the source a take has, and after which of the `rows` some are
    missing."""
    step = int(np.diff(frame_numbers).min()) if len(frame_numbers) > 1 else 1
    return step, tuple(int(at) for at in np.flatnonzero(np.diff(frame_numbers[list(rows)]) > step))


def why_not_refinable(track: HandTrack) -> str | None:
    """Return why the picture cannot tell how a hand is to be corrected, in a sentence; None where it can."""
    if not track.detected.any() and not track.added:
        return (
            "a mirrored hand is not in the picture: correct the hand that it was made from, and mirror that"
        )
    if not track.refinable:
        return "its take is an old one, which keeps no detections: capture the footage again"
    return None


def why_not_smoothable(hand: CapturedHand) -> str | None:
    """Return why nothing tells how a hand moves beside its keys, in a sentence; None where its keypoints
    do."""
    track, solver = hand.track, hand.take.solver
    if track.added:
        return "a hand that was added by hand has no keypoints of the footage to smooth: its keys are all"
    why = why_not_refinable(track)
    if why is None and solver not in SOLVERS.offered():
        why = f"its poses are those of {solver}, without keypoints of the footage that could be fitted anew"
    if why is None and track.detected.sum() == 1:
        why = "it is in one picture alone, which has no motion to smooth"
    return why


def smoothing_of(scene: bpy.types.Scene, armature: bpy.types.Object) -> float:
    """Return the strength of smoothing that a hand's keys have, as far as it is known; else the next
    capture's."""
    own = armature.manient
    return own.smoothing if own.is_property_set("smoothing") else scene.manient.smoothing


def why_not(context: bpy.types.Context, hand: CapturedHand | None) -> str | None:
    """Return why a hand cannot be refined now, a sentence for a tooltip; None where it can."""
    if hand is None:
        return "Select a captured hand: its armature or its mesh"
    why = why_not_keyable(hand.armature)
    if why is not None:
        return why
    why = why_not_refinable(hand.track)
    if why is not None:
        return capitalised(why)
    if jobs.busy():
        return "Wait for the capture to end, or cancel it"
    if context.mode not in ("OBJECT", "POSE"):
        return "Refining works in Object and Pose mode"
    return None
