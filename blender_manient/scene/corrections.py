"""Corrections of a captured hand: kept on the action whose keys hold them, and carried into these keys.

`handfit_core.edit.corrections` has the mathematics. Only keys within reach of a changed correction are ever
touched; what they hold besides the correction, by capture or by hand, stays on them.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import bpy
import numpy as np

from handfit_core.common.errors import OptionError, TakeError
from handfit_core.common.skeleton import NUM_JOINTS
from handfit_core.edit.corrections import (
    Correction,
    CorrectionField,
    Pins,
    Touches,
    changed_quats,
    changed_segments,
    correction_between,
    kept_frame,
)

from ..common.blender_versions import action_slot, channels, has_one_slot, property_group, slot_key
from ..common.block_reference import BlockReference
from ..rigs import rig_of
from ..rigs.rig import Rig
from . import store
from .actions import motion_user, own_action
from .editable import check_keyable
from .keys import (
    PoseKeys,
    check_unlocked,
    is_smooth,
    pose_at,
    read_pose_keys,
    remove_pose_keys,
    write_pose_keys,
    writing_pose_keys,
)
from .timing import Timing

MARK = "manient_corrections"
"""An action's custom property: slot handle (0 before Blender 4.4) -> the corrections that its keys hold, as
JSON"""
_IDLE = 2e-3
"""Radians and metres: a key that is no further from the line between its neighbours says nothing"""
_SNAP = 2e-3
"""Source frames within which keys are the same; keys' frames are not exact to the last digit"""


def timing_of(armature: bpy.types.Object) -> Timing:
    """Return where the source frames of the hand's capture lie in the scene."""
    capture = armature.manient.capture
    return store.timing_of(capture) if capture is not None else Timing()


def corrected_places(armature: bpy.types.Object) -> np.ndarray:
    """Return the scene frames (N,) with a correction, which may lie between whole ones; none where
    corrections cannot be read."""
    frames = readable_corrections(armature).corrected
    return timing_of(armature).scene_frames(np.array(frames, dtype=np.float64))


def corrected_frames(armature: bpy.types.Object) -> list[int]:
    """Return the scene frames with a correction, rounded and increasing, for drawing."""
    return [round(f) for f in corrected_places(armature).tolist()]


def corrections_of(armature: bpy.types.Object) -> CorrectionField:
    """Return the hand's corrections. Raises TakeError where they cannot be read."""
    return _read(corrections_text(armature))


def readable_corrections(armature: bpy.types.Object) -> CorrectionField:
    """Return the hand's corrections; none where they cannot be read."""
    try:
        return corrections_of(armature)
    except TakeError:
        return _NONE


_NONE = CorrectionField()


@lru_cache(maxsize=16)
def _read(text: str) -> CorrectionField:
    # Panels ask at every redraw.
    return CorrectionField.from_json(text)


def corrections_text(armature: bpy.types.Object) -> str:
    """Return the corrections that the hand's motion holds, as JSON; empty where there are none."""
    user = motion_user(armature)
    return "" if user is None else _text(user.action, action_slot(user))


def _text(action: bpy.types.Action, slot: Any) -> str:
    texts = property_group(action, MARK)
    # With slots or without, depending on the Blender that wrote it, one hand has one text.
    only = next(iter(texts.values()), "") if has_one_slot(action) else ""
    return str(texts.get(slot_key(slot), only))


def _keep(action: bpy.types.Action, slot: Any, field: CorrectionField) -> None:
    texts = {} if has_one_slot(action) else property_group(action, MARK)
    texts[slot_key(slot)] = field.to_json()
    texts = {key: text for key, text in texts.items() if text}
    if texts:
        action[MARK] = texts
    elif MARK in action:
        del action[MARK]


def check_writable(armature: bpy.types.Object) -> None:
    """Raise OptionError where corrections cannot be put into the hand's keys, HandModelError where it lacks
    bones."""
    check_keyable(armature)
    check_unlocked(rig_of(armature))


def correct_frames(
    armature: bpy.types.Object,
    frames: Sequence[float],
    quats: np.ndarray,
    locations: np.ndarray,
    spread: float,
    *,
    pins: Sequence[Pins] | None = None,
    touches: Sequence[Touches] | None = None,
    posed: bool = False,
) -> None:
    """Give N source frames poses, and their neighbours what is left of the change over `spread` frames.

    quats (N, 16, 4) as (w, x, y, z) relative to the bones' rest; locations (N, 3) metres along the wrist
    bone's axes; bones that are NaN stay as they are. Frames without keys get them. The corrections replace
    the frames' earlier ones, of which pins and touches stay where none are given. Corrections that are
    `displaced` are forgotten. `posed`: the poses do not come from pins, so that pins which come and go later
    leave them as they are; they are one, which begins with the first frame.
    Raises TakeError and what `check_writable` does, and then changes nothing.
    """
    rig, chosen = rig_of(armature), [kept_frame(frame) for frame in frames]
    old = corrections_of(armature)
    check_writable(armature)
    lost = displaced(armature)
    if lost:
        # Corrections are in other keys by now, out of which nobody can take them.
        old = old.without(lost)
        keep_field(armature, old)
    places = timing_of(armature).scene_frames(np.array(chosen, dtype=np.float64))
    now_quats, now_locations = pose_at(rig, places)
    present = read_pose_keys(rig, places.min(), places.max())
    rotated, located = present.keyed_at(places)
    turns, moves = np.isfinite(quats[..., 0]), np.asarray(np.isfinite(locations).all(axis=1))
    if is_smooth(rig) or (posed and len(chosen) > 1):
        ends = {chosen[0], chosen[-1]} if posed else chosen
        _key_ends(armature, sorted(ends), max(spread, 1.0), np.any(turns, axis=0), bool(moves.any()))
    write_pose_keys(rig, PoseKeys(places, now_quats, now_locations, turns & ~rotated, moves & ~located))
    quats = np.where(turns[..., None], quats, now_quats)
    locations = np.where(moves[:, None], locations, now_locations)

    turned, moved = old.at(np.array(chosen, dtype=np.float64))
    rotations = correction_between(changed_quats(now_quats, turned, np.zeros_like(turned)), quats)
    moved_by = locations - (now_locations - moved)
    new: dict[float, Correction] = {}
    for at, frame in enumerate(chosen):
        here_now = old.corrections.get(frame)
        before = None if here_now is None or here_now.is_anchor else here_now
        # What the neighbours' corrections do here now is where the pins began.
        start = (turned[at], moved[at]) if before is None else (before.start_rotation, before.start_location)
        if posed:
            start = rotations[at], moved_by[at]
        new[frame] = Correction(
            pins=old.pins(frame) if pins is None else pins[at],
            rotation=rotations[at],
            location=moved_by[at],
            spread=spread,
            added_key=not (rotated[at].any() or located[at]) if before is None else before.added_key,
            start_rotation=start[0],
            start_location=start[1],
            pose=quats[at],
            place=locations[at],
            keyed=here_now is not None and here_now.keyed,
            posed=posed or (before is not None and before.posed),
            touches=old.touching(frame) if touches is None else touches[at],
            begins=at == 0 if posed else before is not None and before.begins,
        )
    change_field(armature, old.having(new))


def clear_corrections(armature: bpy.types.Object, frames: Iterable[float] | None = None) -> int:
    """Take the corrections of these source frames (None: all) away again. Returns how many there were.

    Keys become what they would be without them. Keys that only a correction had put there go, unless
    something else has been done to them since. Corrections that are `displaced` are only forgotten. Raises
    TakeError and what `check_writable` does, and then changes nothing.
    """
    old = corrections_of(armature)
    check_writable(armature)
    wanted = set(old.corrected) if frames is None else {kept_frame(f) for f in frames}
    gone = sorted(wanted & set(old.corrected))
    lost = [g for g in gone if g in displaced(armature)]
    if lost:
        keep_field(armature, old.without(lost))
        for g in lost:
            gone.remove(g)
        old = corrections_of(armature)
    change_field(armature, CorrectionField() if frames is None else old.cleared(gone))
    added = [g for g in gone if old.corrections[g].added_key]
    for place in timing_of(armature).scene_frames(np.array(added)).tolist():
        _remove_idle_keys(armature, place)
    return len(gone) + len(lost)


def displaced(armature: bpy.types.Object) -> list[float]:
    """Return the corrected source frames whose keys are not the corrected ones any more: keys were moved to
    other frames, or another pose was keyed over them. Raises TakeError."""
    field = corrections_of(armature)
    return [g for g, *pose in _keyed_poses(armature, field) if not field.corrections[g].is_in(*pose)]


def forget_corrections(armature: bpy.types.Object) -> None:
    """Keep no corrections any more, and leave all keys as they are."""
    keep_field(armature, CorrectionField())


def change_field(armature: bpy.types.Object, new: CorrectionField) -> None:
    """Carry a changed field into the keys within its reach, and keep it on the hand."""
    rig = rig_of(armature)
    old = corrections_of(armature)
    timing = timing_of(armature)
    for segment in changed_segments(old, new):
        first, last = sorted(timing.scene_frames(np.array(segment)).tolist())
        keys = read_pose_keys(rig, first, last)
        places = _snapped(timing.source_frames(keys.frames), np.concatenate([old.frames, new.frames]))
        (turned_old, moved_old), (turned_new, moved_new) = old.at(places), new.at(places)
        # Keys at the end of the segment, where nothing changes, are not even written.
        turns = np.any(turned_old != turned_new, axis=-1)
        moves = np.any(moved_old != moved_new, axis=-1)
        quats = changed_quats(keys.quats, turned_old, turned_new)
        changed = replace(keys, quats=quats, locations=keys.locations - moved_old + moved_new)
        write_pose_keys(rig, changed.only(turns, moves))
    keep_field(armature, new)


def keep_field(armature: bpy.types.Object, new: CorrectionField) -> None:
    """Keep the field on the hand's action without touching keys: they hold what changed already."""
    own_action(armature)
    user = motion_user(armature)
    if user is not None:
        _keep(user.action, action_slot(user), new)


def change_corrections(used: Iterable[tuple[Any, Any]], change: Callable[[Correction], Correction]) -> None:
    """Change all corrections in these (action, slot), whose keys have changed alike. What cannot be read
    stays as it is."""
    for user in used:
        with contextlib.suppress(TakeError):
            field = _read(_text(*user))
            _keep(*user, CorrectionField({g: change(c) for g, c in field.corrections.items()}))


@contextlib.contextmanager
def adding_to_keys(armature: bpy.types.Object, used: Iterable[tuple[Any, Any]]) -> Iterator[None]:
    """Have something be added within on purpose to the keys of these (action, slot): corrections that were
    known by their keys' poses are known by the new ones afterwards."""
    known: list[tuple[tuple[Any, Any], CorrectionField, set[float]]] = []
    for user in used:
        with contextlib.suppress(TakeError):
            field = _read(_text(*user))
            poses = _keyed_poses(armature, field, holder=channels(*user))
            known.append((user, field, {g for g, *pose in poses if field.corrections[g].is_in(*pose)}))
    yield
    for user, field, frames in known:
        poses = _keyed_poses(armature, field, holder=channels(*user))
        new = {g: replace(field.corrections[g], pose=q, place=p) for g, q, p in poses if g in frames}
        _keep(*user, field.having(new))


@contextlib.contextmanager
def corrections_carried(armature: bpy.types.Object) -> Iterator[None]:
    """Carry corrections over to another action that the armature gets within. Frames that are corrected
    otherwise in that one get the poses and corrections that they have now."""
    field = readable_corrections(armature)
    held = [(g, *pose) for g, *pose in _keyed_poses(armature, field) if field.corrections[g].is_in(*pose)]
    yield
    for g, quats, location in held:
        one, before = field.corrections[g], corrections_of(armature).corrections.get(g)
        if before is None or _without_pose(before) != _without_pose(one):
            of_frame = {name: [getattr(one, name)] for name in ("pins", "touches")}
            pose = quats[None], location[None]
            correct_frames(armature, [g], *pose, one.spread, posed=one.posed, **of_frame)


def _without_pose(one: Correction) -> str:
    unknown = replace(one, pose=np.zeros_like(one.pose), place=np.zeros_like(one.place))
    return CorrectionField({0: unknown}).to_json()


def _keyed_poses(
    armature: bpy.types.Object, field: CorrectionField, holder: Any = None
) -> list[tuple[float, np.ndarray, np.ndarray]]:
    if not field.corrected:
        return []
    places = timing_of(armature).scene_frames(np.array(field.corrected, dtype=np.float64))
    return list(zip(field.corrected, *pose_at(rig_of(armature), places, holder=holder), strict=True))


def without_field(armature: bpy.types.Object, keys: PoseKeys) -> PoseKeys:
    """Return the keys as they would be without the hand's corrections. Raises TakeError."""
    field = corrections_of(armature)
    places = _snapped(timing_of(armature).source_frames(keys.frames), field.frames)
    turned, moved = field.at(places)
    quats = changed_quats(keys.quats, turned, np.zeros_like(turned))
    return replace(keys, quats=quats, locations=keys.locations - moved)


def end_corrections(
    armature: bpy.types.Object,
    frames: Sequence[float],
    *,
    whole: bool = False,
    joints: Sequence[int] = range(NUM_JOINTS),
    location: bool = True,
    keep_pins: bool = False,
) -> None:
    """Call this before source frames get other keys: corrections end there, and their frames' own go.

    The arguments are those of `CorrectionField.keyed_anew`. Keys around that hold a part of a correction
    which ends sooner now are changed. Corrections that cannot be read stay as they are.
    """
    field, data = readable_corrections(armature), armature.animation_data
    if not field.corrections or data.action is None:
        return
    change_field(
        armature, field.keyed_anew(frames, whole=whole, joints=joints, location=location, keep_pins=keep_pins)
    )


def replacing_poses(
    armature: bpy.types.Object, frames: Sequence[int], quats: np.ndarray, locations: np.ndarray
) -> Iterator[float]:
    """Key new poses: (N,) source frames, increasing, quats (N, 16, 4), wrist locations (N, 3) in metres.

    They contain the corrections of these frames, of which only the pins are left. Other corrections end
    where the range begins; all other keys stay. One bone per step, for a window that stays free; yields how
    much is done, 0..1. Raises OptionError where the hand goes away meanwhile, and what `check_writable` does.
    """
    reference = BlockReference.of("objects", armature)

    def find() -> Rig:
        armature = reference.find()
        if armature is None:
            raise OptionError("the hand is gone, so its keys cannot be written: undo what removed it")
        return rig_of(armature)

    def steps() -> Iterator[float]:
        armature = find().armature
        check_writable(armature)
        end_corrections(armature, frames, keep_pins=True)
        places = timing_of(armature).scene_frames(np.asarray(frames))
        yield from writing_pose_keys(find, PoseKeys.everywhere(places, quats, locations))

    return steps()


def _key_ends(
    armature: bpy.types.Object, frames: Sequence[float], spread: float, turns: np.ndarray, moves: bool
) -> None:
    """Key the present pose where corrections of source frames will have faded out, on bones (16,) that they
    turn, between keys: on curves with few keys they would else reach to the next one, however far it is."""
    rig = rig_of(armature)
    ends = np.unique([[frame - spread, frame + spread] for frame in frames])
    places = np.sort(timing_of(armature).scene_frames(ends))
    keys = read_pose_keys(rig)
    quats, locations = pose_at(rig, places)
    within = [
        (places > own.min(initial=np.inf)) & (places < own.max(initial=-np.inf))
        for own in (keys.frames[keyed] for keyed in (*keys.rotation_keyed.T, keys.location_keyed))
    ]
    rotated, located = keys.keyed_at(places)
    rotated = np.stack(within[:-1], axis=-1) & turns & ~rotated
    located = within[-1] & moves & ~located
    write_pose_keys(rig, PoseKeys(places, quats, locations, rotated, located))


def _snapped(places: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """Return the frames (N,) of keys, those that are as good as one of `frames` replaced by it."""
    if len(places) == 0 or len(frames) == 0:
        return places
    nearest = frames[np.argmin(np.abs(places[:, None] - frames), axis=1)]
    return np.where(np.abs(places - nearest) <= _SNAP, nearest, places)


def _remove_idle_keys(armature: bpy.types.Object, frame: float) -> None:
    """Take the keys of a scene frame away if the pose there stays the same without them. On Bezier curves
    they stay: the handles of their neighbours were shortened for them."""
    rig = rig_of(armature)
    if is_smooth(rig):
        return
    place = np.array([frame])
    quats, locations = pose_at(rig, place)
    remove_pose_keys(rig, frame, frame)
    quats_without, locations_without = pose_at(rig, place)
    turned = np.abs(correction_between(quats, quats_without)).max()
    if max(turned, np.abs(locations - locations_without).max()) > _IDLE:
        write_pose_keys(rig, PoseKeys.everywhere(place, quats, locations))


def _move_to_actions(*_: Any) -> None:
    """Move the text of corrections that earlier versions kept on the armature to the actions whose keys hold
    them, which had only its digest."""
    armatures = [o for o in bpy.data.objects if o.type == "ARMATURE" and o.manient.corrections]
    actions = list(bpy.data.actions)
    texts = [armature.manient.corrections for armature in armatures]
    texts += [str(property_group(action, "manient_simplified").get("corrections", "")) for action in actions]
    by_digest = {hashlib.sha256(text.encode()).hexdigest()[:16]: text for text in texts}
    for action in actions:
        marks = property_group(action, MARK)
        texts = {key: by_digest.get(str(mark), str(mark)) for key, mark in marks.items()}
        if texts := {key: text for key, text in texts.items() if text.startswith("{")}:
            action[MARK] = texts
        elif marks:  # digests of texts that are gone
            del action[MARK]
    for armature in armatures:
        armature.manient.corrections = ""


HANDLERS = dict.fromkeys(("load_post", "blend_import_post"), _move_to_actions)
