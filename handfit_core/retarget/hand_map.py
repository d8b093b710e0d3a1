"""The table that says which bones of a character are a hand, as an artist sees it and as a preset file holds
it."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final, cast

from handfit_core.common.errors import HandModelError
from handfit_core.common.files import read_file, shown, why
from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, JOINT_NAMES, NUM_JOINTS, SIDES, Side

PALM_FINGERS: Final = FINGERS[1:]
"""The fingers that have a metacarpal bone in some rigs, in the order of `HandMap.palm`"""

USUAL_THUMB_ROLL: Final = 30.0
"""degrees: default of `HandMap.thumb_roll`. Thumbs of Rigify's metarig, VRM's T-pose and Mixamo need this
within 6 degrees, since they rest with the nail turned farther away from the hand's back than ours"""

_MAX_NAME_LENGTH: Final = 256
"""Most characters of a bone's name; Blender's own limit is 63 bytes"""
_MAX_PRESET_BYTES: Final = 1_000_000
"""Most bytes of a preset, and characters of a table; a preset with 63 bytes for every bone's name has some 4
000"""
_RANGES: Final = {"thumb_roll": (-360.0, 360.0), "fold": (0.0, 1.0)}


@dataclass(frozen=True)
class HandMap:
    """The names of the bones of one hand of a character. The empty name stands for a bone that is not
    there."""

    side: Side
    bones: tuple[str, ...]
    """16 names, by MANO's joints: the bone that begins at that joint, the hand's own first. Toon hands leave
    joints out; one bone may stand for the same joint of several fingers, and takes their mean"""
    palm: tuple[str, str, str, str] = ("", "", "", "")
    """Names of the metacarpal bones of index, middle, ring and little finger"""
    control: str = ""
    """Name of the bone that moves the whole hand; empty: the hand's own"""
    rig: str = ""
    """The kind of rig that was recognised, as an artist reads it"""
    thumb_roll: float = 0.0
    """degrees about each of the thumb's bones; positive turns its nail towards the back of the hand, on
    either hand"""
    keep_rest: bool = False
    """True if fingers keep the difference between the character's rest pose and ours, instead of pointing as
    ours do"""
    fold: float = 0.0
    """The share of ring and little finger's bend that their metacarpals take over, 0..1"""

    @property
    def mapped(self) -> dict[int, str]:
        """The name of the bone of each of the fingers' joints that has one, by the joint's number in MANO's
        order."""
        return {joint: name for joint, name in enumerate(self.bones) if joint and name}

    @property
    def keyed(self) -> tuple[str, ...]:
        """Names of the bones that fingers' motion is keyed on: each once, parents before children."""
        folded = [name for name in self.palm[2:] if name] if self.fold else []
        return tuple(dict.fromkeys([*folded, *self.mapped.values()]))

    @property
    def named(self) -> tuple[str, ...]:
        """Names of all bones in this table, each once."""
        return tuple(name for name in dict.fromkeys((*self.bones, *self.palm, self.control)) if name)

    @property
    def moved_by(self) -> str:
        """Name of the bone that moves the whole hand."""
        return self.control or self.bones[0]

    @property
    def fingers(self) -> tuple[str, ...]:
        """Names of the fingers that have at least one bone."""
        return tuple(f for f in FINGERS if any(self.bones[joint] for joint in FINGER_JOINTS[f]))

    def check(self, there: Mapping[str, Any] | Any) -> None:
        """Check that the table fits an armature: raises HandModelError where a named bone is not among
        `there`, or where there is no hand."""
        if not self.bones[0]:
            raise HandModelError(f"no bone stands for the {self.side} hand itself: choose it in the table")
        if not self.mapped:
            raise HandModelError(f"no bone stands for a finger of the {self.side} hand: choose some")
        missing = next((name for name in self.named if name not in there), None)
        if missing is not None:
            raise HandModelError(f"there is no bone {shown(missing)!r}: choose another one in the table")

    def to_json(self) -> str:
        """Return the table as JSON text, which armatures and preset files keep."""
        data = asdict(self)
        names = dict(zip(JOINT_NAMES, data.pop("bones"), strict=True))
        palm = dict(zip(PALM_FINGERS, data.pop("palm"), strict=True))
        return json.dumps({**data, "bones": names, "palm": palm}, ensure_ascii=False, indent=1)

    @classmethod
    def from_json(cls, text: str) -> HandMap:
        """Read the text that `to_json` wrote. Raises HandModelError for whatever else the text is."""
        data = _json(text, "table")
        if not isinstance(data, dict):
            raise HandModelError("this is no table of a hand's bones")
        if data.get("side") not in SIDES:
            raise HandModelError("a table of a hand's bones names its side, left or right")
        values: dict[str, Any] = {"side": cast(Side, data["side"])}
        values["bones"] = _names(data.get("bones"), JOINT_NAMES)
        values["palm"] = _names(data.get("palm", {}), PALM_FINGERS)
        for name in ("control", "rig", "thumb_roll", "keep_rest", "fold"):
            if name not in data:
                continue
            value = data[name]
            if name in _RANGES:
                lowest, highest = _RANGES[name]
                fits = type(value) in (int, float) and lowest <= value <= highest
            else:
                fits = isinstance(value, type(getattr(cls, name))) and len(str(value)) <= _MAX_NAME_LENGTH
            if not fits:
                raise HandModelError(f"{name} of this table of a hand's bones is {shown(str(value)[:40])!r}")
            values[name] = value
        return cls(**values)


def to_preset(hand_maps: Iterable[HandMap]) -> str:
    """Return the text of a preset file: a JSON list of the tables of one hand or both."""
    return f"[{','.join(hand_map.to_json() for hand_map in hand_maps)}]"


def from_preset(text: str) -> list[HandMap]:
    """Read the tables from the text of a preset file. Raises HandModelError for whatever else the text is."""
    data = _json(text, "preset")
    if not isinstance(data, list):
        raise HandModelError("this is no preset of a hand's bones: it is no list of tables")
    read = [HandMap.from_json(json.dumps(one)) for one in data]
    if sorted(hand_map.side for hand_map in read) not in (["left"], ["right"], ["left", "right"]):
        raise HandModelError("a preset has one table for a hand or one for each")
    return read


def read_preset(path: str | os.PathLike[str]) -> list[HandMap]:
    """Read the tables of a preset file. Raises HandModelError, which names the file."""
    try:
        return from_preset(read_file(path, _MAX_PRESET_BYTES).decode("utf-8", "replace"))
    except (OSError, ValueError) as error:
        raise HandModelError(f"{shown(path)}: {why(error)}") from error
    except HandModelError as error:
        raise HandModelError(f"{shown(path)}: {error}") from error


def _json(text: str, what: str) -> Any:
    if len(text) > _MAX_PRESET_BYTES:
        raise HandModelError(f"this is no {what} of a hand's bones: it is too long")
    try:
        data = json.loads(text)
        json.dumps(data, ensure_ascii=False).encode()  # Blender cannot show half a surrogate pair
    except (ValueError, RecursionError) as error:
        raise HandModelError(f"this is no {what} of a hand's bones: it is not JSON") from error
    return data


def _names(data: Any, keys: tuple[str, ...]) -> tuple[str, ...]:
    if not isinstance(data, dict) or not set(data) <= set(keys):
        raise HandModelError(f"a table of a hand's bones names them by {', '.join(keys)}")
    names = tuple(data.get(key, "") for key in keys)
    if not all(isinstance(name, str) and len(name) <= _MAX_NAME_LENGTH for name in names):
        raise HandModelError("a table of a hand's bones holds names")
    return names


def empty_map(side: Side) -> HandMap:
    """Return the table of a hand of that side in which no bone is chosen yet."""
    return HandMap(side, ("",) * NUM_JOINTS)
