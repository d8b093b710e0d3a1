"""Takes that were recorded live: keys of what was shown, the *preview*, until the recording is captured."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import bpy
import numpy as np

from handfit_core.capturing.options import CaptureOptions
from handfit_core.common.errors import HandfitError, OptionError, OutputError
from handfit_core.common.skeleton import SIDES, Side
from handfit_core.common.slices import map_yields
from handfit_core.hand_model.motion import HandMotion

from ..common import preferences
from ..common.blender_versions import action_slot, channels, first_slot
from ..common.block_reference import BlockReference
from ..scene import captures
from ..scene.actions import channels_of
from ..scene.build import BuiltTake
from ..scene.characters import hand_map_of
from ..scene.hand_motion import record_written_keys
from ..scene.keys import remove_pose_keys
from ..scene.live_hands import (
    AsSource,
    Followed,
    Target,
    building_preview,
    remove_action,
    remove_collection,
    set_aside,
)
from ..scene.onto_character import (
    Anchor,
    Into,
    Motion,
    TransferOptions,
    applying,
    computing,
    reading_motion,
    writing,
)
from ..scene.store import hand_of
from ..scene.timing import frame_rate
from . import jobs
from .cache import folder_path

_Moved = dict[BlockReference, list[tuple[Side, Motion]]]
"""The motions that hands of characters get, by character"""


@dataclass(eq=False)
class LiveTake:
    """A live recording, and the hands that were made from it."""

    number: int
    path: Path
    """The path of the recorded frames"""
    scene: BlockReference
    frame: float
    """The scene frame on which it begins"""
    options: CaptureOptions
    followed: Followed
    anchors: dict[Target, Anchor] = field(default_factory=dict)
    """Where turned hands of characters begin to follow, by character and side"""
    seconds: float = 0.0
    poses: list[tuple[float, dict[Side, HandMotion]]] = field(default_factory=list)
    """Seconds since the beginning, each with the hands that were shown then"""
    job: jobs.Job | None = None
    trouble: str = ""
    """Why there is no preview, a sentence; empty where there is one"""
    _made: list[BlockReference] = field(default_factory=list)
    """The collections of the preview, or of the hands that were captured"""
    _last: float = 0.0
    """The scene frame on which the preview ends"""
    _actions: dict[BlockReference, BlockReference] = field(default_factory=dict)
    """The action that was written to, by character"""

    @property
    def take_path(self) -> Path:
        """Return the path of the recording's take, beside it."""
        return self.path.with_suffix(".take.npz")

    @property
    def collections(self) -> list[bpy.types.Collection]:
        """Return the collections that the take has in the scene now."""
        return [found for made in self._made if (found := made.find()) is not None]

    def text(self) -> str:
        """Return the take's name and length, and how far its capture is."""
        job = self.job
        name = f"Take {self.number}: {self.seconds:.1f} s"
        if job is None or job.state == "waiting":
            return f"{name}, preview"
        if job.running:
            return f"{name}, {100.0 * job.fraction:.0f} %"
        return name if job.state == "done" else f"{name}, preview: {job.result.message}"

    def motions(self, rate: float) -> tuple[np.ndarray, dict[Side, HandMotion]]:
        """Return scene frames (T,) and the motions of the hands that were shown, at `rate` frames per
        second."""
        times = np.array([time for time, _ in self.poses])
        frames = self.frame + np.arange(max(1, round(float(times[-1] - times[0]) * rate) + 1))
        wanted = times[0] + (frames - self.frame) / rate
        rows = np.clip(np.searchsorted(times, wanted), 0, len(times) - 1)
        found = {}
        for side in SIDES:
            there = [self.poses[row][1].get(side) for row in rows.tolist()]
            first = next((hand for hand in there if hand is not None), None)
            if first is not None:
                gone = HandMotion(side, first.betas, *(np.full((1, n), np.nan) for n in (3, 45, 3)))
                pose = zip(*((hand or gone).pose for hand in there), strict=True)
                found[side] = HandMotion(side, first.betas, *(np.concatenate(parts) for parts in pose))
        return frames, found

    def previewing(self) -> Generator[None, None, None]:
        """Key what was shown while it was recorded, in slices."""
        scene = self.scene.find()
        if not self.poses or scene is None:
            self.trouble = "no hand was seen while it was recorded"
            return
        frames, motions = self.motions(frame_rate(scene))
        self._last = float(frames[-1])
        self.poses.clear()
        onto: _Moved = {}
        model = str(self.options.model)
        try:
            for side, motion in motions.items():
                target = self.followed[side]
                if target is None:
                    name = f"Take {self.number} preview"
                    self._made.append((yield from building_preview(scene, name, model, motion, frames)))
                else:
                    there = motion.present
                    seen = motion.with_pose(*(rows[there] for rows in motion.pose))
                    as_source = AsSource(model, seen).motion(seen, frames[there])
                    onto.setdefault(target[0], []).append((target[1], as_source))
            yield from map_yields(self._keying(onto), lambda: None)
        except HandfitError as error:
            self.trouble = str(error)
        except ReferenceError:
            self.trouble = "an undo has taken the preview away"

    def replacing(self, built: BuiltTake) -> Generator[float, None, None]:
        """Put what was captured in place of the preview, in slices."""
        for preview in self.collections:
            remove_collection(preview)
        self._made = [BlockReference.of("collections", built.collection)]
        onto: _Moved = {}
        for one in built.hands:
            target, hand = self.followed.get(one.side), hand_of(one.armature)
            if target is not None and hand is not None:
                motion = yield from map_yields(reading_motion(hand), lambda: 0.5)
                onto.setdefault(target[0], []).append((target[1], motion))
        try:
            yield from self._keying(onto)
        except HandfitError as error:  # the hands themselves are there
            self.trouble = str(error)

    def _keying(self, onto: _Moved) -> Generator[float, None, None]:
        """Key hands of characters in this take's own actions."""
        for character, moved in onto.items():
            armature = character.find()
            if armature is None:
                raise OptionError(f"the character {character.name!r} was deleted")
            hands = [(hand_map_of(armature, side), motion) for side, motion in moved]
            how = live_transfer(armature, character, [side for side, _ in moved], self.anchors)
            action = self._actions[character].find() if character in self._actions else None
            if action is None:
                yield from applying(armature, hands, how)
                self._actions[character] = BlockReference.of("actions", armature.animation_data.action)
                continue
            keys = (yield from computing(armature, hands, how)).keys
            data = armature.animation_data
            holder = channels_of(data) if data is not None and data.action == action else None
            if holder is None:  # the artist has another one in use
                holder = channels(action, first_slot(action), make=True)
            for one in keys:  # what the artist has keyed on other frames stays
                remove_pose_keys(one.rig, self.frame, self._last, holder=holder)
            yield from writing(keys, holder)
            for one in keys:
                record_written_keys(armature, action, action_slot(data) if data is not None else None, one)

    def set_aside(self, aside: bool) -> None:
        """Hide the take while hands follow that stand where it does, or show it again."""
        for collection in self.collections:
            set_aside(collection, aside)

    def throw_away(self) -> None:
        """Remove all that was made from the recording, and its files. Raises OutputError where a file
        cannot be removed."""
        while self.job is not None and not self.job.finished:
            jobs.cancel(self.job)  # the second time without keeping what is finished
        scene = self.scene.find()
        for collection in self.collections:
            if not collection.manient.is_capture:
                remove_collection(collection)
            elif scene is not None:
                captures.remove(scene, collection)
        for character, action in self._actions.items():
            armature, there = character.find(), action.find()
            if armature is not None and there is not None:
                remove_action(armature, there)
        takes.remove(self)
        for path in (self.path, self.take_path):
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                raise OutputError(f"{path}: could not be removed ({error.strerror or error})") from error


takes: list[LiveTake] = []
"""Recorded takes that were neither kept nor thrown away yet, the oldest first"""


def live_transfer(
    armature: bpy.types.Object,
    character: BlockReference,
    sides: Sequence[Side],
    anchors: dict[Target, Anchor],
    into: Into = "NEW",
) -> TransferOptions:
    """Return the options by which motion that was seen live goes onto hands of a character: as its panel
    says, but for arms, which are not seen live; hands without an anchor are not turned."""
    its = {side: anchors[character, side] for side in sides if (character, side) in anchors}
    how = TransferOptions.of(armature, into=into, arms=False, anchors=its, time_offset=0)
    return how if len(its) == len(sides) else TransferOptions(into=into, contacts=how.contacts)


def new_take(scene: BlockReference, options: CaptureOptions, followed: Followed) -> LiveTake:
    """Return the next take of the scene's folder, which begins on the present frame. Raises OutputError."""
    folder = planned_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"{folder}: recordings cannot be written here ({error.strerror or error}); choose another folder"
        ) from error
    number = 1 + max([0, *(int(p.stem[5:]) for p in folder.glob("take-*.mkv") if p.stem[5:].isdecimal())])
    path, frame = folder / f"take-{number:03d}.mkv", float(bpy.context.scene.frame_current)
    return LiveTake(number, path, scene, frame, options, followed)


def planned_folder() -> Path:
    """Return the path of the folder to which recordings will be written."""
    folder = bpy.context.scene.manient.live.folder
    if folder and (bpy.data.filepath or not folder.startswith("//")):
        return Path(preferences.full_path(folder))
    return folder_path().with_name("recordings")
