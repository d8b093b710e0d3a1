"""A hand's shape follows its sliders: mesh, corrective shape keys, rest bones and keys together.

What a shape is made from lies on the armature: `manient.betas` and `manient.forearm` are what the artist
wants, the custom property `betas` and `manient.wrist` what rig and mesh have. Whenever these differ the hand
is reshaped: at once in the background, else a moment later, so that a dragged slider does not wait for every
step. Undo and redo bring back whole states of the file; should one lie in that moment, the same rule makes it
whole again.

Fingers keep their rotations and the wrist keeps its place: bones change their axes with the shape, so all
keys are written anew about the new axes. What the artist did to the mesh stays on it, since vertices are
moved by the difference of the two shapes.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from functools import lru_cache
from itertools import chain
from types import SimpleNamespace
from typing import Any

import bpy
import numpy as np

from handfit_core.common.errors import HandfitError, HandModelError, OptionError
from handfit_core.common.skeleton import NUM_BETAS
from handfit_core.edit.corrections import Correction
from handfit_core.hand_model import HandModel, ShapedHand, axes
from handfit_core.hand_model.axes import RestPose
from handfit_core.hand_model.files import kept_model
from handfit_core.hand_model.forearm import Wrist, with_wrist
from handfit_core.hand_model.shape_names import shape_names

from ..common.blender_versions import channels
from ..rigs.rig import Rig
from .actions import own_action, own_data
from .corrections import change_corrections, corrections_of
from .editable import check_editable
from .keys import pose_at, read_pose_keys, set_pose, write_pose_keys
from .mesh import corrective_names, follow_arm
from .own_scene import object_mode
from .simplify import all_actions, keeping_simplified
from .store import CapturedHand, hand_of

APPLIED = "betas"
"""Custom property of the armature with the shape that mesh and rig have now"""
_DELAY = 0.03
"""Seconds from a slider's change to the hand's"""

_waiting: set[int] = set()
"""The session_uid of each armature that is to be reshaped"""
_troubles: dict[int, str] = {}
_last_seconds = 0.0


def shape_changed(armature: bpy.types.Object) -> None:
    """Called whenever the hand is to have other betas, or a forearm or none: reshape it now (background) or
    very soon."""
    if is_current(armature):
        _troubles.pop(armature.session_uid, None)
        return
    if bpy.app.background:
        _reshape_or_note(armature)
        return
    _waiting.add(armature.session_uid)
    if not bpy.app.timers.is_registered(_catch_up):
        # A hand with very many keys takes its time: leave the window as much of it.
        bpy.app.timers.register(_catch_up, first_interval=max(_DELAY, _last_seconds))


def is_current(armature: bpy.types.Object) -> bool:
    """True if mesh and rig have the shape that the sliders say (or the object is no finished hand)."""
    if not armature.manient.is_hand or armature.get(APPLIED) is None:
        return True
    return _has_its_betas(armature) and _wanted_wrist(armature) == armature.manient.wrist


def _has_its_betas(armature: bpy.types.Object) -> bool:
    return np.allclose(list(armature[APPLIED]), list(armature.manient.betas), rtol=0.0, atol=1e-6)


def _wanted_wrist(armature: bpy.types.Object) -> Wrist:
    """Return the wrist that a hand is to have; an open one has no vertices for a cap or a forearm."""
    if armature.manient.wrist == "open":
        return "open"
    return "forearm" if armature.manient.forearm else "cap"


def trouble(armature: bpy.types.Object) -> str | None:
    """Return why the hand could not follow its sliders, one sentence for the panel; None where it did."""
    return _troubles.get(armature.session_uid)


def shape_names_of(hand: CapturedHand) -> tuple[str | None, ...]:
    """Return the names of the (10,) shape sliders, by what they do in the hand's model; None for those
    without a name, which all are where the model cannot be read. Cheap enough for drawing."""
    try:
        return _names(kept_model(hand.take.model, hand.side))
    except HandModelError:
        return (None,) * NUM_BETAS


_names = lru_cache(maxsize=4)(shape_names)


def reshape(armature: bpy.types.Object) -> None:
    """Give mesh and rig the shape of `armature.manient`, now.

    Data shared with other objects (linked duplicates) is made this hand's own first. Mode, active object and
    selection stay as they are. Raises HandModelError, OptionError and TakeError, and then changes nothing.
    """
    hand = hand_of(armature)
    if hand is None:
        raise OptionError(f"{armature.name!r} is no captured hand, so it has no shape to change")
    check_editable(armature)
    if armature.data.library is not None:
        raise OptionError(
            f"the bones of {armature.name!r} are linked from another file; make them local first"
        )
    plain = kept_model(hand.take.model, hand.side)
    wrist = _wanted_wrist(armature)
    old_model, model = with_wrist(plain, armature.manient.wrist), with_wrist(plain, wrist)
    mesh = hand.mesh
    if mesh is not None and len(mesh.data.vertices) != len(model.v_template):
        raise HandModelError(
            f"the mesh {mesh.name!r} has {len(mesh.data.vertices)} vertices, its hand model "
            f"{len(model.v_template)}; undo what changed them, or move the modifiers that you applied back"
        )
    corrections_of(armature)  # before anything is changed: they may not be readable
    before = old_model.shaped(np.array(armature[APPLIED]))
    betas = hand.betas
    after = model.shaped(betas)
    with object_mode():
        own_action(armature, nla=True)
        for obj in filter(None, (armature, mesh)):
            own_data(obj)
        old_rest = hand.rig.rest
        if not _has_its_betas(armature):
            _reshape_rig(hand.rig, after)
        rest = hand.rig.rest
        if mesh is not None:
            _reshape_mesh(mesh, hand.rig, (old_model, before, old_rest), (model, after, rest))
            if wrist != armature.manient.wrist:
                follow_arm(mesh, model, armature)
    _turn_corrections(armature, old_rest, rest)
    armature[APPLIED] = [float(b) for b in betas]
    armature.manient.wrist = wrist
    armature.update_tag()
    _troubles.pop(armature.session_uid, None)


def reset(hand: CapturedHand) -> None:
    """Give the hand its captured shape back. Raises as `reshape`."""
    hand.armature.manient.betas = np.asarray(hand.track.betas, dtype=np.float64).tolist()
    if not is_current(hand.armature):
        reshape(hand.armature)


def _reshape_or_note(armature: bpy.types.Object) -> None:
    global _last_seconds
    started = time.perf_counter()
    try:
        reshape(armature)
    except HandfitError as error:
        _note(armature, str(error))
    _last_seconds = time.perf_counter() - started


def _note(armature: bpy.types.Object, sentence: str) -> None:
    """Show a sentence in the panel and once in a popup, since a property cannot report."""
    if _troubles.get(armature.session_uid) == sentence:
        return
    _troubles[armature.session_uid] = sentence
    if bpy.app.background:
        print(f"Hand Capture: {sentence}", file=sys.stderr)
        return
    bpy.context.window_manager.popup_menu(
        lambda popup, _context: popup.layout.label(text=sentence), title="Hand Capture", icon="ERROR"
    )


def _catch_up() -> None:
    """Reshape the hands that wait; Blender's timer calls this, without a context of its own."""
    waiting = set(_waiting)
    _waiting.clear()
    windows = bpy.context.window_manager.windows
    if not windows:
        return
    with bpy.context.temp_override(window=bpy.context.window or windows[0]):
        for armature in [o for o in bpy.data.objects if o.session_uid in waiting]:
            if not is_current(armature):
                _reshape_or_note(armature)


def _after_time_travel(*_: Any) -> None:
    """Reshape hands that differ from their sliders: undo, redo and loading may end between a slider's change
    and the hand's."""
    for armature in [o for o in bpy.data.objects if o.type == "ARMATURE" and o.library is None]:
        if not is_current(armature):
            shape_changed(armature)


def _reshape_rig(rig: Rig, shaped: ShapedHand) -> None:
    """Give the rig new rest bones, and every key and the present pose about the new axes."""
    holders = filter(None, [channels(action, slot) for action, slot in all_actions(rig.armature)])
    kept = [(holder, read_pose_keys(rig, holder=holder)) for holder in holders]
    quats, locations = pose_at(rig, np.zeros(1), holder=_NOTHING)
    old = rig.rest
    rig.follow(shaped)
    new = rig.rest
    with keeping_simplified(rig.armature):
        for holder, keys in kept:
            turned = keys.turned(old, new)
            write_pose_keys(rig, turned, holder=holder)
            rig.allow(turned.quats)
    set_pose(rig, old.turned_to(new, quats)[0], old.moved_to(new, locations)[0])


_NOTHING = SimpleNamespace(fcurves=())
"""Stands for an action's channels without any curves: what the bones say beside their keys"""


def _turn_corrections(armature: bpy.types.Object, old: RestPose, new: RestPose) -> None:
    """Turn the corrections to the bones' new axes, about which they are kept; else they could not be taken
    out of the keys again."""
    turn = np.swapaxes(new.frames, -1, -2) @ old.frames

    def turned(c: Correction) -> Correction:
        return replace(
            c,
            rotation=(turn @ c.rotation[..., None])[..., 0],
            location=turn[0] @ c.location,
            start_rotation=(turn @ c.start_rotation[..., None])[..., 0],
            start_location=turn[0] @ c.start_location,
            pose=old.turned_to(new, c.pose) if np.any(c.pose) else c.pose,
            place=np.zeros(3),  # measured from another wrist; the rotations tell enough
        )

    change_corrections(all_actions(armature), turned)


def _reshape_mesh(
    obj: bpy.types.Object,
    rig: Rig,
    old: tuple[HandModel, ShapedHand, RestPose],
    new: tuple[HandModel, ShapedHand, RestPose],
) -> None:
    """Give the mesh a new shape; `old` and `new` are each the model with its wrist, its shape, and how the
    bones lie at rest."""
    (old_model, before, old_rest), (model, after, rest) = old, new
    mesh = obj.data
    moved = axes.points_to_rest(after.vertices - before.vertices)
    _move(mesh.vertices, moved)
    if mesh.shape_keys is not None:
        turned = {}
        if model.has_pose_blendshapes:
            change = _offsets(model, rest.frames.tobytes()) - _offsets(old_model, old_rest.frames.tobytes())
            keys = zip(
                chain.from_iterable(corrective_names(rig)), change.reshape(-1, *moved.shape), strict=True
            )
            turned = dict(keys)
        for key in mesh.shape_keys.key_blocks:
            _move(key.data, moved + turned.get(key.name, 0.0))
    mesh.update()


@lru_cache(maxsize=2)
def _offsets(model: HandModel, frames: bytes) -> np.ndarray:
    """Return the model's corrective offsets for a shape from a cache: the shape with which one step of a
    slider ends is that with which the next one begins."""
    return axes.corrective_offsets(model, np.frombuffer(frames).reshape(-1, 3, 3))


def _move(points: Any, moved: np.ndarray) -> None:
    co = np.empty((len(points), 3), dtype=np.float32)
    points.foreach_get("co", co.ravel())
    points.foreach_set("co", (co + moved).astype(np.float32).ravel())


HANDLERS = dict.fromkeys(("undo_post", "redo_post", "load_post"), _after_time_travel)
LISTENERS = {"shape": lambda group: shape_changed(group.id_data)}
TIMERS = (_catch_up,)


def unregister() -> None:
    """Forget the hands that wait to be reshaped."""
    _waiting.clear()
    _troubles.clear()
