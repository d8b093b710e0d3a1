"""A file or folder of another program, opened once for all readers, and read with limits.

Nothing in it is run: pickles are read by `safe_pickle`, and only where a reader asks for them.
"""

from __future__ import annotations

import contextlib
import csv
import io
import json
import math
import os
import re
import zlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, NoReturn

import numpy as np

from handfit_core.common import safe_pickle
from handfit_core.common.errors import InputError
from handfit_core.common.files import path_of, read_file, shown, why
from handfit_core.common.npz import NotNpz, NpzArchive, npy_array, npy_pickle
from handfit_core.interchange.settings import LIMITS

_NPY: Final = b"\x93NUMPY"
_COMMA: Final = re.compile(r"^(\s*-?\d+),(\d+(?:[eE][-+]?\d+)?\s*)$")
"""A number as it is written where a comma stands before decimals"""
_LONG_NUMBER: Final = re.compile(rb"\d{%d}" % LIMITS.digits)


@dataclass(frozen=True, eq=False)
class Table:
    """The content of a CSV file: named columns of numbers and texts."""

    columns: tuple[str, ...]
    rows: list[list[str]]
    """The table's R rows of texts, each as long as `columns`"""
    is_trc: bool = False
    """True if the file was a .trc, whose markers' names are in `columns`"""

    def texts(self, column: str) -> list[str]:
        """Return the R texts of one column. Raises KeyError where there is none of that name."""
        if column not in self.columns:
            raise KeyError(column)
        index = self.columns.index(column)
        return [row[index].strip() for row in self.rows]

    def numbers(self, columns: Sequence[str]) -> np.ndarray:
        """Return (R, len(columns)) floats, NaN where a cell is empty or no number. Raises KeyError."""
        numbers = np.array([[_number(cell) for cell in self.texts(name)] for name in columns])
        return numbers.reshape(len(columns), -1).T


def _number(cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan


class Document:
    """A file or folder and its contents in every form that readers ask for. A form in which it cannot be read
    is None, whatever is wrong with it; a file that cannot be read at all, or holds more than `LIMITS` allow,
    raises InputError."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = path_of(path)
        self.cut = ""
        """A phrase for the user about a file that breaks off, set once the file was read; else empty"""
        self.has_lines = False
        """True once a file was read that has a JSON text on each line"""
        self.is_folder = os.path.isdir(self.path)  # noqa: PTH112  (raises for no name, however long)

    def _refuse(self, what: str) -> NoReturn:
        raise InputError(f"{shown(self.path)}: {what}")

    @property
    def suffix(self) -> str:
        """The ending of the file's name, in small letters; empty for a folder."""
        return "" if self.is_folder else self.path.suffix.lower()

    @cached_property
    def bytes(self) -> bytes:
        """The file's contents; empty for a folder. Raises InputError."""
        if self.is_folder:
            return b""
        try:
            return read_file(self.path, LIMITS.file_bytes)
        except (OSError, ValueError) as error:
            raise InputError(f"{shown(self.path)}: cannot be read ({why(error)})") from error

    @cached_property
    def text(self) -> str | None:
        """The file's text, decoded as UTF-8; None where it is no UTF-8."""
        try:
            return self.bytes.decode("utf-8-sig")
        except UnicodeDecodeError:
            return None

    def _check_room(self, parsed: int) -> None:
        """Raise InputError for a text that would take too much memory, of which what is in it takes `parsed`
        bytes, or that has a number too long to be one."""
        # All letters of a text are stored as wide as its widest, in up to 4 bytes, and its parts once more.
        taken = len(self.bytes) * (2 if self.bytes.isascii() else 9) + parsed
        if len(self.bytes) > LIMITS.text_bytes or taken > LIMITS.parsed_bytes:
            self._refuse("it is too large to be read at once; cut it into parts")
        if _LONG_NUMBER.search(self.bytes):
            self._refuse(f"it has a number of {LIMITS.digits} digits or more, which no program writes")

    def _checked(self, content: Any) -> Any:
        """Return what a JSON text holds. Raises InputError beyond the limits."""
        level = [content]
        for _ in range(LIMITS.depth):
            below: list[Any] = []
            for part in level:
                if isinstance(part, dict) and any(len(key) > LIMITS.letters for key in part):
                    self._refuse(f"it has a key of more than {LIMITS.letters} letters")
                within = part.values() if isinstance(part, dict) else part
                inner = [each for each in within if isinstance(each, dict | list)]
                if max(len(inner), len(part) if isinstance(part, dict) else 0) > LIMITS.entries:
                    self._refuse(
                        f"it has a list of {len(part)} parts, and at most {LIMITS.entries} are read; cut it "
                        "into parts"
                    )
                below += inner
            if not below:
                return content
            level = below
        self._refuse(f"its lists and objects lie more than {LIMITS.depth} deep in one another")

    @cached_property
    def json(self) -> Any:
        """The list or object in a JSON file, or, of a file with a JSON text on each line (.jsonl), the list
        of these."""
        start = self.bytes[:64].removeprefix(b"\xef\xbb\xbf").lstrip()[:1]
        if start not in (b"{", b"["):
            return None
        self._check_room(_memory_of_json(self.bytes))
        for read in (json.loads, self._lines):
            with contextlib.suppress(ValueError, RecursionError):
                return None if self.text is None else self._checked(read(self.text))
        return None

    def _lines(self, text: str) -> list[Any]:
        """Return what the lines of a text hold that each are JSON; the last one may break off. Raises
        ValueError."""
        *texts, last = [line for line in text.splitlines() if line.strip()]
        told = [json.loads(line) for line in texts]
        try:
            told.append(json.loads(last))
        except ValueError:
            if not told:
                raise
            self.cut = "its last line breaks off, and is left out"
        self.has_lines = True
        return told

    @cached_property
    def table(self) -> Table | None:
        """The content of a CSV file whose first line names its columns; None also where lines differ in
        length."""
        is_trc = self.bytes[:12] == b"PathFileType"
        if self.suffix not in (".csv", ".tsv", ".txt", ".trc") and not is_trc:
            return None
        lines, cells = (sum(map(self.bytes.count, signs)) for signs in ((b"\n", b"\r"), (b",", b"\t")))
        self._check_room(64 * lines + 58 * cells)
        with io.TextIOWrapper(io.BytesIO(self.bytes), "utf-8-sig", newline="") as text:
            try:
                read = csv.reader(text, delimiter=self._delimiter)
                rows = [line for line in read if line]
            except (csv.Error, UnicodeDecodeError):
                return None
        if self._delimiter == ";":
            rows = [[_COMMA.sub(r"\1.\2", cell) for cell in row] for row in rows]
        rows = _rows_of_trc(rows) if is_trc else _with_one_line_of_names(rows)
        if len(rows) < 2 or not 1 < len(rows[0]) <= LIMITS.columns:
            return None
        if len(rows) > 2 and len(rows[-1]) < len(rows[0]):
            self.cut = "its last line breaks off, and is left out"
            rows.pop()
        if any(len(row) != len(rows[0]) for row in rows):
            return None
        if any(len(cell) > LIMITS.letters for row in rows for cell in row):
            self._refuse(f"it has a cell of more than {LIMITS.letters} letters")
        return Table(tuple(name.strip() for name in rows[0]), rows[1:], is_trc)

    @property
    def _delimiter(self) -> str:
        """Return the character that separates a table's cells, by its first lines."""
        start = self.bytes[:4096]
        most = max((",", "\t", ";"), key=lambda sign: start.count(sign.encode()))
        return most if most.encode() in start else " "

    @cached_property
    def numbers(self) -> np.ndarray | None:
        """The (R, C) numbers of a table whose columns have no names, or are x, y and maybe z alone."""
        if self.suffix not in (".csv", ".tsv", ".txt") or self.table is None:
            return None
        if "".join(self.table.columns).lower() in ("xy", "xyz"):
            return self.table.numbers(self.table.columns)
        first = [_number(name) for name in self.table.columns]
        if not np.isfinite(first).all():
            return None
        return np.array([first, *([_number(cell) for cell in row] for row in self.table.rows)])

    @cached_property
    def arrays(self) -> dict[str, np.ndarray]:
        """The arrays of numbers in a .npy, a .npz, a pickle or a table without names, by their names."""
        if self.npz is None:
            alone = next((a for a in (self.npy, self.objects, self.numbers) if a is not None), None)
            frames = alone if isinstance(alone, list) else ()
            if frames and all(isinstance(f, np.ndarray) and f.shape == frames[0].shape for f in frames):
                alone = np.array(frames)
            named = alone if isinstance(alone, dict) else {self.path.stem: alone}
            return {name: array for name, array in named.items() if isinstance(array, np.ndarray)}
        found = {}
        for name in self.npz.names:
            with contextlib.suppress(NotNpz):
                found[name] = self.npz.array(name, "fiub")
        return found

    @cached_property
    def _zip(self) -> NpzArchive | None:
        try:
            return NpzArchive(self.bytes, LIMITS.array_bytes) if self.bytes[:2] == b"PK" else None
        except NotNpz:
            return None

    @property
    def _torch(self) -> str | None:
        """The place in a zip of PyTorch at which its pickle and its storages lie; None for all other
        files."""
        names = self._zip.names if self._zip else ()
        return next((name[:-8] for name in names if name == "data.pkl" or name.endswith("/data.pkl")), None)

    @property
    def npz(self) -> NpzArchive | None:
        """The arrays of a .npz; None for all other files."""
        return None if self._torch is not None else self._zip

    @cached_property
    def npy(self) -> np.ndarray | None:
        """The numbers of a .npy, floats as float64; None for all other files."""
        try:
            is_npy = self.bytes[:6] == _NPY
            return npy_array(self.bytes, "fiub", LIMITS.array_bytes) if is_npy else None
        except NotNpz:
            return None

    @cached_property
    def _unpickled(self) -> tuple[Any, str]:
        """The Python objects that a .npy, a pickle or a file of PyTorch holds, and the reason why they cannot
        be had; both empty for all other files."""
        try:
            if self._zip is not None and self._torch is not None:
                return self._of_torch(self._zip, self._torch), ""
            if self.bytes[:1] == b"\x80":
                return _plain_of(self.bytes), ""
            if self.bytes[:6] == _NPY:
                return _plain_of(npy_pickle(self.bytes)), ""
            if pickled := _inflated(self.bytes):
                return _plain_of(pickled), ""
        except (NotNpz, safe_pickle.Refused) as error:
            return None, str(error)
        return None, ""

    @staticmethod
    def _of_torch(archive: NpzArchive, within: str) -> Any:
        """Return what a zip of PyTorch holds. Raises NotNpz and Refused."""
        order = f"{within}byteorder"
        if order in archive and archive.contents(order) != b"little":
            raise safe_pickle.Refused("has its bytes in an order that is not read")
        pickled = archive.contents(f"{within}data.pkl")
        return _plain_of(pickled, lambda key: archive.contents(f"{within}data/{key}"))

    @property
    def objects(self) -> Any:
        """The Python objects that a .npy, a pickle (also joblib's) or a file of PyTorch holds: dictionaries,
        lists, texts, numbers and arrays. They are read without running anything in the file."""
        return self._unpickled[0]

    @property
    def held(self) -> Any:
        """The content of a JSON file, or the objects of a .npy, a pickle or a file of PyTorch."""
        return self.json if self.json is not None else self.objects

    @property
    def names(self) -> list[str]:
        """The names of the arrays of a .npz, or the keys of a dictionary in JSON, a .npy or a pickle."""
        if self.npz is not None:
            return self.npz.names
        return list(self.held) if isinstance(self.held, dict) else []

    def value(self, name: str) -> Any:
        """Return the value that stands under one of the `names`: an array, a text, or a dictionary or list of
        such; None where there is none. Raises InputError for what cannot be read."""
        if self.npz is None:
            return self.held.get(name) if isinstance(self.held, dict) else None
        if name not in self.npz:
            return None
        try:
            return self.npz.array(name, "fiubU")
        except NotNpz as error:
            try:
                return _plain_of(self.npz.pickle(name))
            except NotNpz:
                raise InputError(f"{shown(self.path)}: this file {error}") from error
            except safe_pickle.Refused as reason:
                raise InputError(f"{shown(self.path)}: refused: its {name} {reason}") from error

    def array(self, name: str, kinds: str = "fiub") -> np.ndarray:
        """Return one array of a .npz, floats as float64. Raises InputError where it is missing or damaged."""
        if self.npz is None:
            self._refuse("not an .npz, or a damaged one")
        try:
            return self.npz.array(name, kinds)
        except KeyError:
            raise InputError(f"{shown(self.path)}: it lacks the array {name}") from None
        except NotNpz as error:
            raise InputError(f"{shown(self.path)}: this file {error}") from error

    def files(self, *suffixes: str) -> list[Path]:
        """Return the files of a folder with one of these endings, sorted by name; none for a file. Raises
        InputError."""
        if not self.is_folder:
            return []
        try:
            with os.scandir(self.path) as entries:
                found = [entry.name for entry in entries if entry.name.lower().endswith(suffixes)]
        except OSError as error:
            raise InputError(f"{shown(self.path)}: cannot be read ({why(error)})") from error
        if len(found) > LIMITS.file_count:
            self._refuse(f"it has more than {LIMITS.file_count} files; give a folder of fewer")
        return [self.path / name for name in sorted(found) if not name.startswith(".")]

    @property
    def media(self) -> str:
        """ "a picture" or "a video" by its first bytes; empty for anything else."""
        start = self.bytes[:16]
        if start[4:8] == b"ftyp":
            return "a picture" if start[8:11] in (b"hei", b"mif", b"avi") else "a video"
        if start[:4] == b"RIFF":
            return "a video" if start[8:11] == b"AVI" else "a picture"
        return next((kind for signs, kind in _MEDIA for sign in signs if start.startswith(sign)), "")

    @property
    def found(self) -> str:
        """Return a phrase for the user: what the file or folder is by its content, and what can be done where
        it is of a kind that is not read."""
        if self.is_folder:
            counts = {ending: len(self.files(ending)) for ending in _COUNTED}
            some = [f"{count} {ending}" for ending, count in counts.items() if count]
            return (
                f"a folder with {', '.join(some)} files" if some else "a folder without files that are read"
            )
        if not self.bytes:
            return "an empty file"
        kind = self.media or next((what for sign, what in _OTHERS if self.bytes.startswith(sign)), "")
        held, refused = self._unpickled
        if kind and held is None and not refused:
            return kind
        inner = next(iter(held.values()), None) if isinstance(held, dict) else None
        names = {*self.names, *(inner if isinstance(inner, dict) else ())}
        what = next((what for sign, what in _NAMED if set(sign.split()) <= names), "")
        if what:
            return what
        if self._zip is not None and "[Content_Types].xml" in self._zip.names:
            return "a spreadsheet or another document; save its table as CSV"
        if self.npz is not None:
            return f"an .npz with {_some(self.npz.names)}"
        if self.bytes[:2] == b"PK" and self._torch is None:
            return "a zip archive, or a damaged .npz; unpack it first"
        if b'"joint_angles"' in self.bytes[:4096] and self.json:
            return (
                "the angles of UmeTrack's joints (HOT3D), which are not read; give "
                "mano_hand_pose_trajectory.jsonl, which lies beside them"
            )
        if self.json is not None:
            first = self.json[0] if self.has_lines else self.json
            return f"{'lines of ' if self.has_lines else ''}JSON with {_held(first)}"
        if self.npy is not None:
            return f"an .npy of the shape {'x'.join(map(str, self.npy.shape)) or 'of one number'}"
        whose = "a pickle" if self._torch is None else "PyTorch's file"
        if isinstance(held, np.ndarray):
            return f"{whose} with an array of the shape {'x'.join(map(str, held.shape)) or 'of one number'}"
        if held is not None:
            return f"{whose} with {_held(held)}"
        if refused:
            why_not = "is not read, as it could run programs: " if "asks to run" in refused else ""
            return f"{whose} that {refused}; {why_not}write what is in it as .npz or JSON"
        if self.table is not None and self.numbers is not None:
            return f"a table of {len(self.numbers)}x{self.numbers.shape[1]} numbers without names"
        if self.table is not None:
            return f"a table with the columns {_some(self.table.columns)}"
        if self.bytes.lstrip()[:1] in (b"{", b"["):
            return _damage(self.bytes.decode("utf-8", "replace"))
        if self.text is not None:
            return (
                f"a text, and no table with a cell below each name; it begins with {self.text.strip()[:40]!r}"
            )
        return f"a file of {len(self.bytes)} bytes of a kind that is not known"


_COUNTED: Final = (".json", ".npz", ".npy", ".csv", ".pkl", ".pt", ".pth")
_MEDIA: Final = (
    (
        (b"\x89PNG", b"\xff\xd8\xff", b"GIF8", b"II*\0", b"MM\0*", b"BM", b"v/1\x01", b"SDPX", b"XPDS"),
        "a picture",
    ),
    ((b"\x1aE\xdf\xa3", b"\0\0\x01\xba", b"OggS", b"FLV"), "a video"),
)
_IN_BLENDER: Final = "{}; import it in Blender and export its hands as BVH"
_OTHERS: Final = (
    (b"Kaydara FBX", _IN_BLENDER.format("an FBX")),
    (b"; FBX", _IN_BLENDER.format("an FBX")),
    (b"#usda", _IN_BLENDER.format("a USD stage")),
    (b"PXR-USDC", _IN_BLENDER.format("a USD stage")),
    (b"Vocaloid Motion Data", _IN_BLENDER.format("MikuMikuDance's motion")),
    (b"<?xml", "XML, as Xsens' MVNX is; export its hands as BVH"),
    (b"Format Version,", "Motive's table; write its markers as .trc"),
    (b"NO_OF_FRAMES", "Qualisys' table; write its markers as .trc"),
    (b"glTF", "a glTF or VRM model, without hands that were captured"),
    (b"BLENDER", "a .blend; open it in Blender"),
    (b"\x89HDF", "HDF5 (DeepLabCut, SLEAP); export its points as CSV"),
    (b"\x1f\x8b", "a gzip archive; unpack it first"),
    (b"7z", "a 7z archive; unpack it first"),
    (b"BZh", "a bzip2 archive; unpack it first"),
    (b"\xfd7zXZ", "an xz archive; unpack it first"),
    (b"\x02P", "a C3D; export its markers as .trc"),
)
"""The bytes with which files of kinds begin that are not read"""
_NAMED: Final = (
    ("hands_components", "MANO's own model, which is given as --model"),
    ("pred_vertices", "surfaces without MANO's parameters; have the program save pred_mano_params, too"),
    ("global_orient body_pose", "a body of SMPL without hands"),
    ("root_orient pose_body", "a body of SMPL without hands"),
    ("pose_world trans_world", "a body of SMPL without hands"),
)
"""Names of arrays or keys that identify kinds of file that cannot be read, and what to tell the user about
each"""


def _damage(text: str) -> str:
    """Return a phrase about what is wrong with a JSON text, or with lines of it."""
    for number, line in enumerate((line for line in text.splitlines() if line.strip()), 1):
        try:
            json.loads(line)
        except (ValueError, RecursionError):
            if number > 1:
                return f"lines of JSON, of which line {number} is damaged"
            break
    try:
        json.loads(text)
    except ValueError as error:
        at = getattr(error, "lineno", 1)
        return f"damaged JSON: it breaks off, or has something that is no JSON in line {at}"
    except RecursionError:
        pass
    return "JSON whose lists lie too deep in one another"


def _is_name(cell: str) -> bool:
    try:
        float(cell or "nan")
    except ValueError:
        return True
    return False


def _with_one_line_of_names(rows: list[list[str]]) -> list[list[str]]:
    """A table's rows, with a single line of names where several stand above the numbers, as DeepLabCut and
    pandas write them: of the last, and of the first that tells columns apart."""
    count = next((i for i, row in enumerate(rows[:6]) if not all(map(_is_name, row[1:]))), 0)
    if count < 2 or any(len(row) != len(rows[count]) for row in rows[:count]):
        return rows
    told = next((row for row in rows[: count - 1] if len(set(row[1:])) > 1), rows[count - 1])
    names = ["_".join(pair) for pair in zip(told, rows[count - 1], strict=True)]
    return [["frame" if rows[count - 1][0] == "coords" else names[0], *names[1:]], *rows[count:]]


def _rows_of_trc(rows: list[list[str]]) -> list[list[str]]:
    """Return a .trc's rows as those of a table with a line of names: frame, time, and MARKER_x, _y, _z of
    each marker."""
    if len(rows) < 5:
        return []
    markers = [name.strip() for name in rows[3][2:] if name.strip()]
    columns = ["frame", "time", *(f"{name}_{axis}" for name in markers for axis in "xyz")]
    told = [row for row in rows[4:] if row[0].strip().isdigit()]
    return [columns, *((row + [""] * len(columns))[: len(columns)] for row in told)]


def _memory_of_json(data: bytes) -> int:
    """Return how many bytes what is in a JSON text takes in memory at most, roughly, by signs that may also
    stand in quotes."""
    lists, objects, items, quotes, names = (data.count(sign) for sign in (b"[", b"{", b",", b'"', b":"))
    # Objects that are many have the same names, which are kept once; those of very many names have their own.
    own = max(0, names - 32 * objects)
    return 56 * lists + 180 * objects + 32 * items + 10 * quotes + 20 * names + 200 * own


def _inflated(data: bytes) -> bytes:
    """Return the pickle that zlib or gzip has compressed, as joblib does; empty for all other data. Raises
    Refused."""
    wrapped = zlib.MAX_WBITS | 32
    try:
        if zlib.decompressobj(wrapped).decompress(data[:4096], 1) != b"\x80":
            return b""
    except zlib.error:
        return b""
    stream = zlib.decompressobj(wrapped)
    try:
        found = stream.decompress(data, LIMITS.text_bytes)
    except zlib.error as error:
        raise safe_pickle.Refused("is damaged") from error
    if not stream.eof:
        raise safe_pickle.Refused("breaks off, or would take more memory than such a file ever needs")
    return found


def _plain_of(data: bytes, contents: Callable[[str], bytes] | None = None) -> Any:
    """Return what a pickle holds; `contents` as in `safe_pickle.load`. Raises Refused, also if it is
    damaged."""
    if len(data) > LIMITS.array_bytes:
        raise safe_pickle.Refused("is larger than such files are")
    try:
        held = safe_pickle.load(data, most_steps=LIMITS.pickle_steps, contents=contents)
        return safe_pickle.plain(held)
    except (safe_pickle.Refused, NotNpz, MemoryError):
        raise
    except Exception as error:  # a damaged pickle can fail in any way
        raise safe_pickle.Refused("is damaged") from error


def _held(value: Any) -> str:
    """Return a phrase about what an object of JSON or Python has in it."""
    if isinstance(value, dict):
        return _some(value)
    return f"a list of {len(value)}" if isinstance(value, list) else "a single value"


def _some(names: Iterable[Any]) -> str:
    """Return a phrase with the first of the names, and how many more there are."""
    names = [shown(str(name)[:40]) for name in names]
    listed = ", ".join(names[:8]) or "nothing"
    return listed + (f" and {len(names) - 8} more" if len(names) > 8 else "")
