"""The command lines: `python -m handfit_core` and scripts/batch_fit.py, with inputs of the other kinds."""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from tests.hostile import models, pickles, pictures, recordings, takes, videos
from tests.hostile.engine import RESULTS, Case, Place
from tests.hostile.names import TEXTS
from tests.hostile.npz import bomb

BAD: dict[str, tuple[str, Callable[[], bytes]]] = {
    "picture": ("a.png", lambda: pictures.encoded("png")[:-300]),
    "jpeg": ("a.jpg", lambda: pictures.jpeg(32000, 32000)),
    "video": ("a.mp4", lambda: videos.good_bytes()[:500]),
    "playlist": ("a.mp4", lambda: videos.HLS % b"kept.npz"),
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


NODES = ("pipe", "socket", "device")


def put(kind: str, path: Path) -> None:
    """A node of the case's own: none of the machine's is ever named, as what fails here would replace it."""
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "socket":
        os.mknod(path, stat.S_IFSOCK | 0o600)
    elif os.getuid() == 0:  # nothing is behind this number: it cannot even be opened
        os.mknod(path, stat.S_IFCHR | 0o600, os.makedev(240, 250))
    else:
        path.mkdir()


def outputs() -> Iterator[Case]:
    """Where nothing may be written, of every command that writes."""
    for verb, file, data in (
        ("capture", "a.points.json", _points),
        ("convert", "a.points.json", _points),
        ("model convert", "a.npz", models.good_bytes),
    ):
        for where in (*NODES, "link", "address", "input"):

            def make(place: Place, verb=verb, file=file, data=data, where=where) -> dict[str, Any]:
                place.write(file, data())
                target = {"address": "http://a/b.npz", "input": file}.get(where, "node.npz")
                if where == "link":
                    put("pipe", place.folder / "pipe")
                    (place.folder / target).symlink_to("pipe")
                elif where in NODES:
                    put(where, place.folder / target)
                output = [target] if "model" in verb else ["-o", target]
                return {"argv": [*verb.split(" "), file, *output]}

            name = f"output-{verb.replace(' ', '-')}-to-{where}"
            known = verb in ("capture", "convert") and where in ("pipe", "device", "input")
            yield Case(name, "core.command", make, refused=True, known=known)

    def home(place: Place) -> dict[str, Any]:
        place.write("a.points.json", _points())
        return {"argv": ["convert", "a.points.json", "-o", "~/x.npz"], "HOME": str(place.folder / RESULTS)}

    yield Case("output-convert-to-home", "core.process", home, known=True)


def _points() -> bytes:
    return recordings.content("points")


def _hands(count: int) -> bytes:
    """So many hands of points in space."""
    content = json.loads(_points())
    content["hands"] = (content["hands"] * count)[:count]
    return json.dumps(content).encode()


def odd_inputs() -> Iterator[Case]:
    """A .npz that may not be opened, or not be looked through, for every command that asks whether it is a
    take."""
    commands = {"info": [], "convert": ["-o", "result/a.bvh"], "capture": ["-o", "result/a.npz"]}
    for kind in ("pipe", "socket", "zeros"):
        for verb, more in commands.items():

            def make(place: Place, kind=kind, verb=verb, more=more) -> dict[str, Any]:
                if kind == "zeros":
                    (place.folder / "a.npz").symlink_to("/dev/zero")
                else:
                    put(kind, place.folder / "a.npz")
                return {"argv": [verb, "a.npz", *more]}

            yield Case(f"npz-{kind}-{verb}", "core.command", make, refused=True, known=verb == "info")

    def crowded(place: Place) -> dict[str, Any]:
        entry = b"PK\1\2" + bytes(24) + b"\1\0" + bytes(16) + b"x"
        size = (len(entry) * 3_000_000).to_bytes(4, "little")
        place.write("a.npz", entry * 3_000_000 + b"PK\5\6" + bytes(4) + b"\xff\xff" * 2 + size + bytes(6))
        return {"argv": ["info", "a.npz"]}

    yield Case("npz-3-million-members", "core.command", crowded, refused=True, known=True)


def cases() -> Iterator[Case]:
    yield from outputs()
    yield from odd_inputs()
    for count in (201, 300, 3000):

        def hands(place: Place, count=count) -> dict[str, Any]:
            place.write("a.points.json", _hands(count))
            return {"argv": ["capture", "a.points.json", "-o", "kept.npz"]}

        yield Case(f"command-{count}-hands", "core.command", hands, refused=True, known=count == 201)
    for kind, (file, data) in BAD.items():
        for output in OUTPUTS:

            def capture(place: Place, file=file, data=data, output=output) -> dict[str, Any]:
                place.write(file, data())
                return {"argv": ["capture", file, "-o", output]}

            name = f"{kind}-to-{output[:14].replace('/', '-').replace(chr(0), '0')}"
            yield Case(
                f"command-{name.encode('ascii', 'replace').decode()}", "core.command", capture, refused=True
            )
        yield Case(
            f"process-{kind}", "core.process",
            lambda place, file=file, data=data: {"argv": ["capture", str(place.write(file, data())), "-o", "kept.npz"]},
            refused=True,
        )  # fmt: skip
    for name, options in OPTIONS.items():

        def chosen(place: Place, options=options) -> dict[str, Any]:
            place.write("a.png", pictures.encoded("png")[:-300])
            return {"argv": ["capture", "a.png", "-o", "result/out.npz", *options]}

        yield Case(f"command-option-{name}", "core.command", chosen)
    for name, text in TEXTS.items():
        for verb in (["info"], ["convert", "-o", "result/out.bvh"]):

            def of_others(_: Place, verb=verb, text=text) -> dict[str, Any]:
                return {"argv": [*verb, text]}

            yield Case(f"command-{verb[0]}-{name}", "core.command", of_others, refused=True)
    for name, option in (("long", "--output=--"), ("short", "-o--")):
        yield Case(
            f"command-output-{name}-dashes",
            "core.command",
            lambda _, option=option: {"argv": ["capture", "kept.npz", option]},
        )
    for reader in ("hawor", "points-table", "freemocap", "bvh", "smplx", "hot3d"):

        def other(place: Place, reader=reader) -> dict[str, Any]:
            place.write("a.npz" if reader == "hawor" else "a.points.json", _points())
            return {"argv": ["info", "a.npz" if reader == "hawor" else "a.points.json", "--reader", reader]}

        yield Case(f"command-info-as-{reader}", "core.command", other, refused=True)
    for name, file, made in (
        ("bomb", "a.npz", lambda: bomb({}, "header", 3 << 29)),
        ("runs", "MANO_RIGHT.pkl", pickles.system_call),
        ("cut", "a.npz", lambda: models.good_bytes()[:-50]),
        ("half", "MANO_LEFT.pkl", lambda: pickles.mano()[:9999]),
    ):
        for door in ("command", "process"):
            for verb in (["info"], ["convert"]):

                def model(place: Place, file=file, made=made, verb=verb) -> dict[str, Any]:
                    target = ["kept.npz"] if verb == ["convert"] else []
                    return {"argv": ["model", *verb, str(place.write(file, made())), *target]}

                yield Case(f"{door}-model-{verb[0]}-{name}", f"core.{door}", model, refused=True)
    for name, make in (
        ("damaged", lambda: takes.good_bytes()[:-200]),
        ("runs", pickles.system_call),
        ("bomb", lambda: bomb({}, "header", 3 << 29)),
        ("nothing", lambda: b""),
    ):

        def batch(place: Place, make=make) -> dict[str, Any]:
            place.write("a.take.npz", make())
            place.write("good.take.npz", takes.good_bytes())
            inputs = ["a.take.npz", "good.take.npz"]
            return {"argv": [*inputs, "-o", "result", "--format", "glb"], "code": 1}

        yield Case(f"batch-{name}", "blender.batch", batch)
    for name, data in (
        ("words", b"words"),
        ("nothing", b""),
        ("header", b"BLENDER-v405REND" + bytes(range(256)) * 40),
        ("huge-block", b"BLENDER-v402DNA1\xff\xff\xff\x7f" + b"\0" * 64),
        ("zstd", b"\x28\xb5\x2f\xfd" + bytes(range(256)) * 40),
    ):

        def character(place: Place, data=data) -> dict[str, Any]:
            place.write("a.blend", data)
            return {"argv": ["kept.npz", "-o", "result", "--apply-to", "a.blend"], "code": 2}

        yield Case(f"batch-character-{name}", "blender.batch", character)
    for name, to, options in (
        ("device", "/dev/zero", []),
        ("nul", "a\0b.blend", []),
        ("surrogate", "\udcff.blend", []),
        ("long", "x" * 5000, []),
        ("colons", ":" * 5000, []),
        ("hands", "a.blend", ["--hands", "left=" + "9" * 5000]),
        ("hand", "a.blend", ["--hands", "\u202e=left"]),
        ("sides", "a.blend", ["--hands", "=,=,,"]),
        ("preset-device", "a.blend", ["--bones", "/dev/zero"]),
        ("preset-words", "a.blend", ["--bones", "a.blend"]),
        ("preset-nul", "a.blend", ["--bones", "a\0b"]),
    ):

        def told(place: Place, to=to, options=options) -> dict[str, Any]:
            place.write("a.blend", b"words")
            return {"argv": ["kept.npz", "-o", "result", "--apply-to", to, *options], "code": 2}

        yield Case(f"batch-onto-{name}", "blender.batch", told)
    for name, argv, code in (
        ("no-input", ["nowhere.npz", "-o", "result"], 1),
        ("into-a-file", ["kept.npz", "-o", "kept.npz"], 2),
        ("format", ["kept.npz", "-o", "result", "--format", "exe"], 2),
        ("long-name", ["x" * 5000, "-o", "result"], 1),
        ("surrogate", ["\udcff.npz", "-o", "result"], 1),
        ("nul", ["a\0b", "-o", "result"], 1),
        ("frames", ["kept.npz", "-o", "result", "--frames", "9" * 5000], 2),
    ):
        yield Case(
            f"batch-{name}", "blender.batch", lambda _, argv=argv, code=code: {"argv": argv, "code": code}
        )
