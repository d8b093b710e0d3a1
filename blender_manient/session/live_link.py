"""The live link: what changes on captured hands shows on the characters that follow them, and is keyed there.

Blender tells when a hand's armature has changed. At once, as when the link is switched on, the character
takes the pose that the hand shows in this frame; when nothing has changed for a moment, what differs from the
keys that the link has written before is written into the same action, in slices. Keys of the artist on other
frames of the character stay.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from typing import TypeVar

import bpy
import numpy as np

from handfit_core.common.errors import HandfitError, OptionError
from handfit_core.common.slices import map_yields, run_to_completion

from ..common import screen
from ..scene.characters import hands_to_move
from ..scene.editable import check_unlayered
from ..scene.hand_motion import BoneKeys, without_artist_keys
from ..scene.keys import nearest, remove_pose_keys, set_pose
from ..scene.onto_character import (
    Motion,
    TransferOptions,
    computing,
    is_keyframed,
    reading_motion,
    record_all_written_keys,
    writing,
    writing_anew,
)
from ..scene.sampling import rotations_of, shown_now
from .followers import Follower, Followers

_T = TypeVar("_T")

_QUIET_SECONDS = 0.2
"""Seconds without a change after which keys are written"""
_PROGRESS_REDRAWS = 10
"""How often the panel is redrawn while one set of keys is written"""
_COMPUTE_SHARE = 0.8
"""The share of the progress that computing the keys takes; writing them takes the rest"""
_SAME = 1e-6
"""Parts of quaternions, and of locations, that differ by less count as equal"""


class _Link(Follower):
    """A character that follows captured hands."""

    def __init__(self, armature: bpy.types.Object, *, shows: bool = False) -> None:
        super().__init__(armature)
        self.changed = time.monotonic() - _QUIET_SECONDS
        self.shows = shows
        """True if the pose is to be shown at once"""
        self.written: list[BoneKeys] | None = None
        """The keys that the link wrote last; None where they are unknown since an undo"""
        self.began = self.done = 0.0
        """The moment of `time.monotonic` at which keying began, and how much of it is done, 0..1"""


_settling = False
"""True if a property is being set by this module itself"""
_troubles: dict[int, str] = {}
"""By the session_uid of a character's armature, the reason, a sentence, why it follows no more"""


def trouble(armature: bpy.types.Object) -> str | None:
    """Return why a linked character does not follow, or not with keys, a sentence; None where it does."""
    return _troubles.get(armature.session_uid)


def keying_progress(armature: bpy.types.Object) -> float | None:
    """Return the progress of writing a linked character's keys, 0..1; None while none are written."""
    link = _links.get(armature.session_uid)
    return None if link is None or link.steps is None else link.done


def _go_on(link: _Link, armature: bpy.types.Object, is_over: Callable[[], bool]) -> None:
    if link.shows:
        link.shows = False
        _show(armature)
        return  # so that the window draws it before anything is keyed
    if link.steps is None:
        if not link.has_rested(_QUIET_SECONDS):
            return
        link.steps, link.began, link.done = _keying(link, armature), time.monotonic(), 0.0
    for done in link.steps:
        before, link.done = link.done, max(done, link.done)
        if int(_PROGRESS_REDRAWS * before) != int(_PROGRESS_REDRAWS * link.done):
            screen.redraw_sidebars()
        if is_over():
            return
    # Writing keys may itself look like a change: the next pass finds nothing to write then.
    link.steps = None
    screen.redraw_sidebars()
    _troubles.pop(armature.session_uid, None)
    if link.changed is None or link.changed < link.began:
        link.changed = None


def _fail(armature: bpy.types.Object, error: HandfitError | ReferenceError) -> None:
    gone = "the captured hand that this character follows was deleted: choose another one"
    _troubles[armature.session_uid] = gone if isinstance(error, ReferenceError) else str(error)


_links = Followers(_go_on, _fail, lambda armature: armature.manient.character.live)
step = _links.step


def _show(armature: bpy.types.Object) -> None:
    """Put the fingers where the captured hands show them now, unless they show that at another time."""
    check_unlayered(armature)
    if armature.manient.character.time_offset:
        return
    for hand_map, hand in hands_to_move(armature, bpy.context):
        rest, shown = hand.rig.rest, shown_now(hand.armature)
        basis = rotations_of(shown.basis()[0][[shown.names.index(name) for name in hand.rig.bones]])
        turns = rest.frames @ basis @ np.swapaxes(rest.frames, -1, -2)
        motion = Motion.of(hand, np.zeros(1), turns[None], np.zeros((1, 3)))
        onto = TransferOptions(contacts=armature.manient.character.contacts)
        for one in run_to_completion(computing(armature, [(hand_map, motion)], onto)).keys:
            quats = one.keys.quats[0]
            quats[~one.keyed] = np.nan
            set_pose(one.rig, quats)


def _keying(link: _Link, armature: bpy.types.Object) -> Generator[float, None, None]:
    """Key the hands' motion on the character where it differs from what the link keyed last; yields how much
    is done, 0..1."""
    character, hands = armature.manient.character, hands_to_move(armature, bpy.context)
    for _, hand in hands:
        if not is_keyframed(hand.rig):
            raise OptionError(
                f"{hand.armature.name} is moved by more than its keys (layers, constraints or controls), so "
                "that the link only shows its pose: press Apply to Character to key the motion"
            )
    onto = TransferOptions.of(armature, into="NEW")
    keys: list[BoneKeys] = []
    for number, (hand_map, hand) in enumerate(hands):
        before, share = _COMPUTE_SHARE * number / len(hands), _COMPUTE_SHARE / len(hands)
        motion = yield from map_yields(reading_motion(hand), lambda before=before: before)
        yield before
        computed = yield from _scaled_progress(computing(armature, [(hand_map, motion)], onto), before, share)
        keys += computed.keys
    if character.action is None:
        yield from _scaled_progress(writing_anew(armature, keys, "NEW"), _COMPUTE_SHARE, 1.0 - _COMPUTE_SHARE)
        character.action = armature.animation_data.action
    elif armature.animation_data is None or armature.animation_data.action is not character.action:
        raise OptionError(
            "this character has another action now: switch the link off and on to key a new one"
        )
    elif _digest(keys) != character.linked:
        for number, one in enumerate(keys):
            old = next((b for b in link.written or [] if b.rig.bones == one.rig.bones), None)
            share = (1.0 - _COMPUTE_SHARE) / len(keys)
            wanted = without_artist_keys(armature, one)
            steps = _written(armature, wanted if old is None else _changed(old, wanted))
            yield from _scaled_progress(steps, _COMPUTE_SHARE + number * share, share)
    link.written, character.linked = keys, _digest(keys)


def _written(armature: bpy.types.Object, one: BoneKeys) -> Generator[float, None, None]:
    """Write keys and note them; a hand itself has one bone, so that a stop cannot come between the two."""
    for done in writing([one]):
        record_all_written_keys(armature, [one])
        yield done


def _scaled_progress(
    steps: Generator[float, None, _T], before: float, share: float
) -> Generator[float, None, _T]:
    """Yield the progress `before + share * done` for each `done` that the steps yield; returns their
    result."""
    while True:
        try:
            done = next(steps)
        except StopIteration as stop:
            return stop.value
        yield before + share * done


def _changed(old: BoneKeys, new: BoneKeys) -> BoneKeys:
    """Return those new keys that differ from the old ones. Where keys are gone, all keys of their range are
    removed and all new keys there returned."""
    _, stays = nearest(new.keys.frames, old.keys.frames)
    gone = old.keys.frames[~stays]
    at, same = nearest(old.keys.frames, new.keys.frames)
    if len(gone):
        located = bool(old.keys.location_keyed.any())
        joints = np.flatnonzero(new.keyed).tolist()
        remove_pose_keys(new.rig, float(gone[0]), float(gone[-1]), joints=joints, location=located)
        same &= (new.keys.frames < gone[0]) | (new.keys.frames > gone[-1])
    alike = np.abs(np.sum(old.keys.quats[at] * new.keys.quats, axis=-1)) > 1.0 - _SAME
    there = np.abs(old.keys.locations[at] - new.keys.locations).max(axis=-1) < _SAME
    keys = replace(
        new.keys,
        rotation_keyed=new.keys.rotation_keyed & ~(alike & same[:, None]),
        location_keyed=new.keys.location_keyed & ~(there & same),
    )
    return replace(new, keys=keys)


def _digest(keys: Sequence[BoneKeys]) -> str:
    """Return a digest that changes with the keys that are to be written, beyond rounding."""
    sha = hashlib.sha256()
    for one in keys:
        sha.update("/".join(one.rig.bones).encode())
        for array in (one.keys.frames, one.keys.quats, one.keys.locations):
            sha.update((np.round(array, 5) + 0.0).tobytes())
    return sha.hexdigest()[:16]


def _on_update(_scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """Follow a change of something in the scene; changes of the frame alone do not come here."""
    if not _links:
        return
    moved = (u for u in depsgraph.updates if u.is_updated_geometry or u.is_updated_transform)
    changed = {update.id.original.session_uid for update in moved}
    for link in _links.values():
        armature = link.armature.find()
        if armature is None:
            continue
        character = armature.manient.character
        sources = [s for s in (character.left.source, character.right.source) if s is not None]
        if any({s.session_uid, s.data.session_uid} & changed for s in sources):
            link.shows, link.changed = True, time.monotonic()
            _links.wake()


def on_settings_changed(group: bpy.types.PropertyGroup) -> None:
    """Follow a change of a character's settings: whether it follows, whom, or how."""
    global _settling
    armature = group.id_data
    character, uid = armature.manient.character, armature.session_uid
    if _settling:
        return
    before = _links.pop(uid, None)
    _troubles.pop(uid, None)
    if character.live:
        _settling = True
        try:
            # From now on the same hands, whatever is captured or selected later.
            for hand_map, hand in hands_to_move(armature, bpy.context):
                getattr(character, hand_map.side).source = hand.armature
            data = armature.animation_data
            if data is None or data.action is not character.action:
                character.action = None
            _links[uid] = _Link(armature, shows=True)
            if before is not None and before.steps is None:
                _links[uid].written = before.written
        except HandfitError as error:
            _troubles[uid] = str(error)
        finally:
            _settling = False
        _links.wake()


def _on_time_travel(*_args) -> None:
    """Forget what is keyed: after another file, an undo or a redo nobody knows it."""
    _links.clear()
    for armature in bpy.data.objects:
        if armature.type == "ARMATURE" and armature.manient.character.live:
            _links[armature.session_uid] = _Link(armature)
            _links.wake()


HANDLERS = {
    **dict.fromkeys(("undo_post", "redo_post", "load_post"), _on_time_travel),
    "depsgraph_update_post": _on_update,
}
LISTENERS = {"character": on_settings_changed}
TIMERS = (step,)


def unregister() -> None:
    """Stop all characters from following."""
    _links.clear()
    _troubles.clear()
