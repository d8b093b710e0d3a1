"""The one reader of MANO's parameters: a `ManoLayout` is an entry of the table in formats/mano.py."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from handfit_core.common.files import shown
from handfit_core.common.skeleton import NUM_BETAS, SIDES, Side
from handfit_core.common.values import Unfit
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.motion import POSE_ARRAYS
from handfit_core.interchange import mano
from handfit_core.interchange.document import Document
from handfit_core.interchange.mano import POSE, FoundHands, tell
from handfit_core.interchange.readers import Reader
from handfit_core.interchange.recording import ReadOptions, Recording
from handfit_core.interchange.settings import LIMITS
from handfit_core.interchange.skeletons import UP_AXES

_SUFFIXES: Final = (".npz", ".json", ".npy", ".pkl", ".pt", ".pth")
_NUMBERS: Final = re.compile(r"(?<!\d)\d{1,18}(?!\d)")
_MOST_DIGITS: Final = 2
"""The most digits of a hand's number in a file's name; longer numbers are frames'"""
_LOOKED_AT: Final = 20_000
"""How many values of a file are looked through for a hand before it is said that the file has none"""
_WORLDS: Final = {**UP_AXES, "OpenGL": np.diag([1.0, -1.0, -1.0])}


@dataclass(frozen=True)
class ManoLayout:
    """How a program keeps MANO's parameters in a file, or in the files of a folder."""

    name: str = ""
    title: str = ""
    phrase: str = ""
    """A phrase for such a file, for messages and lists"""
    source: str = ""
    """The address of the page on which the layout is described"""
    keys: str = ""
    """The names of values in a file, as in "betas right=right|is_right": of `global_orient`, `hand_pose`,
    `transl`, `betas`, `right` (1 and 0), `frame`, `time` (nanoseconds), `present`, `fps`, `focal`, `size`,
    `intrinsics` (fx, fy, cx, cy, or a matrix), `cam_R`, `cam_t`, `model`; with `body_pose`, `global_orient`
    is a body's. `SIDE` stands for left and right"""
    needs: str = "global_orient hand_pose transl"
    """The values that a file of this layout must have, by their names in `keys`; `a|b`: one of the two"""
    met: str = ""
    """The real file that it was tried with, and when; empty: it is read by its description"""
    rows: Literal["hands", "sides", "tracks"] = "hands"
    """The kind of rows: hands; the frames of each side; or tracks with frames, whose sides are `right`, else
    a left and a right hand"""
    side: Literal["", "right", "asked"] = ""
    """The side of all hands, where a file has one: right, or the one that --hands names"""
    sides: Mapping[str, Side] = field(default_factory=lambda: {side: side for side in SIDES})
    """The side of the hands that each of these keys and folders has"""
    nested: str = ""
    """Dictionaries within the file that have some of the keys, or whose names begin some of the keys"""
    listed: str = ""
    """The names of the values that stand in a list without names"""
    columns: Mapping[str, Mapping[int, Mapping[str, slice]]] = field(default_factory=dict)
    """The columns of each value in an array that holds several: by the array's name ("" for a .npy), then by
    its number of columns, then by the value's name"""
    folder: str = ""
    """The folder within the given one in which the files lie, if it is there"""
    files: str = ""
    """A regular expression that the names of a folder's files match. With its groups, the number of the
    (first) `frame` and of the `person`, each of these files must have hands"""
    matrices: bool = False
    """True if a file is only recognised where its poses are matrices"""
    directions: bool = False
    """True if poses are coefficients of MANO's principal directions, even if there are 45"""
    counted: mano.Counted = "flat"
    mean_model: str = ""
    """The `model` with which poses count from the mean"""
    mirrored: Literal["no", "hands", "world"] = "no"
    """How left hands are stored: as they are (no), or as right ones in a mirror, with their places (world) or
    without (hands)"""
    world: str = ""
    """The frame that hands are in, one of _WORLDS; empty for the camera's"""
    first_frame: int = 0
    """The number to add to the file's frame numbers"""
    assumed: tuple[str, ...] = ()
    assumes: str = ""
    """Assumptions about every file, for the table of docs/interchange.md"""
    also: tuple[ManoLayout, ...] = ()
    """Other, less particular layouts that the program has"""
    mirrored_by: str = ""
    """Advice for the user where left hands bend as if mirrored"""

    @cached_property
    def names(self) -> dict[str, list[str]]:
        """For each of the values, the names that it may have in a file, the one that counts first in
        front."""
        told = (each.replace("SIDE", side) for side in SIDES for each in self.keys.split())
        return {each.split("=")[0]: each.split("=")[-1].split("|") for each in told}

    @cached_property
    def wanted(self) -> dict[str, str]:
        """For each name in a file, the value that it has; of several names of a value, the one that counts
        comes last. An array with columns of several values has its own name here."""
        told = {name: what for what, names in self.names.items() for name in reversed(names)}
        return told | {key: key for key in self.columns}

    @property
    def reader(self) -> Reader:
        """The reader of files in this layout or in one of its alternatives, `also`."""
        layouts = (self, *self.also)

        def read(document: Document, asked: ReadOptions) -> Recording:
            fits = (each for each in layouts if _recognises(each, document))
            return _read(self.name, next(fits, self), document, asked)

        return Reader(
            self.title,
            self.phrase,
            lambda document: any(_recognises(each, document) for each in layouts),
            read,
            "; ".join(each.met for each in layouts if each.met),
            self.assumes,
        )

    def plain(self, name: str) -> str:
        """Return a name without that of the dictionary that it stands in, such as `betas` for
        `mano.betas`."""
        return re.sub(rf"^({'|'.join(self.nested.split()) or '(?!)'})[._/](?=\w+$)", "", name)


@dataclass(frozen=True, eq=False)
class _Part:
    """One dictionary of a file: for each key of `ManoLayout.keys`, the name that it has in the file and its
    value."""

    layout: ManoLayout
    values: Mapping[str, tuple[str, Any]] = field(default_factory=dict)
    row: int | None = None
    """The dictionary's place, counted from 1, in a list of frames; None where it stands in none"""
    name: str = ""
    """The names of the file and of the keys that the dictionary stands under, as far as they have numbers"""
    fixed: Mapping[str, int] = field(default_factory=dict)
    """Numbers from the names of files, folders and keys: `frame`, `person`, `side`"""

    def __contains__(self, what: str) -> bool:
        return what in self.values

    def numbers(self, what: str, *shape: int) -> np.ndarray | None:
        return mano.numbers(*self.values[what], *shape) if what in self else None

    def rows(self, what: str, count: int, *shape: int) -> np.ndarray | None:
        """Return a value as (count, *shape) numbers; None where there is none. Raises Unfit for another
        number of rows."""
        found = self.numbers(what, *shape)
        if found is not None and len(found) != count:
            raise Unfit(f"{self.values[what][0]} has {len(found)} rows where {count} are expected")
        return found

    def rotations(self, what: str, joints: int, count: int | None = None) -> np.ndarray:
        return mano.rotations(*self.values[what], joints, count)

    @property
    def is_hands(self) -> bool:
        """True if everything that the layout needs is there, for one side at least."""
        columns = [widths for key, widths in self.layout.columns.items() if key in self]
        told = {*self.values, *(what for each in columns for parts in each.values() for what in parts)}
        needs = [self.layout.needs.replace("SIDE", side).split() for side in SIDES if self.values]
        return any(all(told & {*what.split("|")} for what in of) for of in needs)

    def within(self, steps: Sequence[str | int], held: Mapping[str, Any]) -> _Part:
        """Return the part that these keys, names and places in lists lead to, with the values of `held` that
        are wanted."""
        layout, values = self.layout, dict(self.values)
        for name, what in layout.wanted.items():
            if name in held and (name or _width(held[name]) in layout.columns.get(name, ())):
                values[what] = name, held[name]
        rows = [step for step in (steps if layout.rows == "sides" else steps[:-1]) if isinstance(step, int)]
        keys = [step for step in steps if isinstance(step, str)]
        sides = [SIDES.index(layout.sides[key]) for key in keys if key in layout.sides]
        names = [key for key in (self.name, *keys) if _NUMBERS.search(key) and key not in layout.sides]
        return replace(
            self,
            values=values,
            row=rows[-1] if rows else None,
            name="/".join(names),
            fixed={**self.fixed, "side": sides[-1]} if sides else self.fixed,
        )

    def unpacked(self) -> _Part:
        """Return the part with lists made arrays, and arrays of several values taken apart by their columns.
        Raises Unfit."""
        values = dict(self.values)
        for what, (name, value) in self.values.items():
            with suppress(TypeError, ValueError), np.errstate(invalid="ignore"):
                values[what] = name, np.asarray(value, dtype=np.float64)
        for key, widths in self.layout.columns.items():
            if key in self:
                array = np.asarray(values[key][1], dtype=np.float64)
                array = array.reshape(len(array), -1) if array.ndim > 2 else np.atleast_2d(array)
                if array.shape[-1] not in widths or not array.size:
                    found, known = "x".join(map(str, array.shape)), " or ".join(map(str, widths))
                    raise Unfit(
                        f"{key} must have {known} numbers a frame, and is {found}; without hands it has fewer"
                    )
                values |= {w: (key, array[:, part]) for w, part in widths[array.shape[-1]].items()}
        return replace(self, values=values)


def _width(value: Any) -> int:
    """Return how many numbers the innermost lists of a value, or an array's rows, have; 0 for a single
    number."""
    if isinstance(value, np.ndarray):
        return value.shape[-1] if value.ndim else 0
    while isinstance(value, list) and value and isinstance(value[0], list):
        value = value[0]
    return len(value) if isinstance(value, list) else 0


def _values(held: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    """Yield the values in dictionaries and lists, with the keys and the places, from 1, that lead to each; a
    list of numbers is one value."""
    first = held
    while isinstance(first, list) and first:
        first = first[0]
    if isinstance(held, dict):
        for key, value in held.items():
            yield from _values(value, (*path, str(key)))
    elif isinstance(first, dict | list) or (first is None and held is not None):
        for place, value in enumerate(held, 1):
            yield from _values(value, (*path, place))
    elif held is not None:
        yield path, held


def _in_file(document: Document, part: _Part, most: int | None) -> Iterator[_Part]:
    """Yield the hands among the first `most` values of a file, each with the values that stand around it."""
    layout, nested = part.layout, part.layout.nested.split()
    held = document.npy if document.held is None else document.held
    if document.npz is not None:
        known = {*layout.wanted, *layout.sides, *nested}
        held = {name: document.value(name) for name in document.names if layout.plain(name) in known}
    if isinstance(held, list) and len(held) == len(layout.listed.split()):
        held = dict(zip(layout.listed.split(), held, strict=True))
    found: dict[tuple[str | int, ...], dict[str, Any]] = {}
    for path, value in islice(_values(held), most):
        *where, key = [step for step in path if step not in nested] or [""]
        found.setdefault(tuple(where), {})[layout.plain(str(key))] = value
    poses = {name for name, what in layout.wanted.items() if what.endswith("hand_pose")} | {*layout.columns}
    for where in [where for where, values in found.items() if poses & values.keys()]:
        around = {}
        for depth in range(len(where) + 1):
            around |= found.get(where[:depth], {})
        if (hands := part.within(where, around)).is_hands:
            yield hands


def _parts(layout: ManoLayout, document: Document, most: int | None = None) -> Iterator[_Part]:
    """Yield the hands among the first `most` values of a file, or of each file of a folder. Raises Unfit."""
    if not document.is_folder:
        yield from _in_file(document, _Part(layout), most)
        return
    folder = document.path / layout.folder
    folder = folder if layout.folder and folder.is_dir() else document.path
    for side in [side for side in layout.sides if layout.files and (folder / side).is_dir()] or [""]:
        for path in Document(folder / side).files(*_SUFFIXES) if layout.files else ():
            if (match := re.fullmatch(layout.files, path.stem)) is None:
                continue
            fixed = {key: int(text) for key, text in match.groupdict().items()}
            part, file = _Part(layout, fixed=fixed), Document(path)
            part = part.within([side] if fixed else [side, path.stem], {})
            found = [*_in_file(file, part, most)]
            if fixed and not found:
                raise Unfit(f"{path.name} must hold hands, or a body with hands, and is {file.found}")
            yield from found


def _recognises(layout: ManoLayout, document: Document) -> bool:
    try:
        first = next(_parts(layout, document, _LOOKED_AT), None)
        shape = np.shape(first.values["hand_pose"][1]) if first and layout.matrices else (15, 3, 3)
    except (Unfit, ValueError, TypeError):
        return False
    return first is not None and shape[-2:] == (3, 3) and np.prod(shape) % (9 * 15) == 0


def _sided(part: _Part, path: Path, assumed: list[str]) -> Iterator[tuple[_Part, np.ndarray | None]]:
    """Yield a part for each side where a part has both apart, with the rotation (3, 3) from a body's world to
    the camera's axes, None where there is none. Raises Unfit."""
    if part.layout.rows != "sides":
        yield part, None
        return
    body, turn, wrists = "body_pose" in part, None, dict[Side, np.ndarray]()
    if body:
        LIMITS.check(path, np.size(part.values["body_pose"][1]) // (3 * mano.BODY_JOINTS), 2)
        joints = part.rotations("body_pose", mano.BODY_JOINTS)
        pelvis = part.rotations("global_orient", 1, len(joints))
        wrists = {side: mano.wrist_of_body(pelvis, joints, side) for side in SIDES}
        said = "where the wrists are is not known without the body's model: each hand stays in its place"
        tell(assumed, f"{said}, and only turns")
        turn = mano.standing(pelvis, assumed) if "person" not in part.fixed else None
    for index, side in enumerate(SIDES):
        if f"{side}_hand_pose" in part:
            values = {what.removeprefix(f"{side}_"): of for what, of in part.values.items()}
            if body:
                values["global_orient"] = "body_pose", wrists[side]
                values = {what: of for what, of in values.items() if what not in ("transl", "betas")}
            yield replace(part, values=values, fixed={"person": 0, **part.fixed, "side": index}), turn


def _hands(part: _Part, asked: ReadOptions, path: Path, assumed: list[str]) -> FoundHands:
    """Return the hands of a part, in the frame in which the file has them. Raises Unfit, InputError and
    OptionError."""
    layout, (name, value) = part.layout, part.values["hand_pose"]
    shape = np.shape(value)[-2:]
    LIMITS.check(path, np.size(value) // (9 * 15 if shape == (3, 3) else POSE), 2)
    side, person = _whose(part, asked, path, assumed)
    count = side.size if side.ndim else None
    directions = layout.directions or (np.size(value) and shape[-1:] and shape[-1] < POSE and shape[-1] != 3)
    pose = mano.numbers(name, value, shape[-1]) if directions else mano.rotations(name, value, 15, count)
    count = len(pose)
    orient, side = part.rotations("global_orient", 1, count), np.broadcast_to(side, count)
    if directions:
        pose = mano.from_directions(pose, side, asked)
    frames, place = _frames(part, side, assumed), part.rows("transl", count, 3)
    place = np.full((count, 3), np.inf) if place is None else place
    person = np.broadcast_to(person, count)
    found = FoundHands(frames, side, person, _shapes(part, count), orient, pose, place)
    there = np.any(np.concatenate([orient, pose, place], axis=1) != 0.0, axis=1)
    if "present" in part:
        both = np.size(part.values["present"][1]) == 2 * count
        rows = part.rows("present", count, 1 + both)
        there &= rows is not None and rows[:, int(side[0]) if both else 0] > 0.0
    if not there.all():  # Nothing but zeros is the place of a hand that was not there.
        gone = {n: np.where(there[:, None], getattr(found, n), np.nan) for n in ("betas", *POSE_ARRAYS)}
        found = replace(found, **gone)
    return found if layout.mirrored == "no" else found.mirrored(places=layout.mirrored == "world")


def _whose(
    part: _Part, asked: ReadOptions, path: Path, assumed: list[str]
) -> tuple[np.ndarray, np.ndarray | int]:
    """Return the index in SIDES of each row's hand, (N,), or of all rows, (), and the number of the person.
    Raises Unfit."""
    which = part.layout.side
    if part.layout.rows == "tracks":
        of = "right" if "right" in part else "present"
        name, flags = part.values[of][0], np.asarray(part.values[of][1], dtype=np.float64)
        if flags.ndim != 2 or not flags.size or (of == "present" and len(flags) != len(SIDES)):
            raise Unfit(f"{name} must have the shape {'BxT: tracks and frames' if of == 'right' else '2xT'}")
        LIMITS.check(path, count := flags.shape[1], len(flags))
        is_right = np.mean(flags > 0.5, axis=1) >= 0.5 if of == "right" else np.arange(2) > 0
        person = [int(np.sum(is_right[:track] == each)) for track, each in enumerate(is_right)]
        sides = np.where(is_right, SIDES.index("right"), SIDES.index("left"))
        return np.repeat(sides, count), np.repeat(person, count)
    if "side" in part.fixed:
        return np.array(part.fixed["side"]), part.fixed.get("person", -1)
    if which == "asked":
        which = "left" if asked.hands == "left" else "right"
        tell(assumed, f"it was taken for a {which} hand, as the file does not say (--hands)")
    if which:
        return np.array(SIDES.index(which)), -1
    right = part.numbers("right", 1)
    if right is None or not np.isin(right, (0.0, 1.0)).all():
        raise Unfit("right must be 1 for right hands and 0 for left ones")
    return np.where(right[:, 0] > 0.0, SIDES.index("right"), SIDES.index("left")), -1


def _shapes(part: _Part, count: int) -> np.ndarray:
    """Return (N, 10) betas: one shape for each row, each track or all; NaN where it is not known whose they
    are."""
    shapes = np.full((count, NUM_BETAS), np.nan)
    if "betas" not in part or not np.size(part.values["betas"][1]):
        return shapes
    name, value = part.values["betas"]
    rows = mano.numbers(name, np.asarray(value, dtype=np.float64)[..., :NUM_BETAS], NUM_BETAS)
    return np.repeat(rows, count // len(rows), axis=0) if count % len(rows) == 0 else shapes


def _frames(part: _Part, side: np.ndarray, assumed: list[str]) -> np.ndarray:
    """Return the frame number of each hand; any number where the part's name has it. Raises Unfit."""
    count, sides = len(side), part.layout.rows == "sides"
    if part.layout.rows == "tracks":
        frames = np.shape(part.values["right" if "right" in part else "present"][1])[1]
        return np.tile(np.arange(1, frames + 1), count // frames)
    if "frame" in part.fixed:
        return part.fixed["frame"] + np.arange(count)
    if "frame" in part:
        rows = mano.numbers(*part.values["frame"], 1)[:, 0]
        rows = np.repeat(rows, count) if len(rows) == 1 else rows
        if len(rows) != count or not np.all(rows == np.round(rows)):
            raise Unfit(f"frame must be {count} whole numbers, one for each hand")
        return rows.astype(np.int64)
    counted = count > 1 and (sides or len(set(side.tolist())) == 1)
    if (part.row is not None or part.name) and not (sides and counted):
        return np.full(count, part.row or 0)
    if counted and not sides:
        tell(assumed, "its rows were taken as one hand's frames, as it does not tell whose they are")
    return np.arange(1, count + 1) if counted else np.ones(count, dtype=int)


def _before_camera(part: _Part, hands: FoundHands, asked: ReadOptions, assumed: list[str]) -> FoundHands:
    """Return hands in the camera's frame, of hands in a world whose camera the file tells. Raises Unfit."""
    if "cam_R" not in part or "cam_t" not in part:
        if "cam_R" in part.layout.names:
            tell(assumed, "the camera is not told (cam_R, cam_t): the world was taken to have its axes")
        return hands
    rotation, shift = mano.numbers(*part.values["cam_R"], 3, 3), mano.numbers(*part.values["cam_t"], 3)
    frames = len(set(hands.frame.tolist()))
    if len(rotation) != len(shift) or len(rotation) not in (frames, len(hands)):
        raise Unfit(f"cam_R and cam_t must have {frames} frames, and have {len(rotation)}, {len(shift)}")
    times, rotation = len(hands) // len(rotation), mano.checked_matrices("cam_R", rotation)
    return hands.seen_from(np.tile(rotation, (times, 1, 1)), np.tile(shift, (times, 1)), asked)


def _by_names(names: Collection[str], assumed: list[str]) -> dict[str, int]:
    """Return the frame number of each file or key by the last number in its name, or by the one before where
    the last ones count the hands of a picture. Raises Unfit for names of several clips."""
    if not names:
        return {}
    found = {name: [*_NUMBERS.finditer(name)] for name in names}
    counting = [len(each) > 1 and len(each[-1][0]) <= _MOST_DIGITS for each in found.values()]
    around = {(name[: each[-1].start()], name[each[-1].end() :]) for name, each in found.items()}
    for last, what in ((-1, "frames"), (-2, "hands")):
        if last == -2 and not all(counting):
            break
        parts = {
            (name[: each[last].start()], name[each[last].end() : each[-1].start()], name[each[-1].end() :])
            for name, each in found.items()
        }
        if len(parts) == 1:
            if any(counting):
                tell(assumed, f"the last numbers in the names are the {what}', as in {shown(min(names))}")
            return {name: int(each[last][0]) for name, each in found.items()}
    first, second = ("..".join(each) for each in sorted(around)[:2])
    raise Unfit(
        f"its frames belong to several clips ({first} and {second}, for example); give each its own folder, "
        "with names as frame_0001, or frame_0001_0 with a hand's number"
    )


def _by_time(parts: Sequence[_Part]) -> tuple[float, list[_Part]]:
    """Return frames per second, and the parts with their frames, counted from 1, by their times; of each side
    only the first one where several cameras saw a hand at almost the same time."""
    times = np.array([part.values["time"][1] for part in parts], dtype=np.float64) / 1e9
    steps = np.diff(np.unique(times))
    step = float(np.median(steps[steps > 0.5 * np.quantile(steps, 0.75)])) if len(steps) else 1.0
    numbers = 1.0 + np.round((times - times.min()) / step)
    if times.ndim != 1 or not np.all(numbers < 1 << 31):
        raise Unfit(f"{parts[0].values['time'][0]} must be nanoseconds of one recording")
    first: dict[tuple[int, int], _Part] = {}
    for number, part in zip(numbers.astype(np.int64).tolist(), parts, strict=True):
        timed = replace(part, fixed={**part.fixed, "frame": number})
        first.setdefault((number, part.fixed.get("side", -1)), timed)
    return (1.0 / step if len(steps) else 0.0), [*first.values()]


def _read(name: str, layout: ManoLayout, document: Document, asked: ReadOptions) -> Recording:
    assumed = list(layout.assumed)
    found: list[tuple[str, FoundHands]] = []
    parts = [part.unpacked() for part in _parts(layout, document)]
    if not parts:
        raise Unfit(f"there is no hand in {document.found}")
    rate, parts = _by_time(parts) if "time" in parts[0] else (0.0, parts)
    for part in parts:
        for one, turn in _sided(part, document.path, assumed):
            hands = _hands(one, asked, document.path, assumed)
            hands = _before_camera(one, hands, asked, assumed) if turn is None else hands.turned(turn)
            counted = "frame" in part or "frame" in part.fixed or (layout.rows != "hands" and len(hands) > 1)
            found.append(("" if counted else part.name, hands))
        LIMITS.check(document.path, 1, sum(len(hands) for _, hands in found))
    numbers = _by_names({name for name, _ in found if name}, assumed)
    hands = FoundHands.concatenate(
        [replace(h, frame=np.full(len(h), numbers[name])) if name else h for name, h in found]
    )
    body = "body_pose" in parts[0]
    if body and layout.columns and not np.any(np.nan_to_num(hands.hand_pose)):
        raise Unfit("the fingers of this body never move: it has none")
    model = str(parts[0].values.get("model", ("", ""))[1])
    counted = "mean" if model and model == layout.mean_model else layout.counted
    hands = replace(hands.from_flat(asked, counted), frame=hands.frame + layout.first_frame)
    if layout.world:
        if layout.world in UP_AXES:
            tell(assumed, f"its world was taken to be {layout.world}-up, without a camera")
        hands = hands.seen_from(_WORLDS[layout.world], np.zeros(3), asked)
    frames = np.unique(hands.frame)
    posed = mano.followed(hands, frames, asked, assumed)
    posed = tuple(hand for hand in posed if hand.present.any())
    if not posed:
        raise Unfit("there is no hand in any of its frames")
    still = not any(np.ptp(hand.hand_pose[hand.present], axis=0).any() for hand in posed)
    persons = len(set(hands.person.tolist())) > 1 and "person" in parts[0].fixed
    place = layout.names.get("transl", [""])[0]
    for there, phrase in (
        (
            body and still and len(frames) > 1,
            "the fingers never move: this body was captured without its hands",
        ),
        (place and hands.nowhere, f"where the hands are is not told ({place}): each stays in its place"),
        (persons, "persons are told apart by the number in the files' names, which may change places"),
    ):
        if there:
            tell(assumed, phrase)
    size, camera = _camera(layout, parts, asked, assumed, nowhere=hands.nowhere)
    told = parts[0].numbers("fps", 1)
    return Recording(
        name,
        (str(document.path.absolute()),),
        rate or asked.rate if told is None else float(told[0, 0]),
        frames,
        posed=posed,
        size=size,
        intrinsics=camera,
        assumed=(*assumed, *mano.doubts(posed, asked, layout.mirrored_by)),
    )


def _camera(
    layout: ManoLayout, parts: Sequence[_Part], asked: ReadOptions, assumed: list[str], *, nowhere: bool
) -> tuple[tuple[int, int] | None, Intrinsics | None]:
    """Return the pictures' (width, height) in pixels and the camera, as the parts tell them; None where they
    do not."""

    def told(what: str, *shape: int) -> np.ndarray:
        rows = [rows for part in parts if (rows := part.numbers(what, *shape)) is not None]
        return np.concatenate(rows or [np.empty((0, *shape))])

    sizes = [(int(width), int(height)) for width, height in told("size", 2)[:1]]
    if "intrinsics" in parts[0]:
        matrix = np.shape(parts[0].values["intrinsics"][1])[-2:] == (3, 3)
        rows = told("intrinsics", 3, 3)[:, [0, 1, 0, 1], [0, 1, 2, 2]] if matrix else told("intrinsics", 4)
        fx, fy, cx, cy = rows[0].tolist()
        size = sizes[0] if sizes else (round(2.0 * cx), round(2.0 * cy))
        if not 0 < min(size) <= max(size) < 1 << 24:
            raise Unfit(f"intrins must be fx, fy, cx, cy in pixels, and has cx {cx:g}, cy {cy:g}")
        if not sizes:
            tell(assumed, f"pictures of {size[0]}x{size[1]} pixels, twice the principal point")
        return size, Intrinsics(fx, fy, cx, cy)
    if "focal" not in layout.names or nowhere:
        return None, None
    size = asked.picture_size or (sizes[0] if sizes else None)
    if size is None:
        tell(
            assumed,
            "the pictures' size is not told: hands lie as far away as the network's camera has them, but are "
            "not laid over pictures (--picture-size, or the pictures as the input and this as --keypoints)",
        )
        return None, None
    # HaMeR's and WiLoR's focal length, in longer sides of the picture
    focals = told("focal", 1)
    focal = float(np.median(focals)) if len(focals) else (5000.0 / 256.0) * max(size)
    if not len(focals):
        tell(assumed, f"a focal length of {focal:.0f} pixels, the networks' own for this size")
    return size, Intrinsics(focal, focal, size[0] / 2.0, size[1] / 2.0)
