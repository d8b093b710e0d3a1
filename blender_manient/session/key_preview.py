"""How many keys Simplify would leave: found in slices while the panel shows it, and used by the operator.

A preview belongs to an action, a state of its keys and the panel's settings. Whatever changes one of them
begins it anew, so that a slider can be dragged on. Keys that were changed without Blender having evaluated
them yet are not seen by the panel: the operator compares the keys themselves.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

import bpy

from handfit_core.common.errors import HandfitError, OptionError
from handfit_core.common.slices import map_yields, run_to_completion, slice_clock

from ..common import screen
from ..common.wording import capitalised
from ..scene.simplify import Bounds, Hand, Thinned, hands_to_simplify, state_of, thinning

_PAUSE = 0.02
"""seconds between two slices"""
_QUIET_SECONDS = 0.1
"""seconds from a slider's change to the first slice"""

_changes = 0
"""Counts changes of any action"""
_key: tuple[Any, ...] | None = None
_steps: Generator[None, None, list[Thinned]] | None = None
_found: list[Thinned] | str | None = None


def bounds_of(scene: bpy.types.Scene) -> Bounds:
    """Return the bounds of the simplification that the panel's sliders say."""
    settings = scene.manient
    parts = frozenset(part.lower() for part in settings.keys_parts)
    return Bounds(settings.keys_degrees, settings.keys_pixels, settings.keys_together, parts)


def preview(context: bpy.types.Context) -> list[Thinned] | str | None:
    """Return what Simplify would do, a `Thinned` for each hand, or a sentence why it cannot; None while a
    timer still computes it."""
    global _key, _steps, _found
    hands = hands_to_simplify(context)
    key = _key_of(context.scene, hands)
    if key != _key:
        _key, _steps, _found = key, _finding(hands, bounds_of(context.scene)), None
        if not bpy.app.timers.is_registered(_continue):
            bpy.app.timers.register(_continue, first_interval=_QUIET_SECONDS)
    return _found


def found_now(context: bpy.types.Context) -> list[Thinned]:
    """Return what Simplify does, a `Thinned` for each hand: the preview's where it was computed for the keys
    as they are now, else computed here. Raises what `thinning` raises."""
    hands = hands_to_simplify(context)
    if _key == _key_of(context.scene, hands) and isinstance(_found, list):
        now = [state_of(hand) for hand in hands]
        if all(one.made_of in now for one in _found):
            return _found
    return run_to_completion(_finding(hands, bounds_of(context.scene)))


def _finding(hands: list[Hand], bounds: Bounds) -> Generator[None, None, list[Thinned]]:
    if not hands:
        raise OptionError("no hand: select a captured hand, or a character")
    begun = []
    problem: HandfitError | None = None
    for hand in hands:
        try:
            begun.append(thinning(hand, bounds))
        except OptionError as error:  # one hand of a character may have no keys
            problem = error
        yield
    if problem is not None and not begun:
        raise problem
    found = []
    for steps in begun:
        found.append((yield from map_yields(steps, lambda: None)))
    return found


def _key_of(scene: bpy.types.Scene, hands: list[Hand]) -> tuple[Any, ...]:
    key: list[Any] = [_changes, bounds_of(scene)]
    for hand in hands:
        armature, bones = hand.rig.armature, tuple(hand.rig.bones)
        user, pose = armature.animation_data, armature.pose.bones
        action = user.action.name if user is not None and user.action is not None else ""
        modes = tuple(pose[bone].rotation_mode for bone in bones if bone in pose)
        key.append((armature.session_uid, action, bones, hand.parts, modes))
    return tuple(key)


def _continue() -> float | None:
    """Compute a slice of the preview; Blender's timer calls this.

    A timer knows no window, and so not which hand the panel shows: it goes on with the hands of the last
    redraw, unless something was changed since."""
    global _key, _steps, _found
    if _steps is None or _key is None or _key[0] != _changes:
        _key = _steps = None
        screen.redraw("VIEW_3D")  # which begins anew
        return None
    over = slice_clock()
    try:
        while not over():
            next(_steps)
        return _PAUSE
    except StopIteration as stop:
        _found = stop.value
    except HandfitError as error:
        _found = capitalised(str(error))
    except ReferenceError:  # the hand was deleted
        _key = None
    _steps = None
    screen.redraw("VIEW_3D")
    return None


def _after_change(_scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    if depsgraph.id_type_updated("ACTION"):
        _forget()


def _forget(*_: Any) -> None:
    global _changes
    _changes += 1


HANDLERS = {
    "depsgraph_update_post": _after_change,
    **dict.fromkeys(("undo_post", "redo_post", "load_post"), _forget),
}


TIMERS = (_continue,)


def unregister() -> None:
    """Forget the preview that was computed."""
    global _key, _steps, _found
    _key = _steps = _found = None
