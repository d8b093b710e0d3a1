"""Names of files: what FFmpeg takes for an address, what is no file, what no terminal can show."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from tests.hostile import models, pictures, recordings, takes, videos
from tests.hostile.engine import ODD, Case, Place

CONTENTS: dict[str, tuple[str, Callable[[], bytes], str, dict[str, Any]]] = {
    "video": (".mp4", videos.good_bytes, "core.media", {}),
    "picture": (".png", lambda: pictures.encoded("png"), "core.media", {}),
    "take": (".npz", takes.good_bytes, "core.take", {}),
    "model": (".npz", models.good_bytes, "core.model", {"side": "right"}),
    "pickle": (".pkl", lambda: b"N.", "core.model", {"side": "right"}),
    "points": (".json", lambda: recordings.content("points"), "core.recording", {}),
    "body": (".npz", lambda: recordings.content("smplx"), "core.recording", {}),
    "bones": (".bvh", lambda: recordings.content("bvh"), "core.recording", {}),
    "footage": (".mp4", videos.good_bytes, "blender.import_of", {"kind": "video"}),
    "photo": (".png", lambda: pictures.encoded("png"), "blender.import_of", {"kind": "photo"}),
}
"""What is in the file: its suffix, bytes, door and the door's other arguments."""

FILES = {
    **{
        f"{protocol}-0": f"{protocol}:127.0.0.1:{{port}}?x{{suffix}}"
        for protocol in "http https tcp rtmp rtsp ftp mmsh icecast httpproxy tls rtp".split()
    },
    "http-1": "http:127.0.0.1:{port}/x{suffix}",
    "async": "async:http:127.0.0.1:{port}?x{suffix}",
    "cache": "cache:http:127.0.0.1:{port}?x{suffix}",
    "concat": "concat:kept.npz|http:127.0.0.1:{port}?x{suffix}",
    "subfile": "subfile,,start,0,end,9,,:x{suffix}",
    "file": "file:x{suffix}",
    "data": "data:text;base64,x{suffix}",
    "pipe": "pipe:0{suffix}",
    "percent-d": "a%02d{suffix}",
    "percent-n": "%n%n%s%s%999999999d{suffix}",
    "glob": "[a-z]*?{suffix}",
    "dash": "-rf{suffix}",
    "shell": "$(touch canary);`touch canary`{suffix}",
    "newline": "a\nb{suffix}",
    "escape": "a\x1b[2J\x07\r{suffix}",
    "turned": "a\u202egnp{suffix}",
    "emoji": "\U0001f590" * 20 + "{suffix}",
    "bytes": "\udcff\udcfe{suffix}",
    "braces": "{{0}}{{x!r}}{suffix}",
    "tilde": "~nobody{suffix}",
    "longest": "x" * 240 + "{suffix}",
    "only-suffix": "{suffix}",
    "upper": "X{upper}",
    "quote": "a'b\"c{suffix}",
}
"""Names under which good files lie; relative ones, so that nothing stands before them."""


def _good(kind: str, pattern: str, place: Place) -> dict[str, Any]:
    suffix, data, _, arguments = CONTENTS[kind]
    file = pattern.format(suffix=suffix, upper=suffix.upper(), port=place.port)
    place.write(file, data())
    return {"path": file, **arguments}


def _no_file(kind: str, create: Callable[[Path], object], place: Place) -> dict[str, Any]:
    suffix, _, _, arguments = CONTENTS[kind]
    path = place.folder / f"MANO_RIGHT{suffix}"
    create(path)
    return {"path": str(path), **arguments}


TEXTS = {
    "nothing": "", "nul": "a\0b", "surrogate": "\ud800", "too-long": "x" * 5000, "deep": "a/" * 3000, "dot": ".",
    "root": "/", "zero": "/dev/zero", "tty": "/dev/tty", "stdin": "/dev/stdin", "url": "http://127.0.0.1:1/x.mp4",
    "nobody": "~nobody/x.mp4", "percents": "%d" * 500, "stars": "*" * 200 + "/" + "?" * 200, "far": "../" * 900 + "x",
}  # fmt: skip


def cases() -> Iterator[Case]:
    for kind, (_, _, door, arguments) in CONTENTS.items():
        in_blender = door.startswith("blender")
        for name, pattern in FILES.items():
            known = kind in ("video", "footage") and name in ("http-0", "tcp-0")
            if not in_blender or ":" in pattern or "%" in pattern:
                yield Case(f"name-{kind}-{name}", door, partial(_good, kind, pattern), known=known)
        for name, create in ODD.items():
            known, make = name == "pipe" and kind in ("model", "pickle"), partial(_no_file, kind, create)
            yield Case(f"no-file-{kind}-{name}", door, make, refused=not in_blender, known=known)
        for name, text in TEXTS.items():
            if not in_blender or name not in ("surrogate", "nul"):
                make = lambda _, text=text, more=arguments: {"path": text, **more}  # noqa: E731
                yield Case(f"text-{kind}-{name}", door, make, refused=not in_blender)
