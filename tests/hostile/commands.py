"""The command lines: `python -m handfit_core` and scripts/batch_fit.py, with inputs of the other kinds."""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from tests.bombs import with_claimed_size
from tests.hostile import models, pickles, pictures, recordings, takes, videos
from tests.hostile.engine import ODD, RESULTS, Case, Place
from tests.hostile.mutations import system_call
from tests.hostile.names import TEXTS
from tests.hostile.npz import bomb
from tests.playlists import playlists

Files = dict[str, Callable[[], bytes]]

BAD: dict[str, tuple[str, Callable[[], bytes]]] = {
    "picture": ("a.png", lambda: pictures.encoded("png")[:-300]),
    "jpeg": ("a.jpg", lambda: with_claimed_size(".jpg", 32000, 32000)),
    "video": ("a.mp4", lambda: videos.good_bytes()[:500]),
    "playlist": ("a.mp4", lambda: playlists("kept.npz")["hls"]),
    "nothing": ("a.jpg", lambda: b""),
    "words": ("a", lambda: b"words"),
}
OUTPUTS = (
    "result/out.npz", "kept.npz", "result", "/proc/out.npz", "/dev/full", "result/x/" * 40 + "y.npz", "a\0b", "\udcff.npz",
)  # fmt: skip
OPTIONS: dict[str, list[str]] = {
    "frames": ["--frames", "9" * 5000], "frames-minus": ["--frames=-5"], "threshold-nan": ["--threshold", "nan"],
    "threshold-huge": ["--threshold", "1e999"], "smoothing": ["--smoothing", "-inf"], "length": ["--hand-length", "nan"],
    "intrinsics": ["--intrinsics", "nan,inf,1e999,0"], "intrinsics-few": ["--intrinsics", ",,,"], "solver": ["--solver", "../x"],
    "solver-long": ["--solver", "x" * 5000], "model": ["--model", "/dev/zero"], "landmarks": ["--landmark-model", "kept.npz"],
    "surrogate": ["--model", "\udcff"], "nul": ["--model", "a\0b"], "unknown": ["--__class__", "x"], "hands": ["--hands", "\u202e"],
    "detector": ["--detector", "../x" * 2000], "lens": ["--lens", "nan,1,1e999"], "most-hands": ["--max-hands", "9" * 400],
}  # fmt: skip
MODELS: dict[str, tuple[str, Callable[[], bytes]]] = {
    "bomb": ("a.npz", lambda: bomb({}, "header", 3 << 29)),
    "runs": ("MANO_RIGHT.pkl", system_call),
    "cut": ("a.npz", lambda: models.good_bytes()[:-50]),
    "half": ("MANO_LEFT.pkl", lambda: pickles.mano()[:9999]),
}
TAKES: Files = {
    "damaged": lambda: takes.good_bytes()[:-200],
    "runs": system_call,
    "bomb": lambda: bomb({}, "header", 3 << 29),
    "nothing": lambda: b"",
}
CHARACTERS = {
    "words": b"words",
    "header": b"BLENDER-v405REND" + bytes(range(256)) * 40,
    "huge-block": b"BLENDER-v402DNA1\xff\xff\xff\x7f" + b"\0" * 64,
    "zstd": b"\x28\xb5\x2f\xfd" + bytes(range(256)) * 40,
}
ONTO: dict[str, list[str]] = {
    "device": ["/dev/zero"], "nul": ["a\0b.blend"], "surrogate": ["\udcff.blend"], "long": ["x" * 5000], "colons": [":" * 5000],
    "hands": ["a.blend", "--hands", "left=" + "9" * 5000], "hand": ["a.blend", "--hands", "\u202e=left"],
    "sides": ["a.blend", "--hands", "=,=,,"], "preset-device": ["a.blend", "--bones", "/dev/zero"],
    "preset-words": ["a.blend", "--bones", "a.blend"], "preset-nul": ["a.blend", "--bones", "a\0b"],
}  # fmt: skip
"""The character that a batch is applied to, and its options"""
BATCHES: dict[str, tuple[list[str], int]] = {
    "no-input": (["nowhere.npz", "-o", "result"], 1),
    "into-a-file": (["kept.npz", "-o", "kept.npz"], 2),
    "format": (["kept.npz", "-o", "result", "--format", "exe"], 2),
    "surrogate": (["\udcff.npz", "-o", "result"], 1),
    "nul": (["a\0b", "-o", "result"], 1),
}
"""Arguments, and the exit code"""
LIVE: dict[str, list[str]] = {
    "nothing": [""], "nul": ["a\0b"], "digits": ["9" * 5000], "minus": ["-1"],
    "local-file": ["file:///etc/passwd"], "ftp": ["ftp://127.0.0.1/x"], "concat": ["concat:a|b"], "no-host": ["http://"],
    "bracket": ["http://[::1"], "port": ["http://127.0.0.1:99999/x"], "elsewhere": ["http://192.0.2.1/x"],
    "name-and-password": ["http://127.0.0.1@192.0.2.1/x"],
    "words": ["file:a.mp4"], "device": ["file:/dev/zero"], "seconds": ["0", "--seconds", "nan"],
    "size": ["0", "--size", "9e99x1"], "rate": ["0", "--rate", "1e999"], "cutoff": ["0", "--min-cutoff", "nan"],
    "lens": ["0", "--lens", "nan,1,1"], "vmc": ["0", "--vmc", "127.0.0.1:99999"], "onto": ["file:a.mp4", "-o", "a.mp4"],
    "record-onto": ["file:kept.npz", "-o", "kept.npz"],
}  # fmt: skip
"""A live source, and options; none is opened"""
NODES = ("pipe", "socket", "device")


def _line(
    name: str,
    argv: list[str],
    files: Files | None = None,
    door: str = "core.command",
    *,
    refused: bool = True,
    known: bool = False,
    before: Callable[[Path], object] = lambda _: None,
    **arguments: Any,
) -> Case:
    """A command line in a folder with these files, and with what `before` puts there."""

    def make(place: Place) -> dict[str, Any]:
        for file, data in (files or {}).items():
            place.write(file, data())
        before(place.folder)
        return {"argv": argv, **arguments}

    return Case(name, door, make, refused, known)


def _batch(name: str, argv: list[str], code: int, files: Files | None = None) -> Case:
    return _line(f"batch-{name}", argv, files, "blender.batch", refused=False, code=code)


def _put(kind: str, name: str, folder: Path) -> None:
    """A node of the case's own: none of the machine's is ever named, as what fails here would replace it."""
    path = folder / name
    if kind == "device" and os.getuid() == 0:  # nothing is behind this number: it cannot even be opened
        os.mknod(path, stat.S_IFCHR | 0o600, os.makedev(240, 250))
    elif kind == "link":
        os.mkfifo(folder / "pipe")
        path.symlink_to("pipe")
    else:
        ODD["folder" if kind == "device" else kind](path)


def _points(hands: int = 0) -> bytes:
    """Points in space, or so many hands of them."""
    data = recordings.content("points")
    if not hands:
        return data
    content = json.loads(data)
    content["hands"] = (content["hands"] * hands)[:hands]
    return json.dumps(content).encode()


def _crowded() -> bytes:
    """A zip of three million members."""
    entry = b"PK\1\2" + bytes(24) + b"\1\0" + bytes(16) + b"x"
    size = (len(entry) * 3_000_000).to_bytes(4, "little")
    return entry * 3_000_000 + b"PK\5\6" + bytes(4) + b"\xff\xff" * 2 + size + bytes(6)


def _outputs() -> Iterator[Case]:
    """Where nothing may be written, of every command that writes."""
    for verb, file, data in (
        ("capture", "a.points.json", _points),
        ("convert", "a.points.json", _points),
        ("model convert", "a.npz", models.good_bytes),
    ):
        for where in (*NODES, "link", "address", "input"):
            target = {"address": "http://a/b.npz", "input": file}.get(where, "node.npz")
            argv = [*verb.split(" "), file, *([] if "model" in verb else ["-o"]), target]
            node = {"before": partial(_put, where, target)} if where in (*NODES, "link") else {}
            known = verb in ("capture", "convert") and where in ("pipe", "device", "input")
            yield _line(
                f"output-{verb.replace(' ', '-')}-to-{where}", argv, {file: data}, known=known, **node
            )

    home = "convert a.points.json -o ~/x.npz".split(" ")
    yield Case(
        "output-convert-to-home",
        "core.process",
        lambda place: {"argv": home, "HOME": str(place.write("a.points.json", _points()).parent / RESULTS)},
        known=True,
    )


def _inputs() -> Iterator[Case]:
    """A .npz that may not be opened, or not be looked through, for every command that asks whether it is a
    take."""
    commands = {"info": [], "convert": ["-o", "result/a.bvh"], "capture": ["-o", "result/a.npz"]}
    for kind in ("pipe", "socket", "zeros"):
        for verb, more in commands.items():
            before, known = partial(_put, kind, "a.npz"), verb == "info"
            yield _line(f"npz-{kind}-{verb}", [verb, "a.npz", *more], before=before, known=known)
    yield _line("npz-3-million-members", ["info", "a.npz"], {"a.npz": _crowded}, known=True)


def cases() -> Iterator[Case]:
    yield from _outputs()
    yield from _inputs()
    for count in (201, 300, 3000):
        argv, points = (
            ["capture", "a.points.json", "-o", "kept.npz"],
            {"a.points.json": partial(_points, count)},
        )
        yield _line(f"command-{count}-hands", argv, points, known=count == 201)
    for kind, (file, data) in BAD.items():
        for output in OUTPUTS:
            name = f"{kind}-to-{output[:14].replace('/', '-').replace(chr(0), '0')}"
            name = name.encode("ascii", "replace").decode()
            yield _line(f"command-{name}", ["capture", file, "-o", output], {file: data})
        yield _line(f"process-{kind}", ["capture", file, "-o", "kept.npz"], {file: data}, "core.process")
    for name, argv in LIVE.items():
        yield _line(f"live-{name}", ["live", *argv], {"a.mp4": lambda: b"words"})
    for name, options in OPTIONS.items():
        argv = ["capture", "a.png", "-o", "result/out.npz", *options]
        yield _line(f"command-option-{name}", argv, {"a.png": BAD["picture"][1]}, refused=False)
    for name, text in TEXTS.items():
        for verb in (["info"], ["convert", "-o", "result/out.bvh"]):
            yield _line(f"command-{verb[0]}-{name}", [*verb, text])
    for name, option in (("long", "--output=--"), ("short", "-o--")):
        yield _line(f"command-output-{name}-dashes", ["capture", "kept.npz", option], refused=False)
    for reader in ("hawor", "points-table", "freemocap", "bvh", "smplx"):
        file = "a.npz" if reader == "hawor" else "a.points.json"
        yield _line(f"command-info-as-{reader}", ["info", file, "--reader", reader], {file: _points})
    for name, (file, data) in MODELS.items():
        for door in ("command", "process"):
            for verb, target in (("info", []), ("convert", ["kept.npz"])):
                argv = ["model", verb, file, *target]
                yield _line(f"{door}-model-{verb}-{name}", argv, {file: data}, f"core.{door}")
    for name, data in TAKES.items():
        argv = ["a.take.npz", "good.take.npz", "-o", "result", "--format", "glb"]
        yield _batch(name, argv, 1, {"a.take.npz": data, "good.take.npz": takes.good_bytes})
    for name, data in CHARACTERS.items():
        argv = ["kept.npz", "-o", "result", "--apply-to", "a.blend"]
        yield _batch(f"character-{name}", argv, 2, {"a.blend": lambda data=data: data})
    for name, (to, *options) in ONTO.items():
        argv = ["kept.npz", "-o", "result", "--apply-to", to, *options]
        yield _batch(f"onto-{name}", argv, 2, {"a.blend": lambda: b"words"})
    for name, (argv, code) in BATCHES.items():
        yield _batch(name, argv, code)
