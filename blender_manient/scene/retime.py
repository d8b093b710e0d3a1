"""Captures whose scene has another rate than that which they were built for: noticed, and built again for it.

What the artist did stays: keys are sampled from the present motion, and a corrected frame keeps its pose on
the nearest frame of the new rate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from handfit_core.capturing.retiming import (
    check_rate,
    is_other_rate,
    moved_keys,
    retimed,
    retimed_field,
    sampled,
)
from handfit_core.common.errors import OptionError
from handfit_core.common.files import is_file
from handfit_core.edit.corrections import changed_quats
from handfit_core.take import Take

from ..rigs.arm import ArmBones, has_arm
from ..rigs.rig import PosedBones
from .actions import present_curves
from .background import movie_plate, path_of, shown_file
from .confidence import is_marked, mark_doubtful
from .corrections import check_writable, corrections_of, keep_field
from .editable import check_unlayered
from .keys import (
    PoseKeys,
    align_signs,
    change_places,
    check_unlocked,
    is_smooth,
    pose_at,
    read_pose_keys,
    remove_pose_keys,
    write_pose_keys,
)
from .own_keys import keyed_by_hand, note_fitted
from .simplify import forget_all_keys
from .store import (
    CapturedHand,
    captured_take,
    clip_timing,
    describe_capture,
    hand_of,
    keep_take,
    kept_take,
    timing_of,
)
from .timing import Timing, frame_rate, nearest_rate, view_timing


def other_rate(scene: bpy.types.Scene, collection: bpy.types.Collection | None) -> float:
    """Return the frames per second of the scene that a capture was built for, where the scene has another
    rate by now; else 0. Cheap enough for drawing."""
    built = collection.manient.scene_rate if collection is not None else 0.0
    return built if built > 0.0 and is_other_rate(frame_rate(scene), built) else 0.0


def put_rate_back(scene: bpy.types.Scene, collection: bpy.types.Collection) -> None:
    """Give the scene the rate that the capture was built for."""
    scene.render.fps, scene.render.fps_base = nearest_rate(collection.manient.scene_rate)


def retime(scene: bpy.types.Scene, collection: bpy.types.Collection) -> list[str]:
    """Build a capture's hands and plate for the scene's present rate. Returns the hands' names.

    Raises HandfitError, and then has changed nothing.
    """
    kept, captured = kept_take(collection), captured_take(collection)
    rate, built = frame_rate(scene), collection.manient.scene_rate
    check_rate(rate)
    _check_clip(captured)
    hands = [h for h in map(hand_of, bpy.data.objects) if h is not None and h.collection == collection]
    hands = list({h.armature: h for h in hands}.values())
    for hand in hands:
        check_unlayered(hand.armature)
        check_writable(hand.armature)
        if has_arm(hand.armature):
            check_unlocked(ArmBones(hand.armature))
    ratio, number = rate / built, int(kept.frame_numbers[0])
    first = round(float(timing_of(collection).scene_frames(kept.frame_numbers[:1])[0]))
    marked = [hand for hand in hands if is_marked(scene, hand)]
    for hand in marked:
        mark_doubtful(scene, hand, False)
    keys = [_retimed_keys(hand, first, number, ratio) for hand in hands]
    arms = [
        _sampled(hand, ArmBones(hand.armature), first, ratio, np.zeros(0)) if has_arm(hand.armature) else None
        for hand in hands
    ]

    take = _retimed_take(kept, captured, rate)
    if not collection.manient.source_digest:
        collection.manient.source_take = collection.manient.take
        collection.manient.source_digest = collection.manient.digest
    keep_take(collection, take)
    if not is_other_rate(rate, captured.fps):
        collection.manient.source_take = collection.manient.source_digest = ""
    describe_capture(collection, collection.manient.camera, Timing(float(first - number)), rate)
    for hand, (new, field, fitted), arm in zip(hands, keys, arms, strict=True):
        _write(hand.armature, new, arm, first, ratio)
        keep_field(hand.armature, field)
        hand.armature.manient.fitted = ""
        numbers = [int(n) for n in new.frames[fitted] - first + number]
        turned, moved = field.at(np.array(numbers, dtype=np.float64))
        quats = changed_quats(new.quats[fitted], turned, np.zeros_like(turned))
        note_fitted(hand.armature, numbers, quats, new.locations[fitted] - moved)
    for hand in filter(None, (hand_of(each.armature) for each in marked)):
        mark_doubtful(scene, hand, True)
    clip = clip_timing(collection)
    _retime_plate(collection, captured, clip)
    if captured.cameras is not None:
        _retime_plate(collection, captured.view(1), view_timing(captured, clip))
    scene.frame_set(scene.frame_current, subframe=scene.frame_subframe)
    return [hand.armature.name for hand in hands]


def _check_clip(take: Take) -> None:
    path = Path(take.source.files[0])
    if take.source.kind == "video" and not is_file(path):
        raise OptionError(
            f"{path.name} is not there any more, so the picture cannot be retimed: put the clip back, or the "
            "scene's rate"
        )


def _retimed_take(kept: Take, captured: Take, rate: float) -> Take:
    """Return the captured take at the scene's rate, with the hands that only the kept one has."""
    other = is_other_rate(rate, captured.fps)
    take = retimed(captured, rate / captured.fps) if other else captured
    first = int(kept.frame_numbers[0])
    times = first + (np.asarray(take.frame_numbers) - first) * (kept.fps / take.fps)
    added = kept.hands[len(captured.hands) :]
    tracks = tuple(sampled(track, np.asarray(kept.frame_numbers), times) for track in added)
    return replace(take, hands=(*take.hands, *tracks), model_digests=kept.model_digests)


def _retimed_keys(hand: CapturedHand, first: int, number: int, ratio: float) -> tuple[PoseKeys, Any, Any]:
    """Return a hand's keys at the new rate, its corrections by the new numbers, and which (N,) of the keys'
    frames are no keys by hand."""
    old = corrections_of(hand.armature)
    new = retimed_field(old, number, ratio)

    def changed(own: np.ndarray, times: np.ndarray, quats: np.ndarray, places: np.ndarray) -> Any:
        turned_old, moved_old = old.at(times - first + number)
        turned, moved = new.at(own - first + number)
        return changed_quats(quats, turned_old, turned), places - moved_old + moved

    corrected = np.array(old.corrected) - number + first
    result = _sampled(hand, hand.rig, first, ratio, corrected, changed)
    rows = np.arange(len(hand.take.frame_numbers))
    by_hand = keyed_by_hand(hand, rows).any(axis=1)
    own = np.asarray(hand.take.frame_numbers)[by_hand] - number + first
    former = first + (result.frames - first) / ratio
    near = np.abs(former[:, None] - own).min(axis=1, initial=np.inf) < 1.0
    return result, new, result.rotation_keyed.all(axis=1) & result.location_keyed & ~near


def _sampled(
    hand: CapturedHand,
    bones: PosedBones,
    first: int,
    ratio: float,
    corrected: np.ndarray,
    changed: Callable[..., Any] = lambda _own, _times, quats, places: (quats, places),
) -> PoseKeys:
    """Return the keys of a hand's own bones or of its arm's at the new rate, of their present motion at that
    time.

    `changed` gets frames of the new keys, which frames they were, and the poses there, and gives the
    poses."""
    keys = read_pose_keys(bones)
    step = int(np.diff(hand.take.frame_numbers).min()) if len(hand.take.frame_numbers) > 1 else 1
    dense = np.inf if is_smooth(bones) else step + 0.5
    keyed = [*keys.rotation_keyed.T, keys.location_keyed]
    moved = [moved_keys(keys.frames[own], first, ratio, dense, corrected) for own in keyed]
    frames = np.unique(np.concatenate([f for f, _ in moved]))
    quats = np.tile([1.0, 0.0, 0.0, 0.0], (len(frames), len(moved) - 1, 1))
    locations, has = np.zeros((len(frames), 3)), np.zeros((len(frames), len(moved)), dtype=bool)
    for channel, (own, times) in enumerate(moved):
        at = np.searchsorted(frames, own)
        has[at, channel] = True
        turned, placed = changed(own, times, *pose_at(bones, times))
        if channel < len(moved) - 1:
            quats[at, channel] = turned[:, channel]
        else:
            locations[at] = placed
    return PoseKeys(frames, quats, locations, has[:, :-1], has[:, -1])


def _write(
    armature: bpy.types.Object, keys: PoseKeys, arm: PoseKeys | None, first: int, ratio: float
) -> None:
    """Give a hand and its arm these keys and no others; what else its action moves is stretched with them."""
    hand = hand_of(armature)
    assert hand is not None
    parts: list[tuple[PosedBones, PoseKeys]] = [(hand.rig, keys)]
    if arm is not None:
        parts.append((ArmBones(armature), arm))
    starts = tuple(f'pose.bones["{name}"].' for bones, _ in parts for name in bones.bones)
    for curve in present_curves(armature):
        if not curve.data_path.startswith(starts):
            change_places(curve, [ratio, 1.0], [first - first * ratio, 0.0])
    for bones, new in parts:
        remove_pose_keys(bones, -np.inf, np.inf)
        write_pose_keys(bones, new)
        align_signs(bones)
    data = armature.animation_data
    if data is not None and data.action is not None:
        forget_all_keys(data.action)  # they are of the former rate


def _retime_plate(collection: bpy.types.Collection, take: Take, clip: Timing) -> None:
    """Have all that shows the clip's picture for this capture show it at the new rate."""
    if take.source.kind != "video":
        return
    path, _ = shown_file(take)
    for image, user in list(_image_users(collection)):
        if image is not None and path_of(image) == path:
            movie_plate(image, take, clip).apply_timing(user)


def _image_users(collection: bpy.types.Collection) -> Iterator[tuple[Any, bpy.types.ImageUser]]:
    for camera in filter(None, (collection.manient.camera, collection.manient.view_camera)):
        for background in camera.data.background_images:
            yield background.image, background.image_user
    for obj in collection.objects:
        for slot in obj.material_slots:
            tree = slot.material.node_tree if slot.material is not None else None
            for node in tree.nodes if tree is not None else ():
                if node.type == "TEX_IMAGE":
                    yield node.image, node.image_user
