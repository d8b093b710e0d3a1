"""The command lines: `python -m handfit_core` and scripts/batch_fit.py, with inputs of the other kinds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from tests.hostile import models, pickles, pictures, takes, videos
from tests.hostile.engine import Case, Place
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


def cases() -> Iterator[Case]:
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
