"""The take: the captured numbers, and what the captured hands do now, after the artist's work."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import bpy
import numpy as np
from mathutils import Matrix

from handfit_core.capturing.retiming import shown_rows
from handfit_core.common.batch import scatter
from handfit_core.edit.corrections import point_rows
from handfit_core.hand_model.motion import POSE_ARRAYS
from handfit_core.take import HandTrack, Take, at_rows

from ..scene.camera import CAMERA_AT_REST
from ..scene.confidence import errors_of
from ..scene.corrections import readable_corrections
from ..scene.keys import read_pose_keys
from ..scene.own_scene import object_mode, shown_in_pose, unseen_scene
from ..scene.sampling import of_bones, sample, stepped
from ..scene.store import CapturedHand, captured_take, rows_at, scene_frames
from .exporter import Exporter, HandObjects, Preset


class TakeExporter(Exporter):
    """Captured hands as a take file: `retaken` makes it of hands that keep their take."""

    name = "npz"
    label = "Hand Take"
    description = "The captured numbers, for other programs and later import"
    suffix = ".take.npz"
    writes = "captured"
    kept_endings = (".npz",)

    def write(self, path: Path, hands: Sequence[HandObjects], _preset: Preset, _final: Path, /) -> None:
        """Write the take that the hands make now."""
        path.write_bytes(retaken(cast("Sequence[CapturedHand]", hands)).to_bytes(compact=False))


def retaken(hands: Sequence[CapturedHand]) -> Take:
    """Return the take of captured hands of one collection, with their present shape and motion.

    global_orient, hand_pose, transl, joints_3d and the errors are computed anew in the take's frames, from
    what the rigs show there relative to the capture camera; detections stay. Frames in which nothing was
    detected but that have keys or a correction now count as filled. Hands that the artist deleted are left
    out. Of a retimed clip it has the frames that the scene shows. Raises HandModelError.
    """
    take, collection = hands[0].take, hands[0].collection
    scene = bpy.context.scene
    metres = scene.unit_settings.scale_length
    frames = scene_frames(collection, take)
    camera = hands[0].camera
    shown = shown_in_pose([*(hand.armature for hand in hands), camera])
    with object_mode(), unseen_scene("take") as unseen, shown:
        for hand in hands:
            unseen.collection.objects.link(hand.armature)
        if camera is not None:
            unseen.collection.objects.link(camera)
        tracks = tuple(_track(hand, frames, metres, unseen) for hand in sorted(hands, key=lambda h: h.index))
    return _of_pictures(replace(take, hands=tracks), captured_take(collection))


def _of_pictures(take: Take, captured: Take) -> Take:
    """Return a retimed take as one of the clip's own frames: those that the scene shows."""
    if captured.fps == take.fps:
        return take
    rows, numbers = shown_rows(take, np.asarray(captured.frame_numbers), take.fps / captured.fps)
    hands = tuple(at_rows(track, rows) for track in take.hands)
    return replace(take, fps=captured.fps, frame_numbers=numbers, hands=hands)


def _track(hand: CapturedHand, frames: np.ndarray, metres: float, scene: bpy.types.Scene) -> HandTrack:
    """Return one hand's track; `scene` holds it and the camera. `metres` per unit of the artist's scene."""
    model, betas, shaped = hand.model(), hand.betas, hand.shaped()
    posed = _posed_rows(hand)
    present = hand.track.present | posed
    quats, locations = _bones(hand, frames[present], metres, scene)
    pose = hand.rig.from_bones(shaped, quats, locations)
    joints = model.keypoints(betas, *pose)

    track = hand.track
    detected = np.asarray(track.detected, dtype=bool)
    joints_3d = scatter(joints, present, len(present))
    errors = np.linalg.norm(hand.take.intrinsics.project(joints_3d) - track.keypoints_2d, axis=-1)
    known, expected = errors_of(hand), track.expected_error
    field, numbers = readable_corrections(hand.armature), hand.take.frame_numbers
    placed, touches = point_rows([field.pins(n) for n in numbers], [field.touching(n) for n in numbers])
    if expected is not None:
        expected = np.where(np.isnan(known.frames)[:, None], np.nan, expected)
    return replace(
        track,
        betas=betas,
        **dict(zip(POSE_ARRAYS, (scatter(rows, present, len(present)) for rows in pose), strict=True)),
        joints_3d=joints_3d,
        reprojection_error=np.where(detected, errors.mean(axis=-1), np.nan),
        doubtful=None if track.doubtful is None else known.doubtful,
        expected_error=expected,
        filled=present & ~detected if (posed & ~track.present).any() else track.filled,
        placed=placed if track.added or np.isfinite(placed).any() else None,
        touches=touches if np.isfinite(touches).any() else None,
    )


def _posed_rows(hand: CapturedHand) -> np.ndarray:
    """Return (T,) bool: the take's rows that have keys or a correction."""
    keyed = read_pose_keys(hand.rig).frames
    rows = rows_at(hand.collection, hand.take, keyed)
    posed = np.zeros(len(hand.take.frame_numbers), dtype=bool)
    posed[rows[rows >= 0]] = True
    return posed | np.isin(hand.take.frame_numbers, list(readable_corrections(hand.armature).corrections))


def _bones(
    hand: CapturedHand, frames: np.ndarray, metres: float, scene: bpy.types.Scene
) -> tuple[np.ndarray, np.ndarray]:
    """Return quaternions (N, 16, 4) as (w, x, y, z) and wrist locations (N, 3) in metres, as if nothing but
    the bones' keys moved the hand before a camera that stands where capture cameras stand."""
    sampled = sample(hand.armature, frames, scene, hand.rig.bones)
    space = np.diag([metres, metres, metres, 1.0]) @ np.linalg.inv(_camera_frames(hand.camera, frames, scene))
    space = space @ sampled.world
    space[:, :3, 3] -= hand.rig.rest.origin
    return of_bones(hand.rig, replace(sampled, pose=space[:, None] @ sampled.pose))


def _camera_frames(camera: bpy.types.Object | None, frames: np.ndarray, scene: bpy.types.Scene) -> np.ndarray:
    """Return (N, 4, 4), the matrices to which the capture camera has been moved; without a camera, those of
    one that was not."""
    if camera is None:
        return np.broadcast_to(np.eye(4), (len(frames), 4, 4))
    found = []
    for depsgraph in stepped(scene, frames):
        shown = camera.evaluated_get(depsgraph)
        place, turn, _ = (shown.matrix_world @ CAMERA_AT_REST.inverted()).decompose()
        found.append(Matrix.LocRotScale(place, turn, None))
    return np.array(found, dtype=np.float64).reshape(-1, 4, 4)
