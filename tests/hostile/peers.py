"""Peers that do not keep to the protocol: clients of the real worker, and workers of the real client."""

from __future__ import annotations

import base64
import json
import stat
import sys
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import numpy as np

from handfit_core.arrays import pack
from handfit_core.version import __version__
from handfit_core.worker.protocol import PROTOCOL, encode
from tests.hostile.engine import Case, Place, file_case
from tests.hostile.mutations import MUTATIONS, mutants, mutated, told
from tests.hostile.npz import DEEP, VALUES

CAPTURE: dict[str, Any] = {
    "id": 1,
    "request": "capture",
    "input": ["nowhere.jpg"],
    "output": "result/a.npz",
    "compact": True,
    "options": {
        "frames": "1-5:2", "hands": "left", "solver": "fast", "model": "open-hand", "threshold": 0.5,
        "intrinsics": [500.0, 500.0, 320.0, 240.0], "lens": [1.0, 0.5, 0.5], "landmark_model": "no.task",
        "smoothing": 1.0, "plain_detection": True, "hand_length": 0.18,
    },
}  # fmt: skip


@cache
def refit() -> dict[str, Any]:
    """A request for two frames, as the add-on sends it."""
    from handfit_core.edit import to_message
    from handfit_core.edit.hand import RefineHand
    from tests.hostile.takes import good_take

    take = good_take()
    track = take.hands[0]
    hand = RefineHand(
        side=track.side,
        betas=track.betas,
        intrinsics=take.intrinsics,
        detections=(track.detection(0), track.detection(1)),
        pins=np.full((2, 21, 2), np.nan),
        global_orient=track.global_orient[:2],
        hand_pose=track.hand_pose[:2],
        transl=track.transl[:2],
        locked=np.zeros(16, bool),
        model="open-hand",
        fps=25.0,
        smoothing=1.0,
        holes=(),
        touches=np.full((2, 21), np.nan),
    )
    return {"id": 2, "request": "refit", "mode": "each", "hand": to_message(hand)}


_ARRAYS: dict[str, Callable[[np.ndarray], Any]] = {
    "nan": lambda a: pack(np.full(a.shape, np.nan)),
    "infinity": lambda a: pack(np.full(a.shape, np.inf)),
    "huge": lambda a: pack(np.full(a.shape, 1e300)),
    "ints": lambda a: pack(np.full(a.shape, -(2**62))),
    "flat": lambda a: pack(a.ravel()),
    "empty": lambda a: pack(a[:0]),
    "scalar": lambda _: pack(np.array(1.0)),
    "no-size": lambda _: {"dtype": "float64", "shape": [1 << 62, 1 << 62], "data": ""},
    "zero-by-huge": lambda _: {"dtype": "float64", "shape": [0, 1 << 62], "data": ""},
    "minus": lambda _: {"dtype": "float64", "shape": [-1, -1], "data": base64.b64encode(bytes(8)).decode()},
    "objects": lambda _: {"dtype": "object", "shape": [1], "data": base64.b64encode(bytes(8)).decode()},
    "many-axes": lambda _: {"dtype": "uint8", "shape": [1] * 99, "data": "AA=="},
    "axis-type": lambda _: {"dtype": "uint8", "shape": ["1", None], "data": "AA=="},
    "data-type": lambda _: {"dtype": "uint8", "shape": [1], "data": 5},
    "dtype-type": lambda _: {"dtype": ["uint8"], "shape": [1], "data": "AA=="},
}

LINES: dict[str, bytes] = {
    "nothing": b"", "words": b"hello\n", "no-newline": b'{"id":1', "nul": b"\0" * 10_000 + b"\n", "number": b"5\n",
    "deep": b"[" * DEEP + b"\n", "deep-object": b'{"a":' * DEEP + b"\n", "bom": b"\xef\xbb\xbf{}\n", "null": b"null\n",
    "utf16": '{"id":1}\n'.encode("utf-16"), "not-utf8": b'{"id":1,"request":"\xff"}\n', "long-number": b"9" * 10**6 + b"\n",
    "keys": b'{"id":1,' + b",".join(b'"%d":1' % n for n in range(200_000)) + b"}\n", "crs": b"\r" * 10**5 + b"\n",
    "cancels": encode({"id": 5, "request": "cancel", "job": 7}) * 20_000, "errors": b"x\n" * 20_000,
    "same-id": encode({"id": 3, "request": "probe", "input": ["a"]}) * 500,
    "many": b"".join(encode({"id": n, "request": "probe", "input": ["a"]}) for n in range(1, 2000)),
    "cancel-itself": b"".join(encode({"id": n, "request": r, "job": 9, "input": ["a"]}) for n, r in ((9, "probe"), (10, "cancel"))),
    "floats": b'{"id":1e400,"request":"probe"}\n', "minus-zero": b'{"id":-0,"request":"probe"}\n',
    "twice-a-key": b'{"id":1,"id":"x","request":"probe","request":"warm"}\n', "spaces": b" " * 10**6 + b"\n",
}  # fmt: skip


def _field_lies(
    request: Callable[[], dict[str, Any]], paths: list[tuple[str, ...]]
) -> Iterator[tuple[str, Callable[[], bytes]]]:
    for path in paths:
        for name, value in VALUES.items():

            def line(path: tuple[str, ...] = path, value: str = value) -> bytes:
                return told(request(), path, value).encode() + b"\n"

            yield f"{'-'.join(path)}-{name}", line


def _servers() -> Iterator[Case]:
    capture = [(name,) for name in CAPTURE] + [("options", name) for name in CAPTURE["options"]]
    hand = refit()["hand"]
    fields = [("mode",), ("hand",)] + [("hand", name) for name in hand]
    lies = [*_field_lies(lambda: CAPTURE, capture), *_field_lies(refit, fields)]
    finds = _field_lies(
        lambda: {**CAPTURE, "request": "find", "picture": "shown.jpg"}, [("picture",), ("input",)]
    )
    lies += [(f"find-{name}", line) for name, line in finds]
    sheet = {"id": 1, "request": "sheet", "take": "shown.npz", "output": "shown.jpg"}
    lies += [(f"sheet-{name}", line) for name, line in _field_lies(lambda: sheet, [("take",), ("output",)])]
    for name, line in lies:
        if name.rpartition("-")[2] in "nan huge deep text object lists minus whole surrogate".split():
            yield _server(name, line)
    for name, packed in hand.items():
        if isinstance(packed, dict):
            for lie, build in _ARRAYS.items():
                good = np.zeros(packed["shape"])

                def line(name: str = name, build: Any = build, good: np.ndarray = good) -> bytes:
                    return encode({**refit(), "hand": {**refit()["hand"], name: build(good)}})

                yield _server(f"array-{name}-{lie}", line)
    for name, data in LINES.items():
        yield _server(f"line-{name}", lambda data=data: data)
    yield from mutants("client-capture", "core.server", lambda: encode(CAPTURE), "requests", 3)
    yield from mutants("client-refit", "core.server", lambda: encode(refit()), "requests", 3)
    yield file_case("client-endless-line", "core.server", "requests", lambda _: b"{", endless=300_000_000)


def _server(name: str, line: Callable[[], bytes]) -> Case:
    return file_case(f"client-{name}", "core.server", "requests", lambda _: line())


PRELUDE = f"""#!{sys.executable} -S
import json, os, signal, sys, time
def raw(data): sys.stdout.buffer.write(data); sys.stdout.buffer.flush()
def say(**event): raw(json.dumps(event).encode() + b"\\n")
def ready(**more): say(**{{"event": "ready", "protocol": {PROTOCOL}, "version": "{__version__}", "pid": os.getpid(), "python": "3", **more}})
def request(): return json.loads(sys.stdin.readline())["id"]
def begin(): ready(); return request()
def fail(number): say(event="error", id=number, type="InputError", message="x")
"""
"""What a false worker begins with; without it, one of ours would not be believed."""

_READY = f'"event":"ready","protocol":{PROTOCOL},"version":"{__version__}"'

WORKERS: dict[str, str] = {
    "endless-line": "ready()\nraw(b'{')\nwhile 1: raw(b'x' * (1 << 20))",
    "endless-first-line": "while 1: raw(b'{' * (1 << 20))",
    "endless-noise": "n = begin()\nfor i in range(3000): raw(b'noise\\n' * 1000)\nfail(n)",
    "endless-stderr": "n = begin()\nos.write(2, b'x' * 50_000_000)\nfail(n)",
    "endless-warnings": "n = begin()\nfor i in range(20000): say(event='warning', id=n, message='w' * 99)\nfail(n)",
    "deep": f"n = begin()\nraw(b'{{\"a\":' * {DEEP} + b'\\n')\nfail(n)",
    "long-line": "n = begin()\nsay(event='warning', id=n, message='x' * 30_000_000)\nfail(n)",
    "silent-end": "begin()",
    "no-ready": "request()\nsay(event='done', id=1)",
    "binary": "raw(os.urandom(300_000))",
    "nul": "raw(bytes(300_000))",
    "closes-stdout": "begin()\nos.close(1)\ntime.sleep(60)",
    "closes-stdin": "ready()\nos.close(0)\nos._exit(4)",
    "orphan": "begin()\nif os.fork() == 0: time.sleep(60)\nos._exit(0)",
    "says-memory": "begin()\nprint('MemoryError', file=sys.stderr)\nos._exit(1)",
    "says-traceback-half": "begin()\nos.write(2, b'Trace\\xff\\xfe\\n')\nos._exit(1)",
    **{
        f"signal-{name}": f"begin()\nos.kill(os.getpid(), signal.{name})"
        for name in ("SIGKILL", "SIGSEGV", "SIGTERM", "SIGABRT", "SIGUSR1")
    },
    **{f"exit-{code}": f"begin()\nos._exit({code})" for code in (0, 1, 3, 137, 255)},
    **{
        f"ready-{field}-{name}": f"raw(b'{{{_READY},\"{field}\":{value}}}\\n')\nfail(request())"
        for field in ("protocol", "version", "pid", "python")
        for name, value in VALUES.items()
        if name in ("null", "list", "object", "huge", "text", "whole")
    },
}  # fmt: skip

_EVENTS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("progress", {"stage": "detect", "done": 1, "total": 5}),
    ("warning", {"message": "w"}),
    ("error", {"type": "InputError", "message": "m", "details": "d"}),
    ("done", {"kind": "photo", "width": 5, "height": 5, "fps": 25.0, "frames": 1, "first": 1, "last": 1, "result": {}, "stopped": False, "frame": 1, "hands": []}),
)  # fmt: skip
LIES = ("null", "nan", "whole", "text", "lists", "object", "surrogate", "minus", "deep")


def _workers() -> Iterator[Case]:
    for name, code in WORKERS.items():
        yield _worker(
            name, code, "probe", known=name in ("endless-line", "endless-first-line", "signal-SIGKILL")
        )
    for event, fields in _EVENTS:
        for field in ("id", *fields):
            for lie in LIES:
                message = {"event": event, "id": "@n", **fields, field: "@@"}
                text = json.dumps(message).replace('"@@"', "@@")
                code = (
                    f"n = begin()\nbig = {VALUES[lie] if lie != 'deep' else ''!r} or '[' * {DEEP} + ']' * {DEEP}\n"
                    f"raw({text!r}.replace('\"@n\"', str(n)).replace('@@', big).encode() + b'\\n')\n"
                    "fail(n)"
                )
                kind = "capture" if event == "progress" or field == "stopped" else "probe"
                kind = {"result": "refit", "frame": "find", "hands": "find"}.get(field, kind)
                yield _worker(f"{event}-{field}-{lie}", code, kind, known=(field, lie) == ("id", "lists"))
    for name in ("Cancelled", "HandfitError", "SystemExit", "annotations", "__name__", "BuildInterrupted"):
        code = f"n = begin()\nsay(event='error', id=n, type={name!r}, message='two\\nlines', details=5)"
        yield _worker(f"error-called-{name}", code, "capture")
    for mutation in MUTATIONS:
        for number in range(4):

            def make(place: Place, mutation=mutation) -> dict[str, Any]:
                line = mutated(encode({"event": "done", "id": 1, **_EVENTS[3][1]}), mutation, place.rng)
                return _peer(place, f"begin()\nraw({line!r} + b'\\n')", "probe")

            yield Case(f"worker-{mutation.__name__}-{number}", "blender.client", make)


def _worker(name: str, code: str, kind: str, known: bool = False) -> Case:
    return Case(f"worker-{name}", "blender.client", lambda place: _peer(place, code, kind), known=known)


def _peer(place: Place, code: str, kind: str) -> dict[str, Any]:
    path = place.write("peer", (PRELUDE + code + "\n").encode())
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return {"peer": str(path), "kind": kind}


def cases() -> Iterator[Case]:
    yield from _servers()
    yield from _workers()
