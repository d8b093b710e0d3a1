"""A character that gets the motion of every input: its file, and how the motion is put on it."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import bpy

from handfit_core.common.errors import HandfitError, HandModelError, InputError, OptionError
from handfit_core.common.files import is_file, shown
from handfit_core.common.skeleton import SIDES, Side
from handfit_core.common.slices import run_to_completion
from handfit_core.retarget.hand_map import HandMap
from handfit_core.retarget.saved_rigs import SavedRig, read_rig, saved_rigs
from handfit_core.take import HandTrack, Take

from ..common.blender_versions import versions
from ..exporters.imports import animations, import_file, readable
from ..scene.characters import (
    CharacterObjects,
    characters_in,
    only_character,
    rig_used,
    sure_map_of,
    why_not_reachable,
    without_keys,
)
from ..scene.finding_offset import finding_offset
from ..scene.moving_body import moving_range
from ..scene.onto_character import applying, motion_of, shortcomings
from ..scene.timing import Timing, in_scene, set_timing, timing_in
from ..scene.transfer_options import Into, TransferOptions, Wrist, add_argument

_HANDS: dict[Side, str] = {"left": "left", "right": "right"}
"""For each of the character's hands, the captured hand that it gets where nobody says"""
_ENDINGS = (".blend", *readable())
_OPTIONS = ("bones", "wrist", "reference", "into", "time_offset", "no_contacts", "outside")
"""The arguments about a character beside its hands"""


def add_character_arguments(parser: argparse.ArgumentParser, *, required: bool = False) -> None:
    """Add the options of a character; `required`: whether one must be named."""
    group = parser.add_argument_group(
        "onto a character",
        "A character comes out with the motion, instead of the captured hands. For it, --hands says which of "
        "them each of its own hands gets: left, right, none, or a number in the order of report.json, as in "
        "--hands left=right,right=none (default: left=left,right=right). A choice of what is captured may "
        "stand beside it: --hands both,left=left.",
    )
    group.add_argument(
        "--apply-to",
        "--to",
        required=required,
        metavar="FILE[:ARMATURE]",
        help=f"the character's file ({', '.join(_ENDINGS)}), and its armature where there are several; no "
        "script in it is run",
    )
    group.add_argument(
        "--bones",
        metavar="RIG.json",
        help="which bones are its hands, as the panel's Export Rig writes it (default: those of your saved "
        "rig that fits, else those that are recognised)",
    )
    add_argument(group, "wrist", "--wrist", " (default: fingers)")
    first = ", for --wrist (default: the first with all hands)"
    add_argument(group, "reference", "--reference", first, type=float, metavar="FRAME")
    add_argument(group, "into", "--into", " (default: new)")
    found = ", or auto: where the captured wrists move as its hands do (default: 0)"
    add_argument(group, "time_offset", "--time-offset", found, metavar="FRAMES")
    add_argument(group, "arms_outside", "--outside", "; with --arms", action="store_true")
    add_argument(group, "contacts", "--no-contacts", "; with this they need not", action="store_true")


@dataclass(frozen=True, eq=False)
class Character:
    """A character's file, and how motion is put on it."""

    path: Path
    armature: str
    """The name of the armature; empty for the file's only one"""
    hands: Mapping[Side, str]
    """For each of the character's own hands, the captured one that it gets: left, right, or a number from
    1"""
    rig: SavedRig
    """The bones that a rig file names; of no hand where no file is given"""
    onto: TransferOptions
    reference: float | None
    finds_offset: bool = False
    """True if the offset in time is found, instead of taking that in `onto`"""

    @classmethod
    def of_arguments(cls, args: argparse.Namespace) -> Character | None:
        """Make a character of parsed arguments, None where they name none. Takes what is said of its hands
        out of `args.hands`, which is a capture's afterwards. Raises OptionError."""
        parts = (args.hands or "").split(",")
        said = {side: to for side, is_said, to in (part.partition("=") for part in parts) if is_said}
        args.hands = ",".join(part for part in parts if "=" not in part) or None
        if args.apply_to is None:
            given = [f"hands {part}" for part in parts if "=" in part]
            given += [name.replace("_", "-") for name in _OPTIONS if getattr(args, name) not in (None, False)]
            if given:
                raise OptionError(f"--{given[0]} is about a character: name its file with --apply-to")
            return None
        for side, wanted in said.items():
            if side not in SIDES or not re.fullmatch("left|right|none|[1-9][0-9]{0,3}", wanted):
                raise OptionError(
                    "--hands says which captured hand the character's left and right hand get: left, right, "
                    f"none or a number from 1, as in left=right,right=none; got {side}={wanted}"
                )
        offset = args.time_offset or "0"
        if not re.fullmatch("auto|[+-]?[0-9]{1,9}", offset):
            raise OptionError(f"--time-offset is a number of frames, or auto; got {shown(offset)}")
        path, armature = file_and_armature(args.apply_to)
        if path.suffix.lower() in _ENDINGS[1:]:
            args.format = args.format or readable()[path.suffix.lower()].name
        elif not path.suffix.lower().startswith(".blend"):
            raise OptionError(f"{shown(path)}: a character's file is one of {', '.join(_ENDINGS)}")
        file = Path(args.bones or "")
        rig = SavedRig(file.stem, tuple(read_rig(file)) if args.bones else ())
        onto = TransferOptions(
            into=cast(Into, (args.into or "new").upper()),
            wrist=cast(Wrist, (args.wrist or "fingers").upper()),
            time_offset=0 if offset == "auto" else int(offset),
            contacts=not args.no_contacts,
            arms=bool(getattr(args, "arms", False)),
            arms_outside=args.outside,
        )
        hands = cast(
            "dict[Side, str]", {side: to for side, to in said.items() if to != "none"} if said else _HANDS
        )
        return cls(path, armature, hands, rig, onto, args.reference, offset == "auto")

    def check(self) -> str | None:
        """Return the file of the user's saved rig that fits and is used, where none was given: what it says
        decides the results; None without one. Raises HandfitError where none of the wanted hands could get
        motion, whatever is captured."""
        armature, gone = self.open()
        problems = []
        for side in self.hands:
            try:
                self._bones_of(armature, side)
            except HandModelError as error:
                problems.append(str(error))
        if len(problems) == len(self.hands):
            problems = problems or ["--hands lets no hand of it have motion"]
            raise OptionError("; ".join([f"{shown(self.path)}: {problems[0]}", *problems[1:], *gone]))
        used = {None if self.rig.tables else rig_used(armature, side) for side in self.hands}
        return next((str(rig.path) for rig in used if rig is not None and len(used) == 1), None)

    @property
    def imported(self) -> bool:
        """True if the character's file is another program's."""
        return self.path.suffix.lower() in readable()

    def open(self) -> tuple[bpy.types.Object, list[str]]:
        """Open the file, or import it into the open scene. Returns the armature, and sentences about what is
        not as it should be.

        Nothing in the file is run: drivers that need Python stand still. Raises InputError and OptionError.
        """
        gone = []
        if self.imported:
            import_file(self.path)
        else:
            gone = self._open_blend()
        armature = self._armature(gone)
        why_not = why_not_reachable(armature)
        if why_not is not None:
            raise OptionError(f"{shown(self.path)}: {armature.name!r}: {why_not[:1].lower()}{why_not[1:]}")
        return armature, gone

    def _open_blend(self) -> list[str]:
        """Open the character's .blend file; returns sentences about linked files that are not there. Raises
        InputError."""
        name = shown(self.path)
        try:
            bpy.ops.wm.open_mainfile(filepath=str(self.path.absolute()), load_ui=True, use_scripts=False)
        except RuntimeError as error:
            reason = " ".join(str(error).removeprefix("Error: ").split())
            raise InputError(f"{name}: Blender could not open the character's file ({reason})") from error
        newer, own = versions()
        if newer > own:
            newer, own = (".".join(map(str, version)) for version in (newer, own))
            raise InputError(
                f"{name}: the character's file was saved by Blender {newer}, and this is {own}, which would "
                f"lose what is new in it: use Blender {newer} or later"
            )
        return [
            f"{name}: the file {shown(library.filepath)}, from which something in it is linked, is not there"
            for library in bpy.data.libraries
            if library.packed_file is None and not is_file(bpy.path.abspath(library.filepath))
        ]

    def put(self, take: Take, model: str | None) -> tuple[CharacterObjects, dict[str, Any], list[str]]:
        """Open the file and key a take on the character. The scene gets the take's rate and range, unless it
        moves already: then it keeps its time, and so do the hands; another program's file has both ranges.

        `model` is taken instead of the one that the take names. Returns what belongs to the character, what
        report.json says of it, and sentences about what is not as it should be. Raises HandfitError.
        """
        if self.imported:  # some files have no rate of their own
            set_timing(bpy.context.scene, take)
        armature, warnings = self.open()
        hands, told, alone = [], [], []
        scene, timing, (acting, left_out) = bpy.context.scene, Timing(), animations()
        moves = (self.imported and bool(acting)) or moving_range(armature) is not None
        if moves:  # frame 1 of both is the same moment
            first = 1.0 + timing_in(scene, take).scale * (int(take.frame_numbers[0]) - 1)
            take, timing, _ = in_scene(scene, take, first)
        elif len(take.frame_numbers) > 1:  # a picture has no rate, and is no reason to shorten a timeline
            set_timing(scene, take)
        for side, wanted in self.hands.items():
            try:
                track, hand_map = _track(take, wanted), self._bones_of(armature, side)
            except HandfitError as error:
                alone.append(f"the character's {side} hand was left alone: {error}")
                continue
            motion = motion_of(take, track, model)
            hands.append((hand_map, replace(motion, frames=timing.scene_frames(motion.frames))))
            rig = self.rig if self.rig.of(side) is not None else rig_used(armature, side)
            label = hand_map.rig if rig is None else rig.label
            told.append({"side": side, "captured": take.hands.index(track) + 1, "rig": label})
            if unkeyed := without_keys(armature, hand_map):
                told[-1]["without_keys"] = unkeyed
        if not hands:
            raise OptionError("; ".join(alone))
        entry: dict[str, Any] = {"armature": armature.name, "hands": told}
        offset = self.onto.time_offset
        if self.finds_offset:
            found = run_to_completion(finding_offset(armature, hands))
            offset, entry["offset"] = found.frames, {"frames": found.frames, "sure": round(found.sure, 2)}
        reference = self.reference
        if reference is None:
            reference = max(float(motion.frames[0]) for _, motion in hands) + offset
        onto = replace(self.onto, reference=reference, time_offset=offset)
        applied = run_to_completion(applying(armature, hands, onto))
        for hand, one in zip(told, applied, strict=True):
            hand |= {"bones": one.bones, "frames": one.frames, "tips_apart": round(one.apart, 5)}
        warnings += [*shortcomings(applied), *(() if self.rig.tables else saved_rigs()[1])]
        first, last = (round(end) + offset for end in timing.scene_frames(take.frame_numbers[[0, -1]]))
        if self.imported and acting:
            ends = [first, last, *(end for action in acting for end in action.frame_range)]
            scene.frame_start, scene.frame_end = math.floor(min(ends)), math.ceil(max(ends))
        elif moves and not scene.frame_start <= first <= last <= scene.frame_end:
            warnings.append(
                f"the hands move in frames {first} to {last}, and files hold those of the scene, "
                f"{scene.frame_start} to {scene.frame_end}"
            )
        if self.imported and left_out:
            warnings.append(
                f"{shown(self.path)}: of its animations .blend files alone keep "
                f"{', '.join(sorted(action.name for action in left_out))}, as nothing in the scene shows it"
            )
        scene.frame_set(first)
        if bpy.app.autoexec_fail_message.startswith("Driver"):
            warnings.append(
                f"{shown(self.path)}: drivers that need Python stand still, as no script of the file is run "
                f"({bpy.app.autoexec_fail_message})"
            )
        maps, objects = self.rig.tables, CharacterObjects.of(armature)
        return replace(objects, hand_maps=maps, imported=self.imported), entry, [*alone, *warnings]

    def _armature(self, gone: list[str]) -> bpy.types.Object:
        """Return the armature that was named, or the only one, or the only one that deforms or carries a
        mesh."""
        there = characters_in(bpy.context.scene)
        found = [one for one in there if one.name == self.armature or not self.armature]
        if (only := only_character(found)) is not None:
            return only
        names = ", ".join(one.name for one in there[:20])
        if not there:
            problem = "there is no armature in its open scene"
        elif self.armature:
            problem = f"there is no armature {shown(self.armature)!r}; choose from {names}"
        else:
            problem = (
                f"there are several armatures ({names}); name one, as in {self.path.name}:{there[0].name}"
            )
        raise OptionError("; ".join([f"{shown(self.path)}: {problem}", *gone]))

    def _bones_of(self, armature: bpy.types.Object, side: Side) -> HandMap:
        """Return the bones of the armature's hand of that side. Raises HandModelError."""
        hand_map = self.rig.of(side) or sure_map_of(armature, side)
        hand_map.check(armature.data.bones)
        return hand_map


def _track(take: Take, wanted: str) -> HandTrack:
    """Return the hand of a take that is meant by left, right or a number. Raises OptionError."""
    if wanted.isdecimal():
        found = list(take.hands[int(wanted) - 1 : int(wanted)])
    else:
        found = [track for track in take.hands if track.side == wanted]
    found = [track for track in found if track.present.any()]
    if len(found) > 1:
        numbers = ", ".join(str(take.hands.index(track) + 1) for track in found)
        raise OptionError(
            f"several {wanted} hands were captured: choose one by its number with --hands, of {numbers}"
        )
    if not found:
        raise OptionError(
            f"no {wanted} hand was captured" if wanted in SIDES else f"no hand {wanted} was captured"
        )
    return found[0]


def file_and_armature(text: str) -> tuple[Path, str]:
    """Split FILE[:ARMATURE] in two; both may have colons in them. Raises OptionError."""
    for at in (len(text), *(i for i, letter in enumerate(text) if letter == ":")):
        if is_file(text[:at]):
            return Path(text[:at]), text[at + 1 :]
    raise OptionError(f"{shown(text)}: there is no such character's file")
