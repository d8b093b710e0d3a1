"""How captured motion is put on a character: every option once, with its kind, range, default and help.

A character's properties (session/properties.py) and a batch's arguments (batch/character.py) are made of
these fields. Texts begin with a small letter and have no full stop.
"""
# ruff: noqa: RUF009 (what a dataclass's default calls here makes a field)

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal

import bpy
import numpy as np

from handfit_core.common.skeleton import SIDES, Side

from ..common.preferences import notifier
from ..common.wording import capitalised

Into = Literal["NEW", "STRIP", "ACTION"]
Wrist = Literal["FINGERS", "TURNED", "PLACED"]

OVERRIDABLE: Any = {"LIBRARY_OVERRIDABLE"}


@dataclass(frozen=True, eq=False)
class Anchor:
    """A moment in which a character's hand is as it is to be in the captured pose."""

    wrist: np.ndarray
    """(3, 3) how the captured wrist is turned from its rest, in rest space"""
    place: np.ndarray
    """(3,) metres: where it is"""
    hand: np.ndarray
    """(4, 4) the character's hand in the armature's space"""


def _option(
    default: Any,
    label: str,
    help: str,
    *,
    notifies: str = "character",
    items: Mapping[str, tuple[str, str]] | None = None,
    **bounds: Any,
) -> Any:
    """Return a field of the options with its `label` and further arguments for Blender's property, which
    `notifies` when it changes, and for a choice its `items` as identifier -> label and help."""

    about = {"label": label, "help": help, "notifies": notifies, "items": items, "bounds": bounds}
    return field(default=default, metadata=about)


@dataclass(frozen=True)
class TransferOptions:
    """How captured motion is transferred to a character."""

    into: Into = _option(
        "NEW",
        "Into",
        "what gets the keys",
        notifies="",
        items={
            "NEW": ("New Action", "A new action; the present one goes on in the NLA below it"),
            "STRIP": ("NLA Strip", "A new strip above all others; the present action stays as it is"),
            "ACTION": (
                "Present Action",
                "The present action: keys of the same bones and frames are replaced",
            ),
        },
    )
    wrist: Wrist = _option(
        "FINGERS",
        "Hand",
        "what of the hand's own motion is applied, beside its fingers",
        items={
            "FINGERS": ("Fingers Only", "The hand stays as it is"),
            "TURNED": ("Turned", "The hand turns as the captured one does from the marked frame on"),
            "PLACED": ("Turned and Moved", "It moves as the captured one does too, as large as it is"),
        },
    )
    reference: float = _option(
        1,
        "Marked Frame",
        "the scene frame in which the character's hand is as it is to be in the captured pose",
        notifies="hand_motion",
    )
    time_offset: int = _option(
        0,
        "Time Offset",
        "frames by which the captured motion comes later, for a character that moves already",
        soft_min=-1000,
        soft_max=1000,
    )
    contacts: bool = _option(
        True,
        "Keep Contacts",
        "where captured fingertips touch, the character's touch too: both fingers give way. Near a mesh that "
        "follows its hand by a Child Of constraint they lie on that",
    )
    travel: float = _option(
        1.0,
        "Travel",
        "how far the hand goes from where it is in the marked frame: 1 as far as the captured one, 0 not at "
        "all",
        notifies="hand_motion",
        min=0.0,
        max=2.0,
    )
    smoothing: int = _option(
        0,
        "Smoothing",
        "smooth how the hand itself turns and moves over so many frames before and after; fingers stay as "
        "they are",
        notifies="hand_motion",
        min=0,
        soft_max=20,
        max=1000,
    )
    arms: bool = _option(
        False,
        "Arms",
        "upper arm, forearm and hand follow the captured arm from the shoulder on, where one was captured, "
        "by FK or IK, whichever acts",
    )
    arms_influence: float = _option(
        1.0,
        "Influence",
        "how much of the captured arm there is: 0 leaves the character's arm as it is animated",
        min=0.0,
        max=1.0,
    )
    arms_ease: int = _option(
        10,
        "Ease",
        "frames within which the captured arm comes and goes, where the character's arm is animated "
        "otherwise",
        min=0,
        soft_max=50,
        max=1000,
    )
    arms_turn: float = _option(
        0.0,
        "Turn",
        "turn both captured arms about the character's vertical. Pictures hardly tell where a body faces: it "
        "may be 20 degrees off",
        min=-math.pi,
        max=math.pi,
        subtype="ANGLE",
    )
    arms_outside: bool = _option(
        False,
        "Keep Hands Outside the Body",
        "move hands that would sink into chest or face out of capsules, which stand for the character's "
        "trunk and head, towards the camera. Pictures hardly tell how far away a hand is: it may be 10 cm "
        "off",
    )
    offsets: Mapping[Side, np.ndarray] = field(default_factory=dict)
    """(3,) what is added to where a placed hand is, in the armature's space and units; none where missing"""
    anchors: Mapping[Side, Anchor] = field(default_factory=dict)
    """The anchor that stands for the marked frame, by the character's side; such hands get no offset"""

    @classmethod
    def of(cls, armature: bpy.types.Object, **changes: Any) -> TransferOptions:
        """Return the options of the character's panel, with these fields in place of its own."""
        shown = {name: getattr(armature.manient.character, name) for name in OPTIONS}
        return cls(**{**shown, "offsets": offsets_of(armature), **changes})


OPTIONS = {each.name: each for each in fields(TransferOptions) if each.metadata}
"""The fields that are options, by their names"""


def transfer_properties() -> dict[str, Any]:
    """Blender's property for each option, by its name."""
    kinds = {bool: bpy.props.BoolProperty, int: bpy.props.IntProperty, float: bpy.props.FloatProperty}
    found: dict[str, Any] = {}
    for name, option in OPTIONS.items():
        about, make = option.metadata, kinds.get(type(option.default), bpy.props.EnumProperty)
        more = {"name": about["label"], "description": capitalised(about["help"]), **about["bounds"]}
        if about["notifies"]:
            more["update"] = notifier(about["notifies"])
        if about["items"] is not None:
            more["items"] = [(item, *texts) for item, texts in about["items"].items()]
        found[name] = make(default=option.default, override=OVERRIDABLE, **more)
    return found


def add_argument(
    parser: argparse._ActionsContainer, name: str, flag: str, more: str = "", **how: Any
) -> None:
    """Add an option to a command line as `flag`. `more` ends its help; `how` are argparse's own arguments."""
    about = OPTIONS[name].metadata
    if about["items"] is not None:
        how["choices"] = [item.lower() for item in about["items"]]
    parser.add_argument(flag, help=about["help"] + more, **how)


def offsets_of(armature: bpy.types.Object) -> dict[Side, np.ndarray]:
    """Return (3,), by side, how far the artist has dragged each hand's offset, in the armature's space and
    units; nothing for hands without one."""
    found: dict[Side, np.ndarray] = {}
    for side in SIDES:
        handle = getattr(armature.manient.character, side).offset
        if handle is not None and handle.users_collection:  # deleted ones live on
            found[side] = np.array(handle.location, dtype=np.float64)
    return found
