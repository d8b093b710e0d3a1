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
from tests.hostile.engine import ODD, Case, Place, file_case, table
from tests.hostile.mutations import MUTATIONS, json_with, mutants, mutated
from tests.hostile.npz import VALUES, lies, npy_lies, raw_member, some
from tests.hostile.pickles import harms

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

    def laid_out(self, place: Place) -> dict[str, Any]:
        """All its files, in the place of a case; the arguments of the door."""
        for name, data in self.files.items():
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
    "9" * 15, "9" * 200, "-1", "0", "a_99999999999999999999", "\u0661", "x" * 200, "a\nb", "\udcff", "%n",
)  # fmt: skip
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
    if not isinstance(content, dict | list):
        return
    items = content if isinstance(content, dict) else dict(enumerate(content))
    numbered = all(str(key).isdigit() for key in items)
    for key, value in list(items.items())[: 1 if numbered else None]:
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


def _crowds() -> Iterator[Case]:
    for people in (400, 2000, 2001, 20_000):
        for spread in (1, 3000, 60_000):
            name, file = f"crowd-{people}-within-{spread}", "a_000000000000_keypoints.json"
            few, known = people <= 2000, people == 2000 and spread == 3000
            made = partial(crowd, people, spread)
            yield file_case(name, DOOR, file, made, refused=not few, known=known, good=few)


def _other_bones(pattern: str, text: str, once: bool) -> bytes:
    return re.sub(pattern, text, content("bvh").decode(), count=int(once)).encode()


def _hands(count: int) -> bytes:
    """A .npy that has so many frames."""
    return raw_member(f"({count}, 21, 3)", "'<f4'", bytes(count * 252))


def cases() -> Iterator[Case]:
    for good in goods():
        if good.given in good.files:
            yield from _of_file(good, good.files[good.given])
        else:
            yield from _of_folder(good)
    yield from table("json", DOOR, "a_0.json", JSONS)
    yield from table("csv", DOOR, "a_0.csv", TABLES)
    yield from table("jsonl", DOOR, "a.jsonl", {"lines": JSONS["lines"]})
    yield from _crowds()
    harmful = "runs-reduce-os.system"
    pickles = {name: data for name, data in harms() if name == harmful or some(name, 2)}
    yield from table("recording", DOOR, "hamer.pkl", pickles, refused=True, known=[harmful])
    arrays = {
        name: partial(lambda data: raw_member("()", "'|O'", data()), data)
        for name, data in harms()
        if some(name, 3)
    }
    yield from table("recording-npy", DOOR, "a.mano.npy", arrays, refused=True)
    yield from table("bvh", DOOR, "a.bvh", LONG_BONES)
    frames = {str(count): partial(_hands, count) for count in (50_000, 150_000, 1_000_000)}
    yield from table("freemocap", DOOR, "mediapipe_left_hand_3d_xyz.npy", frames, refused=True)
    bones = {
        name: partial(_other_bones, pattern, text, name in ("deep", "wide"))
        for name, (pattern, text) in BONES.items()
    }
    yield from table("bvh", DOOR, "a.bvh", bones)


def _of_file(good: Good, data: bytes) -> Iterator[Case]:
    name, lying = Path(good.given).name, {}
    yield file_case(f"{good.stem}-good", DOOR, name, lambda _: data, known=True, good=True)
    yield from mutants(good.stem, DOOR, lambda: data, name, 3)
    held = _lines(data, name)
    if held is not None:
        for path in _places(held):
            lying |= {
                f"{'-'.join(map(str, path))}-{value}": partial(_lying, held, path, text, name)
                for value, text in NUMBERS.items()
            }
    elif name.endswith(".csv"):
        rows = [line.split(",") for line in data.decode().splitlines()]
        for column in sorted({0, 1, 2, 3, 4, len(rows[0]) // 2, len(rows[0]) - 1}):
            lying |= {
                f"{column}-{value}": partial(_cell, rows, column, text) for value, text in CELLS.items()
            }
    elif name.endswith(".npz"):
        with np.load(io.BytesIO(data), allow_pickle=True) as archive:
            arrays = {key: archive[key] for key in archive.files}
        for case in lies(good.stem, DOOR, lambda: arrays, name, ours=False):
            if some(case.name, 3):
                yield replace(case, known=False)
    elif name.endswith(".npy") and b"'|O'" not in data[:100]:
        array = np.load(io.BytesIO(data))
        yield from npy_lies(good.stem, DOOR, lambda: array, name)
    part = 2 if name.endswith(".csv") else 11
    chosen = {lie: made for lie, made in lying.items() if some(f"{good.stem}-{lie}", part)}
    yield from table(good.stem, DOOR, name, chosen)


def _lying(held: Any, path: tuple[str | int, ...], text: str, name: str) -> bytes:
    """JSON with that text where `path` leads, or lines of it."""
    if not name.endswith(".jsonl"):
        return json_with(held, path, text).encode()
    lines = [json.dumps(line) for line in held]
    lines[0] = json_with(held[0], path[1:], text) if path[1:] else text
    return "\n".join(lines).encode()


def _cell(rows: list[list[str]], column: int, text: str) -> bytes:
    """A table with that text in its first row."""
    row = [*rows[1][:column], text, *rows[1][column + 1 :]]
    return "\n".join(map(",".join, (rows[0], row, *rows[2:]))).encode("utf-8")


def _of_folder(good: Good) -> Iterator[Case]:
    files = list(good.files)

    def case(name: str, change: Callable[[Place, Path], object], known: bool = False) -> Case:
        """The folder's files, and then what `change` does to them and beside the last of them."""

        def make(place: Place) -> dict[str, Any]:
            arguments = good.laid_out(place)
            change(place, place.folder / files[-1])
            return arguments

        return Case(f"{good.stem}-{name}", DOOR, make, known=known)

    def damage(file: str, mutation: Callable, place: Place, _: Path) -> None:
        place.write(file, mutated(good.files[file], mutation, place.rng))

    def replaced(chosen: list[str], put: Callable[[Path], object], place: Place, _: Path) -> None:
        for file in chosen:
            (place.folder / file).unlink()
            put(place.folder / file)

    def beside(called: str, _: Place, last: Path) -> None:
        name = os.fsencode(f"{called}{last.suffix}")
        Path(os.fsdecode(os.path.join(os.fsencode(last.parent), name))).write_bytes(last.read_bytes())  # noqa: PTH118

    def many(_: Place, last: Path) -> None:
        for number in range(3000):
            (last.parent / f"x_{number:06}{last.suffix}").touch()

    yield Case(f"{good.stem}-good", DOOR, lambda place: {**good.laid_out(place), "good": True}, known=True)
    for file in files:
        for mutation in MUTATIONS:
            name = f"{Path(file).stem}-{mutation.__name__}"
            if some(f"{good.stem}-{name}", 2):
                yield case(name, partial(damage, file, mutation))
    for kind, put in ODD.items():
        for which, chosen in {"first": files[:1], "last": files[-1:], "all": files}.items():
            known = kind == "pipe" and which == "all"
            yield case(f"{which}-is-a-{kind}", partial(replaced, chosen, put), known)
    for number, called in enumerate(ODD_NAMES):
        yield case(f"besides-{number}", partial(beside, called))
    yield case("with-3000-more", many)
