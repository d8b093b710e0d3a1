"""Lines there and back, and one sentence for every line that is not a message."""

from typing import Any

import numpy as np
import pytest

from handfit_core.arrays import pack
from handfit_core.errors import ProtocolError
from handfit_core.worker.protocol import check_event, check_id, decode, encode


@pytest.mark.parametrize(
    "message",
    [
        {"id": 1, "request": "check"},
        {"input": ["/clips/Hände 手/a\nb.mp4"], "options": {"threshold": 0.25, "model": None, "flag": True}},
        {"input": ["/clips/\udcff.mp4"]},  # a file name on Linux that is not UTF-8
    ],
    ids=["plain", "unicode", "surrogate"],
)
def test_messages_come_back_from_one_line(message: dict[str, Any]) -> None:
    line = encode(message)
    assert line.endswith(b"\n")
    assert line.count(b"\n") == 1
    assert decode(line) == message


@pytest.mark.parametrize("value", [float("nan"), float("inf"), np.float32(1), np.zeros(2), object()])
def test_only_jsons_types_are_sent(value: object) -> None:
    with pytest.raises(ProtocolError, match="JSON's types"):
        encode({"value": value})


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"hello",
        b"{",
        b"[1, 2]",
        b"3",
        b'{"a": 1} {"b": 2}',
        b"\xff\xfe{}",
        b"[" * 100_000,
        b'{"a": NaN}',
        b'{"a": [-Infinity]}',
        b'{"a": ' + b"9" * 5000 + b"}",
    ],
)
def test_other_lines_are_refused_in_one_sentence(line: bytes) -> None:
    with pytest.raises(ProtocolError) as caught:
        decode(line)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize("number", [None, 0, -1, 1.0, "1", True, [1]], ids=str)
def test_ids_are_positive_whole_numbers(number: object) -> None:
    assert check_id({"id": 7}) == 7
    assert check_id({"job": 3}, "job") == 3
    with pytest.raises(ProtocolError, match="id must be a positive whole number"):
        check_id({"id": number})


HAND = {"side": "left", "certainty": 0.5, "keypoints": pack(np.zeros((21, 2)))}
NOT_FINITE = pack(np.full((21, 2), np.nan))
FOUND = {"frame": 1, "width": 4, "height": 3, "hands": [HAND]}
PROBED = {"kind": "photo", "width": 4, "height": 3, "fps": 24.0, "frames": 1, "first": 1, "last": 1}


@pytest.mark.parametrize(
    ("message", "request_kind"),
    [
        ({"event": "progress", "stage": "fit", "done": 3, "total": 0}, "capture"),
        ({"event": "warning", "message": "dark"}, "capture"),
        ({"event": "error", "type": "InputError", "message": "no"}, "probe"),
        ({"event": "done", **PROBED, "newer": [1]}, "probe"),
        ({"event": "done", "stopped": True}, "capture"),
        ({"event": "done", **FOUND}, "find"),
        ({"event": "newer", "done": "x"}, "capture"),
    ],
    ids=str,
)
def test_events_that_are_of_the_protocol(message: dict[str, Any], request_kind: str) -> None:
    check_event(message, request_kind)


@pytest.mark.parametrize(
    ("message", "request_kind", "said"),
    [
        ({"event": ["progress"]}, "capture", "event must be a text"),
        ({"event": "progress", "stage": "fit", "done": "3", "total": 0}, "capture", "done must be a whole"),
        ({"event": "progress", "stage": "fit", "done": 3, "total": [0]}, "capture", "total must be a whole"),
        ({"event": "progress", "stage": {}, "done": 3, "total": 3}, "capture", "stage must be a text"),
        ({"event": "warning", "message": 3}, "capture", "message must be a text"),
        ({"event": "error", "type": "a" * 1000, "message": "a"}, "capture", "type must be a text"),
        ({"event": "error", "type": "a", "message": "a", "details": []}, "capture", "details must be a text"),
        ({"event": "done", "stopped": "yes"}, "capture", "stopped must be true or false"),
        ({"event": "done", **PROBED, "fps": "24"}, "probe", "fps must be a finite number"),
        ({"event": "done", **PROBED, "width": True}, "probe", "width must be a whole number"),
        ({"event": "done", "kind": "photo"}, "probe", "width must be a whole number"),
        ({"event": "done", **FOUND, "hands": {}}, "find", "hands must be a list"),
        ({"event": "done", **FOUND, "hands": [{"side": []}]}, "find", "side must be left or right"),
        (
            {"event": "done", **FOUND, "hands": [{"side": "left"}]},
            "find",
            "certainty must be a finite number",
        ),
        ({"event": "done", **FOUND, "hands": [{**HAND, "keypoints": 1}]}, "find", "dtype, shape and data"),
        (
            {"event": "done", **FOUND, "hands": [{**HAND, "keypoints": NOT_FINITE}]},
            "find",
            "keypoints is not finite",
        ),
        ({"event": "done", "seconds": []}, "refit", "seconds must be a finite number"),
        ({"event": "done", "report": {}}, "check", "report must be a text"),
    ],
    ids=str,
)
def test_events_that_are_not(message: dict[str, Any], request_kind: str, said: str) -> None:
    with pytest.raises(ProtocolError, match=said) as caught:
        check_event(message, request_kind)
    assert len(str(caught.value)) < 300
