"""How far a captured hand is off, by its take, and bones coloured by it: green where they can be
trusted, red where they are likely elsewhere, grey where nothing is known.

That is how far each finger is likely to be off, in metres, where the solver gave it, else how far the hand
lies from what was detected, in parts of its length in the picture. It is said of the captured pose: frames
that the artist has corrected have none. Doubtful and filled frames are ranges and timeline markers, too.
"""

from __future__ import annotations

import contextlib
import json
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Literal

import bpy
import numpy as np

from handfit_core.common.skeleton import (
    JOINTS_BY_FINGER,
    KEYPOINT_SOURCE,
    NUM_JOINTS,
    PALM_KEYPOINTS,
    PARENTS,
)
from handfit_core.edit.corrections import CorrectionField
from handfit_core.take import HandTrack, Take
from handfit_core.take.fit_quality import (
    IN_PICTURE,
    Scale,
    error_is_known,
    expected_scale,
    length_in_picture,
    relative_errors,
    view_errors,
)

from .corrections import readable_corrections
from .store import CapturedHand, captured_hands, hand_of, rows_at, scene_frames

_CORRECTED: Final = 0.5
"""The weight of a correction, 0..1, from which on a frame counts as the artist's"""
_BONE_LEVELS: Final = (0.02, 0.05, 0.10)
"""Distances of a bone from the picture, over the hand's length, that are shown green, yellow and red: of all
keypoints of a good capture half are nearer than the first, and nine in ten nearer than the second"""

UNSEEN_COLOR: Final = (0.35, 0.35, 0.35)
_COLORS: Final = np.array([(0.10, 0.70, 0.20), (0.95, 0.80, 0.10), (0.90, 0.12, 0.08)])
"""The sRGB colours of good, fair and poor"""

_following = False
"""True if some hand shows its colours"""


@dataclass(frozen=True, eq=False)
class Errors:
    """How far off a hand is on its T frames; NaN where nothing was detected, and where it was corrected."""

    scale: Scale
    frames: np.ndarray
    """(T,) the scene frames"""
    bones: np.ndarray
    """(T, 16) how far each bone is off, in MANO's order"""
    bone_levels: tuple[float, float, float]
    """The errors of bones that are shown green, yellow and red"""
    doubtful: np.ndarray
    """(T,) bool: frames whose pose may well be wrong"""
    known: bool
    """True if anybody can tell how far off the hand was captured"""

    @property
    def mean(self) -> float | None:
        """Return the mean of the frames' errors that are not NaN; None where all are."""
        known = self.frames[np.isfinite(self.frames)]
        return float(known.mean()) if len(known) else None


def errors_of(hand: CapturedHand) -> Errors:
    """Return the errors of a captured hand, kept once they were computed."""
    return _errors(hand.take, hand.track, readable_corrections(hand.armature))


@lru_cache(maxsize=32)  # takes and corrections are kept as they are read, and every redraw asks
def _errors(take: Take, track: HandTrack, field: CorrectionField) -> Errors:
    own = [not field.corrections[frame].is_anchor for frame in field.frames.tolist()]
    captured = np.asarray(~(field.weights(take.frame_numbers)[:, own] >= _CORRECTED).any(axis=1))
    if track.expected_error is None:
        scale, levels = IN_PICTURE, _BONE_LEVELS
        frames, bones = relative_errors(track, take.intrinsics), bone_errors(take, track)
    else:
        scale = expected_scale(int(track.detected.sum()))
        levels = scale.levels
        frames = track.expected_error.mean(axis=1)
        bones = np.repeat(frames[:, None], NUM_JOINTS, axis=1)
        bones[:, JOINTS_BY_FINGER] = track.expected_error[..., None]
    doubtful = np.zeros(len(captured), dtype=bool) if track.doubtful is None else track.doubtful
    return Errors(
        scale=scale,
        frames=np.where(captured, frames, np.nan),
        bones=np.where(captured[:, None], bones, np.nan),
        bone_levels=levels,
        doubtful=captured & doubtful,
        known=error_is_known(track),
    )


@lru_cache(maxsize=8)
def errors_by_view(take: Take, track: HandTrack) -> tuple[float, ...]:
    """Return the result of `view_errors` for a take's hand, kept once it was computed."""
    return view_errors(take, track)


def bone_errors(take: Take, track: HandTrack) -> np.ndarray:
    """Return (T, 16), the mean distance of each bone's ends from their detected keypoints, over the hand's
    length in the picture; NaN in frames where the hand was not detected.

    A finger's bone has two ends, the wrist's six."""
    points = np.asarray(track.joints_3d)
    measured = np.asarray(track.detected, dtype=bool)
    errors = np.full((len(points), NUM_JOINTS), np.nan)
    points = points[measured]
    if len(points) == 0:
        return errors
    distance = np.linalg.norm(take.intrinsics.project(points) - track.keypoints_2d[measured], axis=-1)
    shown = length_in_picture(points, take.intrinsics)
    errors[measured] = np.stack([distance[:, ends].mean(axis=-1) for ends in _ENDS], axis=-1) / shown[:, None]
    return errors


def colors_of(errors: np.ndarray, levels: tuple[float, float, float]) -> np.ndarray:
    """Return the sRGB colours (..., 3), 0..1, of errors (...,); `levels` are the errors of green, yellow and
    red."""
    colors = np.stack([np.interp(errors, levels, _COLORS[:, i]) for i in range(3)], axis=-1)
    colors[np.isnan(errors)] = UNSEEN_COLOR
    return colors


def shown_changed(group: bpy.types.PropertyGroup) -> None:
    """Colour a captured hand's bones, or give them their own colours back: `Object.manient.show_confidence`
    has changed."""
    obj = group.id_data
    assert isinstance(obj, bpy.types.Object)
    hand = hand_of(obj)
    if obj.manient.show_confidence and hand is not None:
        _keep_colors(hand)
        _color(hand, bpy.context.scene.frame_current_final)
    else:
        _give_colors_back(obj)
    _follow()


def _color(hand: CapturedHand, frame: float) -> None:
    row = int(rows_at(hand.collection, hand.take, np.array([frame]))[0])
    errors = errors_of(hand)
    shown = np.full(NUM_JOINTS, np.nan) if row < 0 else errors.bones[row]
    bones = hand.armature.pose.bones
    for name, color in zip(hand.rig.bones, colors_of(shown, errors.bone_levels), strict=True):
        bone = bones.get(name)
        if bone is None:
            continue
        custom = bone.color.custom
        if bone.color.palette != "CUSTOM":
            bone.color.palette = "CUSTOM"
        # Blender keeps 8 bits; what is the same already is not set, which would have it evaluated again.
        if np.abs(color - np.array(custom.normal)).max() > 0.004:
            custom.normal = color
            custom.select = np.minimum(color + 0.25, 1.0)
            custom.active = np.minimum(color + 0.4, 1.0)


def _keep_colors(hand: CapturedHand) -> None:
    # On the object, as bones have their colours there: linked duplicates share the data.
    if hand.armature.manient.own_colors:
        return
    before = {}
    for name in hand.rig.bones:
        bone = hand.armature.pose.bones.get(name)
        if bone is not None:
            custom = bone.color.custom
            colors = [list(c) for c in (custom.normal, custom.select, custom.active)]
            before[name] = [bone.color.palette, *colors]
    hand.armature.manient.own_colors = json.dumps(before)


def _give_colors_back(obj: bpy.types.Object) -> None:
    armature = obj if obj.type == "ARMATURE" else obj.parent
    if armature is None or armature.type != "ARMATURE" or not armature.manient.own_colors:
        return
    # What was not written here gives no colors back: the .blend may come from anybody.
    with contextlib.suppress(ValueError, TypeError, AttributeError, RecursionError):
        for name, (palette, normal, select, active) in json.loads(armature.manient.own_colors).items():
            bone = armature.pose.bones.get(name)
            if bone is not None:
                custom = bone.color.custom
                custom.normal, custom.select, custom.active = normal, select, active
                bone.color.palette = palette
    armature.manient.own_colors = ""


def _shown(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    return [o for o in captured_hands(scene) if o.manient.show_confidence and o.manient.own_colors]


def _refresh(scene: bpy.types.Scene) -> None:
    for armature in _shown(scene):
        hand = hand_of(armature)
        if hand is not None:
            _color(hand, scene.frame_current_final)


def _on_frame(scene: bpy.types.Scene, *_args) -> None:
    # Before the frame is evaluated, so that the colours are evaluated with it. While a picture is rendered
    # the scene belongs to the renderer, which draws no bones.
    if _following and not bpy.app.is_job_running("RENDER"):
        _refresh(scene)


def _on_change(*_args) -> None:
    """Colour bones anew after another file or an undo: other hands may be shown, at another frame."""
    _follow()
    if bpy.context.scene is not None:
        _refresh(bpy.context.scene)


def _follow() -> None:
    """Follow the frame as long as some hand shows its colours: who looks costs time in every frame."""
    global _following
    _following = any(_shown(scene) for scene in bpy.data.scenes)


def _ends_of_bones() -> tuple[list[int], ...]:
    """Return for each bone, in MANO's joint order, the indices of the keypoints at its ends."""
    keypoint = {source: k for k, source in enumerate(KEYPOINT_SOURCE)}
    tails = {keypoint[j]: keypoint[j] + 1 for j in range(1, NUM_JOINTS)}  # the next one along the finger
    assert all(PARENTS[j] == 0 or tails[keypoint[PARENTS[j]]] == keypoint[j] for j in range(1, NUM_JOINTS))
    return (list(PALM_KEYPOINTS), *([keypoint[j], tails[keypoint[j]]] for j in range(1, NUM_JOINTS)))


_ENDS: Final = _ends_of_bones()

HANDLERS: Final = {
    **dict.fromkeys(("load_post", "undo_post", "redo_post"), _on_change),
    "frame_change_pre": _on_frame,
}
LISTENERS: Final = {"confidence": shown_changed}


def unregister() -> None:
    """Give all bones their colours back."""
    for scene in getattr(bpy.data, "scenes", ()):
        for armature in _shown(scene):
            armature.manient.show_confidence = False
    _errors.cache_clear()


Direction = Literal["PREVIOUS", "NEXT"]

_END = " End"


def doubtful_ranges(hand: CapturedHand) -> list[tuple[int, int]]:
    """Return the first and last scene frame of each run of frames whose pose may well be wrong, in order."""
    return _ranges(hand, errors_of(hand).doubtful)


def filled_ranges(hand: CapturedHand) -> list[tuple[int, int]]:
    """Return the first and last scene frame of each gap that was bridged, in order."""
    return _ranges(hand, hand.track.filled)


def next_doubtful(hand: CapturedHand, frame: int, direction: Direction) -> int | None:
    """Return the scene frame where the nearest doubtful range after (or before) scene frame `frame` begins;
    None where there is none.

    From within a range, the way back leads to its own first frame."""
    firsts = [first for first, _ in doubtful_ranges(hand)]
    if direction == "NEXT":
        return next((first for first in firsts if first > frame), None)
    return next((first for first in reversed(firsts) if first < frame), None)


def mark_doubtful(scene: bpy.types.Scene, hand: CapturedHand, on: bool) -> int:
    """Put timeline markers where the hand's doubtful and filled ranges begin, and where longer ones end; or
    take them away. Returns how many markers there are of this hand afterwards.

    Other markers stay. Markers of a hand are known by their names; where the scene has several captured
    hands of one side, by name and frame.
    """
    wanted = _wanted(hand)
    names = _names(hand)
    rivals = [o for o in captured_hands(scene) if o.manient.side == hand.side and o != hand.armature]
    for marker in list(scene.timeline_markers):
        if marker.name not in names:
            continue
        ours = (marker.frame, marker.name) in wanted
        if (ours and not on) or (not ours and not rivals):
            scene.timeline_markers.remove(marker)
    if not on:
        return 0
    there = {(marker.frame, marker.name) for marker in scene.timeline_markers}
    for frame, name in sorted(wanted - there):
        scene.timeline_markers.new(name, frame=frame)
    return len(wanted)


def is_marked(scene: bpy.types.Scene, hand: CapturedHand) -> bool:
    """True if the hand's ranges have their markers."""
    wanted = _wanted(hand)
    return any((marker.frame, marker.name) in wanted for marker in scene.timeline_markers)


def _wanted(hand: CapturedHand) -> set[tuple[int, str]]:
    """Return the hand's markers, (scene frame, name) each."""
    markers = set()
    for name, ranges in zip(_names(hand)[:2], (doubtful_ranges(hand), filled_ranges(hand)), strict=True):
        for first, last in ranges:
            markers.add((first, name))
            if last > first:
                markers.add((last, name + _END))
    return markers


def _names(hand: CapturedHand) -> tuple[str, str, str, str]:
    letter = hand.side[:1].upper()
    doubtful, filled = f"Doubtful {letter}", f"Filled {letter}"
    return doubtful, filled, doubtful + _END, filled + _END


def _ranges(hand: CapturedHand, flags: np.ndarray | None) -> list[tuple[int, int]]:
    if flags is None:
        return []
    frames = np.rint(scene_frames(hand.collection, hand.take)).astype(int)
    edges = np.diff(np.concatenate([[0], np.asarray(flags, dtype=np.int8), [0]]))
    firsts, lasts = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0) - 1
    return [(int(frames[a]), int(frames[b])) for a, b in zip(firsts, lasts, strict=True)]
