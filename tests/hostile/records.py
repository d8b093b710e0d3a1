"""Folders of a batch's results: records that are damaged, that lie, or that are no files."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from typing import Any

from tests.hostile.engine import ODD, RESULTS, Case, Place
from tests.hostile.mutations import MUTATIONS, json_with, mutated
from tests.hostile.npz import VALUES

RECORD = f"{RESULTS}/a/a.json"
SECRET = "kept.npz"
"""The artist's file beside the folder of results"""
FIELDS = (
    "key result result.name result.status result.hands result.hands.0 result.hands.0.side "
    "result.hands.0.detected result.frames result.files result.warnings result.attempts result.attempts.0.kind "
    "result.error result.character files files.a&txt formats run"
)
"""Fields of a record, of which every one is to hold each of VALUES; & stands for a dot in a name"""
NAMES = {
    "up": "../../" + SECRET, "root": "/etc/passwd", "nul": "a\0b", "surrogate": "\ud800", "drive": "C:\\x", "empty": "",
    "dot": ".", "long": "x" * 5000, "slashes": "a/" * 3000 + "b", "record": "a.json", "link": "link/" + SECRET,
}  # fmt: skip
"""What a result may be called"""
CONTENTS = {"nothing": b"", "words": b"words", "deep": b"[" * 200_000 + b"]" * 200_000}


def good(status: str = "ok") -> dict[str, Any]:
    """A record of the task `a`."""
    hand = {"side": "left", "detected": 3, "doubtful": 1, "mean_reprojection_error_px": 2.5}
    hand |= {"mean_error_of_hand": 0.02, "mean_expected_error": 0.01, "error_known": True}
    attempt = {"error": "no hand", "kind": "InputError", "host": "a", "seconds": 1.5, "at": "2026-01-01"}
    result = {"input": "a.mp4", "name": "a", "status": status, "seconds": 2.5, "frames": 3, "hands": [hand]}
    result |= {"character": None, "files": ["a/a.txt"], "warnings": ["a"], "error": "", "attempts": [attempt]}
    result |= {"id": "key", "host": "a"}
    return {"key": "key", "run": "", "result": result, "files": {"a.txt": 3}, "formats": {}}


def _naming(result: str) -> bytes:
    return json.dumps({**good(), "files": {result: 3}}).encode()


def _case(
    name: str, data: Callable[[Place], bytes], odd: tuple[str, Callable] | None = None, known: bool = False
) -> Case:
    """A folder of results with that record; `odd`: what lies where, beside the record or in its place."""

    def make(place: Place) -> dict[str, Any]:
        place.write(RECORD, data(place))
        place.write(f"{RESULTS}/a/a.txt", b"abc")
        folder = place.folder / RESULTS / "a"
        (folder / "link").symlink_to("../..")
        if odd:
            (folder / odd[0]).unlink(missing_ok=True)
            odd[1](folder / odd[0])
        return {"path": str(place.folder / RESULTS)}

    return Case(f"record-{name}", "core.results", make, known=known)


def cases() -> Iterator[Case]:
    for status in ("ok", "failed"):
        for mutation in MUTATIONS:
            damaged = lambda place, m=mutation, s=status: mutated(json.dumps(good(s)).encode(), m, place.rng)  # noqa: E731
            for number in range(6):
                yield _case(f"{status}-{mutation.__name__}-{number}", damaged)
        for field in FIELDS.split():
            path = tuple(int(key) if key.isdigit() else key.replace("&", ".") for key in field.split("."))
            for value, text in VALUES.items():
                lie = lambda _, p=path, t=text, s=status: json_with(good(s), p, t).encode()  # noqa: E731
                yield _case(f"{status}-{field.replace('.', '-').replace('&', '-')}-{value}", lie)
    for kind, put in ODD.items():
        yield _case(f"is-a-{kind}", lambda _: b"", ("a.json", put), kind == "pipe")
        yield _case(f"result-is-a-{kind}", lambda _: _naming("odd"), ("odd", put))
    for kind, called in NAMES.items():
        yield _case(f"names-{kind}", lambda _, called=called: _naming(called))
    for kind, data in CONTENTS.items():
        yield _case(f"holds-{kind}", lambda _, data=data: data)
