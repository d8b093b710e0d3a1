"""The messages between Blender and the worker process: JSON lines, with arrays packed into them by `arrays`.

Both sides import this, so it needs no more than NumPy. docs/worker-protocol.md describes every message.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from handfit_core.arrays import array, array_dataclass, check_arrays, packed_arrays, unpacked_arrays
from handfit_core.doors.values import Unfit, number, shortly, text, whole
from handfit_core.errors import ProtocolError
from handfit_core.skeleton import NUM_KEYPOINTS, SIDES, Side

PROTOCOL: Final = 1
"""Version of the messages; the `ready` event carries it, and both sides must have the same"""

JOBS: Final = ("capture", "probe", "find", "sheet", "refit", "warm", "check")
"""Requests that are done one at a time, in order, and answered by `done` or `error`"""

REQUESTS: Final = (*JOBS, "cancel", "end")
"""`cancel` and `end` act at once and have no answer of their own"""

LONGEST_REQUEST: Final = 1 << 28
"""bytes of a request's line; a range of an hour needs about half of it"""

LONGEST_EVENT: Final = 1 << 27
"""bytes of an event's line; the answer to a range of an hour has 115 MB"""

_MAX_TEXT_CHARS: Final = 1 << 24
"""characters of a text in an event"""
_MAX_WORD_CHARS: Final = 200


def encode(message: Mapping[str, Any]) -> bytes:
    """One message -> one line, its end included.

    Plain ASCII: whatever a file is called, the line is valid UTF-8 and comes back as it was. Raises
    ProtocolError for what JSON cannot hold: NaN outside a packed array, and objects.
    """
    try:
        return json.dumps(message, allow_nan=False, separators=(",", ":")).encode("ascii") + b"\n"
    except (TypeError, ValueError) as error:
        raise ProtocolError(f"a message must hold JSON's types only ({error}); pack arrays") from error


def decode(line: bytes) -> dict[str, Any]:
    """One line -> its message. Raises ProtocolError for anything but one JSON object."""
    try:
        message = json.loads(line.decode("utf-8"), parse_constant=_no_number)
    except (ValueError, RecursionError) as error:
        raise ProtocolError(f"a line that is not JSON came: {_beginning(line)}") from error
    if not isinstance(message, dict):
        raise ProtocolError(f"a message must be one JSON object a line; got {_beginning(line)}")
    return message


def _no_number(name: str) -> None:
    """Python reads NaN and Infinity where JSON has none."""
    raise ValueError(name)


def _beginning(line: bytes) -> str:
    text = line.decode("utf-8", errors="replace").strip()
    return repr(text if len(text) <= 60 else f"{text[:60]}...")


def check_id(message: Mapping[str, Any], key: str = "id") -> int:
    """The message's `id`, or `job` of a cancel. Raises ProtocolError unless it is a positive integer."""
    try:
        return whole(key, message.get(key), 1)
    except Unfit as error:
        raise ProtocolError(
            f"a request's {key} must be a positive whole number, not {shortly(message.get(key))}"
        ) from error


def _word(name: str, value: Any) -> str:
    return text(name, value, _MAX_WORD_CHARS)


def _words(name: str, value: Any) -> list[str]:
    if not isinstance(value, list):
        raise Unfit(f"{name} must be a list, not {shortly(value)}")
    return [_word(name, word) for word in value]


def _numbers(name: str, value: Any) -> list[int]:
    if not isinstance(value, list):
        raise Unfit(f"{name} must be a list, not {shortly(value)}")
    return [whole(name, each) for each in value]


def _text(name: str, value: Any) -> str:
    return text(name, value, _MAX_TEXT_CHARS)


def _count(name: str, value: Any) -> int:
    return whole(name, value, 0)


@array_dataclass
class FoundHand:
    """One of the hands in the answer to a `find` request."""

    side: Side
    certainty: float
    """How sure it is that this is a hand, 0..1"""
    keypoints: np.ndarray = array(NUM_KEYPOINTS, 2, finite="all", sent=np.float32)
    """pixels of the upright picture"""

    def to_message(self) -> dict[str, Any]:
        """As JSON's types."""
        return {"side": self.side, "certainty": self.certainty, **packed_arrays(self)}

    @classmethod
    def of_message(cls, message: Any) -> FoundHand:
        """The inverse of `to_message`. Raises Unfit and ProtocolError."""
        if not isinstance(message, dict) or message.get("side") not in SIDES:
            raise Unfit("hands must have a side each, left or right")
        certainty = number("certainty", message.get("certainty"))
        found = cls(message["side"], certainty, **unpacked_arrays(cls, message))
        check_arrays(found)
        return found


def _hands(name: str, value: Any) -> list[FoundHand]:
    if not isinstance(value, list):
        raise Unfit(f"{name} must be a list, not {shortly(value)}")
    return [FoundHand.of_message(hand) for hand in value]


def _flag(name: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise Unfit(f"{name} must be true or false, not {shortly(value)}")
    return value


_EVENTS: Final[dict[str, dict[str, Callable[[str, Any], Any]]]] = {
    "ready": {"protocol": whole, "version": _word, "detectors": _words, "solvers": _words},
    "unfit": {"python": _word},
    "progress": {"stage": _word, "done": _count, "total": _count},
    "warning": {"message": _text},
    "error": {"type": _word, "message": _text, "details": _text},
    "done": {},
}
"""Event -> its fields that a client reads, and how each is checked; `id` comes on top"""

_ANSWERS: Final[dict[str, dict[str, Callable[[str, Any], Any]]]] = {
    "capture": {"stopped": _flag},
    "probe": {
        "kind": _word,
        "width": _count,
        "height": _count,
        "fps": number,
        "frames": _count,
        "first": whole,
        "last": whole,
    },
    "find": {"frame": whole, "width": _count, "height": _count, "hands": _hands},
    "sheet": {"frames": _numbers},
    "refit": {"seconds": number},
    "warm": {},
    "check": {"report": _text, "ok": _flag},
}
"""Kind of request -> the fields of its `done` event that a client reads, and how each is checked"""

_OPTIONAL_FIELDS: Final = ("details", "stopped", "seconds", "report", "ok", "detectors", "solvers")
"""fields that an event may lack"""


def check_event(message: Mapping[str, Any], request: str | None = None) -> None:
    """Raise ProtocolError where an event lacks a field, or has one of another kind than the protocol says.

    `request`: the kind of the request that a `done` event answers. Events and fields that are not known are
    none of this version, and are passed.
    """
    kind = message.get("event")
    try:
        fields = dict(_EVENTS.get(_word("event", kind), {}))
        if kind == "done":
            fields |= _ANSWERS.get(request or "", {})
        for name, check in fields.items():
            if name in message or name not in _OPTIONAL_FIELDS:
                check(name, message.get(name))
    except Unfit as error:
        raise ProtocolError(f"in the event {shortly(kind)}, {error}") from error
