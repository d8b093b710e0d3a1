"""Where in the time of a character that moves already a capture of the same movement lies."""

from __future__ import annotations

from collections.abc import Generator, Sequence

import bpy
import numpy as np

from handfit_core.common.errors import OptionError
from handfit_core.retarget.hand_map import HandMap
from handfit_core.retarget.time_offset import FoundOffset, WristMotion, find_offset
from handfit_core.retarget.transfer import target_hand

from ..rigs.character import bones_of
from .characters import why_not_reachable
from .editable import check
from .keys import nearest
from .moving_body import moving_range
from .onto_character import Motion
from .sampling import rotations_of, sampling_unseen
from .timing import frame_rate, span_of

_LEAST_SURE = 0.3
"""The least certainty, 0..1, with which an offset must be found"""
_LONGEST = 50_000
"""The most frames in which an offset is looked for, which takes minutes"""


def finding_offset(
    armature: bpy.types.Object, hands: Sequence[tuple[HandMap, Motion]]
) -> Generator[float, None, FoundOffset]:
    """Return by how many frames captured hands have to come later to move as those of a character, whose own
    motion is looked at in all frames that have it; in steps that tell how much is done, 0..1. Nothing is
    changed.

    Raises HandModelError, and OptionError where nothing fits well enough.
    """
    check(armature, why_not_reachable(armature))
    scene = bpy.context.scene
    start, end = (round(frame) for frame in moving_range(armature) or span_of(scene))
    if end - start > _LONGEST:
        raise OptionError(
            f"{armature.name!r} moves for {end - start} frames, and an offset is looked for in {_LONGEST}: "
            "type it"
        )
    targets = []
    for hand_map, motion in hands:
        motion = motion.on(hand_map.side)
        targets.append((target_hand(bones_of(armature), hand_map, motion.source), motion))
    names = [target.hand_map.bones[0] for target, _ in targets]
    sampled = yield from sampling_unseen(armature, np.arange(start, end + 1), names)
    world = sampled.world[:, None]
    shown = world @ sampled.of(names)
    if not np.isfinite(shown).all() or not (np.linalg.det(shown[..., :3, :3]) > 0.0).all():
        raise OptionError(f"a hand of {armature.name!r} is nowhere in some frames: type the offset")
    rest = armature.data.bones
    pairs = []
    for index, (target, motion) in enumerate(targets):
        size = target.scale * np.cbrt(np.linalg.det(world[0, 0, :3, :3]))
        own = rotations_of(np.array(rest[names[index]].matrix_local))
        turns, places = rotations_of(shown[:, index]) @ own.T, shown[:, index, :3, 3] / size
        numbers = np.arange(round(motion.frames[0]), round(motion.frames[-1]) + 1)
        rows = nearest(motion.frames, numbers)[0]
        aligned = target.aligned @ motion.turns[rows, 0] @ target.aligned.T
        pairs.append(
            (WristMotion(int(numbers[0]), aligned, motion.places[rows]), WristMotion(start, turns, places))
        )
    found = find_offset(pairs, frame_rate(scene))
    if found.sure < _LEAST_SURE:
        raise OptionError(
            f"no offset was found at which the captured wrist surely moves as that of {armature.name!r}: "
            f"type it (the likeliest is {found.frames} frames)"
        )
    return found
