"""Files of other programs: damaged bytes, lies in their JSON, arrays and tables, folders that are none."""

from __future__ import annotations

import io
import json
import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from tests.core.interchange.every_format import keypoint_files, other_files
from tests.hostile.engine import Case, Place, file_case
from tests.hostile.mutations import MUTATIONS, mutants, mutated, told
from tests.hostile.npz import VALUES, lies, npy_lies, raw_member
from tests.hostile.pickles import harms
from tests.hostile.records import ODD

DOOR = "core.recording"


@dataclass(frozen=True)
class Good:
    """A valid input: its files by their names, and which of them, or of their folders, is given."""

    reader: str
    given: str
    files: dict[str, bytes]

    @property
    def stem(self) -> str:
        return f"{self.reader}-{self.given.replace('/', '-').replace('.', '-')}"

    def laid_out(self, place: Place, changed: dict[str, bytes] | None = None) -> dict[str, Any]:
        """All its files, some with other bytes, in the place of a case; the arguments of the door."""
        for name, data in (self.files | (changed or {})).items():
            place.write(name, data)
        return {"path": str(place.folder / self.given)}


@cache
def goods() -> list[Good]:
    found = []
    with TemporaryDirectory() as name:
        folder = Path(name)
        for reader, paths in (keypoint_files(folder) | other_files(folder)).items():
            for path in paths:
                files = [path] if path.is_file() else sorted(filter(Path.is_file, path.rglob("*")))
                data = {str(file.relative_to(folder)): file.read_bytes() for file in files}
                found.append(Good(reader, str(path.relative_to(folder)), data))
    return found


def content(reader: str) -> bytes:
    """A file of that reader."""
    return next(
        good.files[good.given] for good in goods() if good.reader == reader and good.given in good.files
    )


NUMBERS = {
    **VALUES,
    "far": "2147483648", "farther": "999999999999999", "farthest": "9223372036854775808", "half": "0.5", "digits": '"99999999999999"',
    "many": "[" + "0," * 200_000 + "0]", "bodies": "[" + "{}," * 50_000 + "{}]", "words": "[" + '"x",' * 30 + '"x"]',
}  # fmt: skip
"""What may stand in JSON where something else is expected, by name"""

CELLS = {
    "nan": "nan", "infinity": "inf", "huge": "1e999", "large": "1e300", "digits": "9" * 5000, "empty": "", "minus": "-1", "far": "2147483648",
    "farther": "999999999999999", "half": "0.5", "hexadecimal": "0x10", "underscore": "1_0", "words": "words", "quote": '"', "nul": "\0",
    "comma": "1,2", "greek": "\u0661", "long": "x" * 200_000,
}  # fmt: skip

TABLES: dict[str, Callable[[], bytes]] = {
    "columns-2-million": lambda: b"x,y," * 1_000_000 + b"z\n" + b"1,2," * 1_000_000 + b"3\n",
    "columns-9999": lambda: b",".join(b"left_hand_%d_x" % n for n in range(9999)) + b"\n" + b"1," * 9998 + b"1\n",
    "hands-by-thousands": lambda: b",".join(b"hand%d_landmark%d_%c" % (n // 12, n // 2 % 6, b"xy"[n % 2]) for n in range(9600)) + b"\n" + (b"0.5," * 9599 + b"0.5\n") * 1500,
    "rows-30-million": lambda: b"frame,x\n" + b"1,2\n" * 30_000_000,
    "cells-60-million": lambda: b"frame,x\n" + b"," * 60_000_000,
    "cell-of-130000": lambda: b"frame,side,point,x_px,y_px\n" + b"".join(b"%d,%s,0,1,2\n" % (n, b"x" * (130_000 if n == 9 else 1)) for n in range(20_000)),
    "empty-lines": lambda: b"frame,x\n" + b"\n" * 100_000_000,
    "one-cell": lambda: b'frame,x\n"' + b"x" * 100_000_000,
    "quotes": lambda: b"frame,x\n" + b'"' * 50_000_000,
    "too-large": lambda: b"frame,x\n" + bytes(520_000_000),
    "same-names": lambda: b"frame,side,point,x_px,y_px,x_px,y_px\n1,left,0,1,2,3,4\n",
    "only-names": lambda: b"frame,side,point,x_px,y_px\n",
    "no-names": lambda: b",,,,\n,,,,\n",
    "all-hands": lambda: b"frame,hand,side,point,x_px,y_px\n" + b"".join(b"1,%d,left,%d,5,5\n" % (n // 21, n % 21) for n in range(42_000)),
    "far-frames": lambda: b"frame,side,point,x_px,y_px\n" + b"".join(b"%d,left,%d,5,5\n" % (10**n, m) for n in range(15) for m in range(21)),
    "nul": lambda: b"frame,side,point,x_px,y_px\n1,left,0,\0,2\n",
    "not-utf-8": lambda: b"frame,side,point,x_px,y_px\n1,l\xff\xfeft,0,1,2\n",
    "utf-16": lambda: "frame,side,point,x_px,y_px\n1,left,0,1,2\n".encode("utf-16"),
}  # fmt: skip

JSONS: dict[str, Callable[[], bytes]] = {
    "nothing": lambda: b"", "deep": lambda: b"[" * 5_000_000, "deep-objects": lambda: b'{"frames":' * 1_000_000,
    "lists": lambda: b"[" + b"[]," * 20_000_000 + b"[]]", "objects": lambda: b"[" + b"{}," * 20_000_000 + b"{}]",
    "numbers": lambda: b"[" + b"9," * 50_000_000 + b"9]", "floats": lambda: b"[" + b".5," * 100 + b"1.5]",
    "reals": lambda: b"[" + b"1e5," * 30_000_000 + b"1e5]", "texts": lambda: b"[" + b'"ab",' * 25_000_000 + b'""]',
    "keys": lambda: b'{"frames":{' + b",".join(b'"%d":[]' % n for n in range(5_000_000)) + b"}}",
    "frames": lambda: b'{"frames":{' + b",".join(b'"%d":[]' % n for n in range(100_000)) + b"}}",
    "long-number": lambda: b"[" + b"9" * 50_000_000 + b"]", "long-text": lambda: b'["' + b"x" * 120_000_000 + b'"]',
    "escapes": lambda: b'["' + rb"\ud83d\ude00" * 8_000_000 + b'"]', "wide": lambda: b'["' + b"x" * 100_000_000 + "\U0001f590".encode() + b'"]',
    "people": lambda: b'{"people":[' + b'{"pose_keypoints_2d":[]},' * 1_000_000 + b"{}]}",
    "points": lambda: b'{"format":"handfit-points","version":1,"frames":[' + b"1," * 1_000_000 + b'2],"hands":[]}',
    "300000-frames": lambda: b'{"frames":[' + b'{"a":1},' * 300_000 + b"{}]}", "300000-people": lambda: b'{"people":[' + b'{"a":1},' * 300_000 + b"{}]}",
    "digits-4300": lambda: b'{"format":"handfit-points","version":' + b"9" * 4300 + b"}", "deep-900": lambda: b"[" * 900 + b"]" * 900,
    "keys-of-terminals": lambda: json.dumps({"a\x1b[2J\x07\r": 1, "\u202e": 2}).encode(), "long-key": lambda: b'{"' + b"x" * 1_000_000 + b'":[]}',
    "lines": lambda: b"{}\n" * 40_000_000, "too-large": lambda: b"[" + b" " * 500_000_000 + b"]", "zeros": lambda: bytes(1000),
}  # fmt: skip

BONES: dict[str, tuple[str, str]] = {
    "frames-many": (r"Frames: *\d+", "Frames: 999999999999"), "frames-minus": (r"Frames: *\d+", "Frames: -5"),
    "frames-none": (r"Frames: *\d+", "Frames: 0"), "frames-words": (r"Frames: *\d+", "Frames: " + "9" * 5000),
    **{f"time-{name}": (r"Frame Time: *\S+", f"Frame Time: {value}") for name, value in {"zero": "0", "nan": "nan", "infinite": "inf",
       "minus": "-1", "tiny": "1e-300", "large": "1e300", "words": "x"}.items()},
    **{f"offset-{name}": (r"OFFSET +\S+", f"OFFSET {value}") for name, value in {"nan": "nan", "infinite": "inf", "huge": "1e308",
       "zero": "0", "words": "x"}.items()},
    "channels-many": (r"CHANNELS +\d", "CHANNELS 999999999"), "channels-none": (r"CHANNELS +\d", "CHANNELS 0"),
    "channels-minus": (r"CHANNELS +\d", "CHANNELS -3"), "turns-nan": (r"(?<=Frame Time: )(\S+)\s+\S+", r"\1\nnan"),
    "turns-huge": (r"(?<=Frame Time: )(\S+)\s+\S+", r"\1\n1e308"), "no-braces": (r"[{}]", ""), "names": (r"JOINT +\S+", "JOINT " + "x" * 3000),
    "deep": (r"JOINT", "JOINT x {\n OFFSET 0 0 0\n CHANNELS 0\n" * 100_000 + "JOINT"),
    "wide": (r"End Site", "End Site {\n OFFSET 0 0 0\n}\n" * 100_000 + "End Site"),
}  # fmt: skip
"""What in a BVH is replaced, each time that it is there but for `deep` and `wide`"""

ODD_NAMES = (
    "9" * 15,
    "9" * 200,
    "-1",
    "0",
    "a_99999999999999999999",
    "\u0661",
    "x" * 200,
    "a\nb",
    "\udcff",
    "%n",
)
"""What files of a folder may be called besides"""


ROOT = "HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\nCHANNELS 3 Xrotation Yrotation Zrotation\n%s}\nMOTION\nFrames: %d\nFrame Time: 0.04\n"
LONG_BONES: dict[str, Callable[[], bytes]] = {
    "words-in-one-line": lambda: b"HIERARCHY " + b"a " * 60_000_000 + b"\nMOTION\nFrames: 1\nFrame Time: 1\n0\n",
    "numbers-in-one-line": lambda: (ROOT % ("", 1)).encode() + b"0 " * 60_000_000,
    "frames-in-one-line": lambda: (ROOT % ("", 20_000_000)).encode() + b"0 " * 60_000_000,
    "one-number": lambda: (ROOT % ("", 1)).encode() + b"1" * 120_000_000,
    "one-time": lambda: (ROOT % ("", 1)).encode()[:-5] + b"1" * 120_000_000,
    "bones-and-frames": lambda: (ROOT % ("JOINT b\n{\nOFFSET 0 0 0\n}\n" * 1500, 5500)).encode() + b"0 0 0\n" * 5500,
}  # fmt: skip


def _places(content: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Where something stands, one of each kind: the first of a list, and of what numbers name."""
    if path:
        yield path
    items = list(
        content.items()
        if isinstance(content, dict)
        else enumerate(content)
        if isinstance(content, list)
        else ()
    )
    numbered = isinstance(content, list) or all(str(key).isdigit() for key, _ in items)
    for key, value in items[: 1 if numbered else None]:
        yield from _places(value, (*path, key))


def _lines(data: bytes, name: str) -> Any:
    """What JSON, or a line of JSON each, holds; None: it is none."""
    if name.endswith(".jsonl"):
        return [json.loads(line) for line in data.splitlines()]
    return json.loads(data) if name.endswith(".json") else None


def crowd(people: int, spread: int, place: Place) -> bytes:
    """OpenPose's people, each with two hands of points anywhere in a box of 100 pixels."""
    rng = np.random.default_rng(place.rng.randrange(1 << 32))

    def hand() -> list[float]:
        points = rng.uniform(0, spread, 2) + rng.uniform(0, 100, (21, 2))
        return np.column_stack([points, np.full(21, 0.9)]).round(1).ravel().tolist()

    keys = "hand_left_keypoints_2d", "hand_right_keypoints_2d"
    each = [{"pose_keypoints_2d": [], **{key: hand() for key in keys}} for _ in range(people)]
    return json.dumps({"version": 1.3, "people": each}).encode()


def _some(name: str, part: int) -> bool:
    """Whether this is one of a part of the cases, which are more than anybody waits for."""
    return sum(name.encode("utf-8", "replace")) % part == 0


def cases() -> Iterator[Case]:
    for good in goods():
        if good.given in good.files:
            yield from _of_file(good, good.files[good.given])
        else:
            yield from _of_folder(good)
    for kinds, ending in ((JSONS, "json"), (TABLES, "csv")):
        for name, data in kinds.items():
            yield file_case(f"{ending}-{name}", DOOR, f"a_0.{ending}", lambda _, data=data: data())
    yield file_case("jsonl-lines", DOOR, "a.jsonl", lambda _: JSONS["lines"]())
    for people in (400, 2000, 2001, 20_000):
        for spread in (1, 3000, 60_000):
            made = lambda place, people=people, spread=spread: crowd(people, spread, place)  # noqa: E731
            name, file = f"crowd-{people}-within-{spread}", "a_000000000000_keypoints.json"
            few, known = people <= 2000, people == 2000 and spread == 3000
            yield file_case(name, DOOR, file, made, refused=not few, known=known, good=few)
    for name, data in harms():
        known = name == "runs-reduce-os.system"
        if known or _some(name, 2):
            yield file_case(
                f"recording-{name}", DOOR, "hamer.pkl", lambda _, data=data: data(), refused=True, known=known
            )
        if _some(name, 3):
            in_npy = lambda _, data=data: raw_member("()", "'|O'", data())  # noqa: E731
            yield file_case(f"recording-npy-{name}", DOOR, "a.mano.npy", in_npy, refused=True)
    for name, data in LONG_BONES.items():
        yield file_case(f"bvh-{name}", DOOR, "a.bvh", lambda _, data=data: data())
    for count in (50_000, 150_000, 1_000_000):
        hands = lambda _, count=count: raw_member(f"({count}, 21, 3)", "'<f4'", bytes(count * 252))  # noqa: E731
        yield file_case(f"freemocap-{count}", DOOR, "mediapipe_left_hand_3d_xyz.npy", hands, refused=True)
    bvh = content("bvh").decode()
    for name, (pattern, text) in BONES.items():
        changed = partial(
            lambda p, t, n, _: re.sub(p, t, bvh, count=n).encode(),
            pattern,
            text,
            int(name in ("deep", "wide")),
        )
        yield file_case(f"bvh-{name}", DOOR, "a.bvh", changed)


def _of_file(good: Good, data: bytes) -> Iterator[Case]:
    name = Path(good.given).name
    yield file_case(f"{good.stem}-good", DOOR, name, lambda _: data, known=True, good=True)
    yield from mutants(good.stem, DOOR, lambda: data, name, 3)
    held = _lines(data, name)
    if held is not None:
        for path in _places(held):
            for value, text in NUMBERS.items():
                case = f"{good.stem}-{'-'.join(map(str, path))}-{value}"
                if _some(case, 11):

                    def lie(_: Place, path=path, text=text) -> bytes:
                        if not name.endswith(".jsonl"):
                            return told(held, path, text).encode()
                        lines = [json.dumps(line) for line in held]
                        lines[0] = told(held[0], path[1:], text) if path[1:] else text
                        return "\n".join(lines).encode()

                    yield file_case(case, DOOR, name, lie)
    elif name.endswith(".csv"):
        rows = [line.split(",") for line in data.decode().splitlines()]
        for column in sorted({0, 1, 2, 3, 4, len(rows[0]) // 2, len(rows[0]) - 1}):
            for value, text in CELLS.items():
                case = f"{good.stem}-{column}-{value}"
                if _some(case, 2):

                    def cell(_: Place, column=column, text=text) -> bytes:
                        row = [*rows[1][:column], text, *rows[1][column + 1 :]]
                        return "\n".join(map(",".join, (rows[0], row, *rows[2:]))).encode("utf-8")

                    yield file_case(case, DOOR, name, cell)
    elif name.endswith(".npz"):
        with TemporaryDirectory() as folder:
            file = Path(folder, name)
            file.write_bytes(data)
            with np.load(file, allow_pickle=True) as archive:
                arrays = {key: archive[key] for key in archive.files}
        for case in lies(good.stem, DOOR, lambda: arrays, name, ours=False):
            if _some(case.name, 3):
                yield replace(case, known=False)
    elif name.endswith(".npy") and b"'|O'" not in data[:100]:
        array = np.load(io.BytesIO(data))
        yield from npy_lies(good.stem, DOOR, lambda: array, name)


def _of_folder(good: Good) -> Iterator[Case]:
    yield Case(f"{good.stem}-good", DOOR, lambda place: {**good.laid_out(place), "good": True}, known=True)
    for file in good.files:
        stem = f"{good.stem}-{Path(file).stem}"
        for mutation in MUTATIONS:
            if _some(f"{stem}-{mutation.__name__}", 2):

                def mutant(place: Place, file=file, mutation=mutation) -> dict[str, Any]:
                    return good.laid_out(place, {file: mutated(good.files[file], mutation, place.rng)})

                yield Case(f"{stem}-{mutation.__name__}", DOOR, mutant)
    files = list(good.files)
    for kind, put in ODD.items():
        for place_of in ("first", "last", "all"):

            def odd(place: Place, put=put, place_of=place_of) -> dict[str, Any]:
                arguments = good.laid_out(place)
                for file in {"first": files[:1], "last": files[-1:], "all": files}[place_of]:
                    (place.folder / file).unlink()
                    put(place.folder / file)
                return arguments

            yield Case(
                f"{good.stem}-{place_of}-is-a-{kind}", DOOR, odd, known=kind == "pipe" and place_of == "all"
            )
    for number, called in enumerate(ODD_NAMES):

        def besides(place: Place, called=called) -> dict[str, Any]:
            arguments = good.laid_out(place)
            last = place.folder / files[-1]
            name = os.fsencode(f"{called}{last.suffix}")
            Path(os.fsdecode(os.path.join(os.fsencode(last.parent), name))).write_bytes(last.read_bytes())  # noqa: PTH118
            return arguments

        yield Case(f"{good.stem}-besides-{number}", DOOR, besides)

    def many(place: Place) -> dict[str, Any]:
        arguments = good.laid_out(place)
        last = place.folder / files[-1]
        for number in range(3000):
            (last.parent / f"x_{number:06}{last.suffix}").touch()
        return arguments

    yield Case(f"{good.stem}-with-3000-more", DOOR, many)
