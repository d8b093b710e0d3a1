"""Folders of a batch's results: records that are damaged, that lie, or that are no files."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from tests.hostile.engine import RESULTS, Case, Place
from tests.hostile.mutations import MUTATIONS, mutated, told
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


def good(status: str = "ok") -> dict[str, Any]:
    """A record of the task `a`."""
    hand = {"side": "left", "detected": 3, "doubtful": 1, "mean_reprojection_error_px": 2.5}
    hand |= {"mean_error_of_hand": 0.02, "mean_expected_error": 0.01, "error_known": True}
    attempt = {"error": "no hand", "kind": "InputError", "host": "a", "seconds": 1.5, "at": "2026-01-01"}
    result = {"input": "a.mp4", "name": "a", "status": status, "seconds": 2.5, "frames": 3, "hands": [hand]}
    result |= {"character": None, "files": ["a/a.txt"], "warnings": ["a"], "error": "", "attempts": [attempt]}
    result |= {"id": "key", "host": "a"}
    return {"key": "key", "run": "", "result": result, "files": {"a.txt": 3}, "formats": {}}


def _pipe(path: Path) -> None:
    os.mkfifo(path)


def _sparse(path: Path) -> None:
    with path.open("wb") as stream:
        stream.truncate(1 << 36)


ODD: dict[str, Callable[[Path], None]] = {
    "pipe": _pipe,
    "folder": lambda path: path.mkdir(),
    "device": lambda path: path.symlink_to("/dev/zero"),
    "link": lambda path: path.symlink_to(Path("../..") / SECRET),
    "circle": lambda path: path.symlink_to(path.name),
    "gone": lambda path: path.symlink_to("nowhere"),
    "sparse": _sparse,
}
"""What may lie in the place of a file"""


def laid_out(place: Place, record: bytes) -> dict[str, Any]:
    """A folder of results with that record; the arguments of the door `results`."""
    place.write(RECORD, record)
    place.write(f"{RESULTS}/a/a.txt", b"abc")
    (place.folder / RESULTS / "a" / "link").symlink_to("../..")
    return {"path": str(place.folder / RESULTS)}


def cases() -> Iterator[Case]:
    for status in ("ok", "failed"):
        for mutation in MUTATIONS:
            for number in range(6):

                def mutant(place: Place, status=status, mutation=mutation) -> dict[str, Any]:
                    return laid_out(place, mutated(json.dumps(good(status)).encode(), mutation, place.rng))

                yield Case(f"record-{status}-{mutation.__name__}-{number}", "core.results", mutant)
        for field in FIELDS.split():
            path = tuple(int(key) if key.isdigit() else key.replace("&", ".") for key in field.split("."))
            for value, text in VALUES.items():

                def lie(place: Place, status=status, path=path, text=text) -> dict[str, Any]:
                    return laid_out(place, told(good(status), path, text).encode())

                name = f"record-{status}-{field.replace('.', '-').replace('&', '-')}-{value}"
                yield Case(name, "core.results", lie)
    for kind, put in ODD.items():

        def odd(place: Place, put=put) -> dict[str, Any]:
            arguments = laid_out(place, b"")
            (place.folder / RECORD).unlink()
            put(place.folder / RECORD)
            return arguments

        yield Case(f"record-is-a-{kind}", "core.results", odd, known=kind == "pipe")

        def result_is(place: Place, put=put) -> dict[str, Any]:
            arguments = laid_out(place, json.dumps({**good(), "files": {"odd": 3}}).encode())
            put((place.folder / RECORD).parent / "odd")
            return arguments

        yield Case(f"record-result-is-a-{kind}", "core.results", result_is)
    for kind, called in NAMES.items():
        record = json.dumps({**good(), "files": {called: 3}}).encode()
        yield Case(f"record-names-{kind}", "core.results", partial(laid_out, record=record))
    for kind, record in {"nothing": b"", "words": b"words", "deep": b"[" * 200_000 + b"]" * 200_000}.items():
        yield Case(f"record-holds-{kind}", "core.results", partial(laid_out, record=record))
