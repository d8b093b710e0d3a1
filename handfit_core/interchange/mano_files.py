"""The one reader of MANO's parameters: a `ManoLayout` is an entry of the table in formats/mano.py."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
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
"""of a hand's number in a file's name; longer ones are frames'"""
_LOOKED_AT: Final = 2000
"""Dictionaries of a file in which a hand is looked for before it is said that it has none"""
_WORLDS: Final = {**UP_AXES, "OpenGL": np.diag([1.0, -1.0, -1.0])}


@dataclass(frozen=True)
class ManoLayout:
    """How a program keeps MANO's parameters in a file, or in the files of a folder."""

    source: str
    """The address where this is written down"""
    keys: str
    """What has which name in a file, as in "betas right=right|is_right": of `global_orient`, `hand_pose`,
    `transl`, `betas`, `right` (1 and 0), `frame`, `time` (nanoseconds), `present`, `fps`, `focal`, `size`,
    `intrinsics` (fx, fy, cx, cy, or a matrix), `cam_R`, `cam_t`; with `body_pose`, `global_orient` is a
    body's. `SIDE` stands for left and right"""
    needs: str = "global_orient hand_pose transl"
    """Which of them a file of this layout must have; `a|b`: one of the two"""
    met: str = ""
    """The real file that it was tried with, and when; empty: it is read by its description"""
    rows: Literal["hands", "sides", "tracks"] = "hands"
    """What rows are: hands; the frames of each side; or tracks with frames, whose sides are `right`, else a
    left and a right hand"""
    side: Literal["", "right", "asked"] = ""
    """Whose all hands are, where a file has one side: right, or what --hands says"""
    sides: Mapping[str, Side] = field(default_factory=lambda: {side: side for side in SIDES})
    """Keys and folders that have the hands of one side"""
    nested: str = ""
    """Dictionaries within that have some of the keys, or begin their names"""
    listed: str = ""
    """The names of what stands in a list without any"""
    columns: Mapping[str, Mapping[int, Mapping[str, slice]]] = field(default_factory=dict)
    """Which columns of an array of so many have which of the values; by the array's name, "" for a .npy"""
    folder: str = ""
    """The folder within the one that is given in which the files lie, if it is there"""
    files: str = ""
    """An expression that names of a folder's files match; with groups, the number of the (first) `frame` and
    of the `person`, each of these files must have hands"""
    matrices: bool = False
    """Whether poses are only recognised by being matrices"""
    directions: bool = False
    """Whether poses are coefficients of MANO's principal directions, even if there are 45"""
    counted: mano.Counted = "flat"
    mean_where: tuple[str, str] = ("", "")
    """A name and what stands under it where poses count from the mean"""
    mirrored: Literal["no", "hands", "world"] = "no"
    """Whether left hands are right ones in a mirror, which takes their places along or not"""
    world: str = ""
    """The frame that hands are in, one of _WORLDS; empty: the camera's"""
    camera: Literal["", "intrinsics", "focal"] = ""
    first_frame: int = 0
    """What is added to the frames' numbers"""
    assumed: tuple[str, ...] = ()
    left_assumed: str = ""
    """What is assumed where there is a left hand"""
    mirrored_by: str = ""
    """What to do, or to think, where left hands bend as if mirrored"""

    @cached_property
    def names(self) -> dict[str, list[str]]:
        """The names in a file of each of the values, the one that counts first."""
        told = (each.replace("SIDE", side) for side in SIDES for each in self.keys.split())
        return {each.split("=")[0]: each.split("=")[-1].split("|") for each in told}

    @cached_property
    def wanted(self) -> dict[str, str]:
        """Which value a name in a file has, the ones that count after the others."""
        return {name: what for what, names in self.names.items() for name in reversed(names)}


@dataclass(frozen=True, eq=False)
class _Part:
    """The values of one dictionary: name in the file and value, by the names of `ManoLayout.keys`."""

    layout: ManoLayout
    values: Mapping[str, tuple[str, Any]] = field(default_factory=dict)
    row: int | None = None
    """The place, from 1, in a list of frames"""
    name: str = ""
    """The names of the file and of the keys that it stands under, as far as they have numbers"""
    fixed: Mapping[str, int] = field(default_factory=dict)
    """What names of files, folders and keys say: `frame`, `person`, `side`"""

    def __contains__(self, what: str) -> bool:
        return what in self.values

    def numbers(self, what: str, *shape: int) -> np.ndarray | None:
        return mano.numbers(*self.values[what], *shape) if what in self else None

    def rotations(self, what: str, joints: int, count: int | None = None) -> np.ndarray:
        if what not in self:
            raise Unfit(f"{self.layout.names[what][0]} is missing")
        return mano.rotations(*self.values[what], joints, count)

    @property
    def is_hands(self) -> bool:
        """Whether all is there that the layout needs, for one side at least."""
        needs = [self.layout.needs.replace("SIDE", side).split() for side in SIDES if self.values]
        return any(all(any(each in self for each in what.split("|")) for what in of) for of in needs)

    def under(self, key: str) -> _Part:
        """What stands under a key, or in a file or folder of that name."""
        if key in self.layout.sides:
            return replace(self, fixed={**self.fixed, "side": SIDES.index(self.layout.sides[key])})
        return replace(self, name=f"{self.name}/{key}".strip("/")) if _NUMBERS.search(key) else self

    def having(self, names: Iterable[Any], value: Callable[[Any], Any]) -> _Part:
        """With those values of a dictionary that are wanted."""
        layout, flat = self.layout, dict[str, Any]()
        nested = layout.nested.split()
        begins = tuple(each + sign for each in nested for sign in "._/")
        for name in names:
            key = str(name)
            if key.startswith(begins) and key not in nested:
                key = key[len(next(each for each in begins if key.startswith(each))) :]
            if key in layout.wanted or key in layout.columns:
                flat[key] = value(name)
            elif key in nested and isinstance(inside := value(name), dict):
                flat |= {str(k): v for k, v in inside.items() if str(k) in layout.wanted}
        values = {w: (k, flat[k]) for k, w in layout.wanted.items() if k in flat and not _holds(flat[k])}
        for key, widths in layout.columns.items():
            columns = flat.get(key)
            if columns is not None and (key or np.shape(columns)[-1:] in [(width,) for width in widths]):
                values |= {what: (key, columns) for parts in widths.values() for what in parts}
        return replace(self, values={**self.values, **values}) if values else self

    def unpacked(self) -> _Part:
        """With lists as arrays, and the columns of arrays apart. Raises Unfit."""
        values = dict(self.values)
        for what, (name, value) in self.values.items():
            with suppress(TypeError, ValueError), np.errstate(invalid="ignore"):
                values[what] = name, np.asarray(value, dtype=np.float64)
        for name, what in [(of[0], what) for what, of in values.items() if of[0] in self.layout.columns]:
            widths, array = self.layout.columns[name], np.asarray(values[what][1], dtype=np.float64)
            array = array.reshape(len(array), -1) if array.ndim > 2 else np.atleast_2d(array)
            if array.shape[-1] not in widths or not array.size:
                found, known = "x".join(map(str, array.shape)), " or ".join(map(str, widths))
                raise Unfit(
                    f"{name} must have {known} numbers a frame, and is {found}; without hands it has fewer"
                )
            values[what] = name, array[:, widths[array.shape[-1]][what]]
        return replace(self, values=values)


def _holds(value: Any) -> bool:
    """Whether a value is nothing, or a dictionary or a list that may have some, rather than of numbers."""
    while isinstance(value, list) and value:
        value = value[0]
    return value is None or isinstance(value, dict | list)


def _walk(held: Any, part: _Part, row: int | None = None) -> Iterator[_Part]:
    """The dictionaries in what a file holds, each with what stands around it, down to those of hands."""
    layout = part.layout
    if isinstance(held, list) and layout.listed and len(held) == len(layout.listed.split()):
        held = dict(zip(layout.listed.split(), held, strict=True))
    if isinstance(held, np.ndarray) or ("" in layout.columns and isinstance(held, list) and not _holds(held)):
        held = {"": held}
    inner = part if row is None else replace(part, row=row)
    if isinstance(held, dict):
        mine = (inner if layout.rows == "sides" else part).having(held, held.get)
        yield mine
        if not mine.is_hands:
            inner = inner if mine.values is part.values else replace(inner, values=mine.values)
            for key, value in held.items():
                if isinstance(value, dict | list) and _holds(value):
                    yield from _walk(value, inner.under(str(key)))
    elif isinstance(held, list) and _holds(held):
        for number, each in enumerate(held, 1):
            yield from _walk(each, inner, number)


def _in_file(document: Document, part: _Part) -> Iterator[_Part]:
    if document.npz is None:
        held = document.held
        yield from _walk(document.npy if held is None else held, part)
        return
    mine = part.having(document.names, document.value)
    yield mine
    for name in () if mine.is_hands else sorted(set(document.names) & set(part.layout.sides)):
        yield from _walk(document.value(name), mine.under(name))


def _parts(layout: ManoLayout, document: Document) -> Iterator[_Part]:
    """The dictionaries in a file, or in the files of a folder. Raises Unfit."""
    if not document.is_folder:
        yield from _in_file(document, _Part(layout))
        return
    folder = document.path / layout.folder
    folder = folder if layout.folder and folder.is_dir() else document.path
    for within in [side for side in layout.sides if layout.files and (folder / side).is_dir()] or [""]:
        for path in Document(folder / within).files(*_SUFFIXES) if layout.files else ():
            if (match := re.fullmatch(layout.files, path.stem)) is None:
                continue
            fixed = {key: int(text) for key, text in match.groupdict().items()}
            part, file = _Part(layout, fixed=fixed).under(within), Document(path)
            found = [p for p in _in_file(file, part if fixed else part.under(path.stem)) if p.is_hands]
            if fixed and not found:
                raise Unfit(f"{path.name} must hold hands, or a body with hands, and is {file.found}")
            yield from found


def _recognises(layout: ManoLayout, document: Document) -> bool:
    try:
        parts = islice(_parts(layout, document), _LOOKED_AT)
        first = next((part for part in parts if part.is_hands), None)
        shape = np.shape(first.values["hand_pose"][1]) if first and layout.matrices else (15, 3, 3)
    except (Unfit, ValueError, TypeError):
        return False
    return first is not None and shape[-2:] == (3, 3) and np.prod(shape) % (9 * 15) == 0


def _sided(part: _Part, path: Path, assumed: list[str]) -> Iterator[tuple[_Part, np.ndarray | None]]:
    """A part for each of both sides, where they are apart, and how a body's world turns to the camera's axes.
    Raises Unfit."""
    if part.layout.rows != "sides":
        yield part, None
        return
    body, turn, wrists = "body_pose" in part, None, dict[Side, np.ndarray]()
    if body:
        LIMITS.check(path, np.size(part.values["body_pose"][1]) // (3 * mano.BODY_JOINTS), 2)
        joints = part.rotations("body_pose", mano.BODY_JOINTS)
        pelvis = part.rotations("global_orient", 1, len(joints))
        wrists = {side: mano.wrist_of_body(pelvis, joints, side) for side in SIDES}
        tell(assumed, _NO_PLACE)
        turn = mano.standing(pelvis, assumed) if "person" not in part.fixed else None
    for index, side in enumerate(SIDES):
        if f"{side}_hand_pose" in part:
            values = {what.removeprefix(f"{side}_"): of for what, of in part.values.items()}
            if body:
                values["global_orient"] = "body_pose", wrists[side]
                values = {what: of for what, of in values.items() if what not in ("transl", "betas")}
            yield replace(part, values=values, fixed={"person": 0, **part.fixed, "side": index}), turn


_NO_PLACE: Final = (
    "where the wrists are is not known without the body's model: each hand stays in its place, and only turns"
)


def _hands(part: _Part, asked: ReadOptions, path: Path, assumed: list[str]) -> FoundHands:
    """The hands of a part, as its own frame has them. Raises Unfit, InputError and OptionError."""
    layout, (name, value) = part.layout, part.values["hand_pose"]
    shape = np.shape(value)[-2:]
    LIMITS.check(path, np.size(value) // (9 * 15 if shape == (3, 3) else POSE), 2)
    side, person, frames = _whose(part, asked, path, assumed)
    count = side.size if side.ndim else None
    directions = layout.directions or (np.size(value) and shape[-1:] and shape[-1] < POSE and shape[-1] != 3)
    pose = mano.numbers(name, value, shape[-1]) if directions else mano.rotations(name, value, 15, count)
    count = len(pose)
    orient, side, place = part.rotations("global_orient", 1, count), np.broadcast_to(side, count), np.inf
    if directions:
        pose = mano.from_directions(pose, side, asked)
    frames = _frames(part, side, assumed) if frames is None else frames
    if "transl" in part and len(place := mano.numbers(*part.values["transl"], 3)) != count:
        raise Unfit(f"{part.values['transl'][0]} has {len(place)} rows where {count} are expected")
    person, place = np.broadcast_to(person, count), np.broadcast_to(place, (count, 3))
    found = FoundHands(frames, side, person, _shapes(part, count), orient, pose, place)
    there = np.any(np.concatenate([orient, pose, place], axis=1) != 0.0, axis=1)
    if "present" in part:
        name, value = part.values["present"]
        rows = mano.numbers(name, value, 1)[:, 0]
        rows = rows if len(rows) == count else mano.numbers(name, value, 2)[:, int(side[0])]
        if len(rows) != count:
            raise Unfit(f"{name} tells of {len(rows)} frames whether there is a hand, and there are {count}")
        there &= rows > 0.0
    # Nothing but zeros is the place of a hand that was not there.
    found = found if there.all() else found.at(there)
    return found if layout.mirrored == "no" else found.mirrored(places=layout.mirrored == "world")


def _whose(
    part: _Part, asked: ReadOptions, path: Path, assumed: list[str]
) -> tuple[np.ndarray, np.ndarray | int, np.ndarray | None]:
    """Which of SIDES each row is of (N,), or all rows are of (); whose; and tracks' frames. Raises Unfit."""
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
        frames = np.tile(np.arange(1, count + 1), len(flags))
        return np.repeat(sides, count), np.repeat(person, count), frames
    if "side" in part.fixed:
        return np.array(part.fixed["side"]), part.fixed.get("person", -1), None
    if which == "asked":
        which = "left" if asked.hands == "left" else "right"
        tell(assumed, f"it was taken for a {which} hand, as the file does not say (--hands)")
    if which:
        return np.array(SIDES.index(which)), -1, None
    right = part.numbers("right", 1)
    if right is None or not np.isin(right, (0.0, 1.0)).all():
        raise Unfit("right must be 1 for right hands and 0 for left ones")
    return np.where(right[:, 0] > 0.0, SIDES.index("right"), SIDES.index("left")), -1, None


def _shapes(part: _Part, count: int) -> np.ndarray:
    """(N, 10) betas: one shape for each row, each track or all; NaN where nobody knows whose they are."""
    shapes = np.full((count, NUM_BETAS), np.nan)
    if "betas" not in part or not np.size(part.values["betas"][1]):
        return shapes
    name, value = part.values["betas"]
    rows = mano.numbers(name, np.asarray(value, dtype=np.float64)[..., :NUM_BETAS], NUM_BETAS)
    return np.repeat(rows, count // len(rows), axis=0) if count % len(rows) == 0 else shapes


def _frames(part: _Part, side: np.ndarray, assumed: list[str]) -> np.ndarray:
    """Each hand's frame; any where the part's name has it. Raises Unfit."""
    count, sides = len(side), part.layout.rows == "sides"
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
    """The hands of a world whose camera is told in the camera's frame. Raises Unfit."""
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
    """The frames that files or keys are of, by their last numbers, or by those before them where the last
    ones count the hands of a picture. Raises Unfit for names of several clips."""
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
    """Frames per second, and the parts with their frames, from 1, by their times; the first one of each side
    where several cameras saw a hand at almost the same time."""
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
    found: list[FoundHands] = []
    named: dict[str, list[FoundHands]] = {}
    parts = [part.unpacked() for part in _parts(layout, document) if part.is_hands]
    if not parts:
        raise Unfit(f"there is no hand in {document.found}")
    rate, parts = _by_time(parts) if "time" in parts[0] else (0.0, parts)
    for part in parts:
        for one, turn in _sided(part, document.path, assumed):
            hands = _hands(one, asked, document.path, assumed)
            hands = _before_camera(one, hands, asked, assumed) if turn is None else hands.turned(turn)
            counted = "frame" in part or "frame" in part.fixed or (layout.rows != "hands" and len(hands) > 1)
            (found if counted or not part.name else named.setdefault(part.name, [])).append(hands)
        LIMITS.check(document.path, 1, sum(map(len, found)))
    numbers = _by_names(named, assumed) if named else {}
    found += [replace(h, frame=np.full(len(h), numbers[key])) for key, each in named.items() for h in each]
    hands = FoundHands.concatenate(found)
    del found
    body = "body_pose" in parts[0]
    if body and layout.columns and not np.any(np.nan_to_num(hands.hand_pose)):
        raise Unfit("the fingers of this body never move: it has none")
    where, what = layout.mean_where
    counted = "mean" if where and str(document.value(where)) == what else layout.counted
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
        (layout.left_assumed and any(hand.side == "left" for hand in posed), layout.left_assumed),
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
    """The pictures' size and the camera, as the parts tell them."""

    def told(what: str, *shape: int) -> np.ndarray:
        rows = [rows for part in parts if (rows := part.numbers(what, *shape)) is not None]
        return np.concatenate(rows or [np.empty((0, *shape))])

    sizes = [(int(width), int(height)) for width, height in told("size", 2)[:1]]
    if layout.camera == "intrinsics" and "intrinsics" in parts[0]:
        matrix = np.shape(parts[0].values["intrinsics"][1])[-2:] == (3, 3)
        rows = told("intrinsics", 3, 3)[:, [0, 1, 0, 1], [0, 1, 2, 2]] if matrix else told("intrinsics", 4)
        fx, fy, cx, cy = rows[0].tolist()
        size = sizes[0] if sizes else (round(2.0 * cx), round(2.0 * cy))
        if not 0 < min(size) <= max(size) < 1 << 24:
            raise Unfit(f"intrins must be fx, fy, cx, cy in pixels, and has cx {cx:g}, cy {cy:g}")
        if not sizes:
            tell(assumed, f"pictures of {size[0]}x{size[1]} pixels, twice the principal point")
        return size, Intrinsics(fx, fy, cx, cy)
    if layout.camera != "focal" or nowhere:
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


def mano_reader(name: str, title: str, layout: str, assumed: str, *layouts: ManoLayout) -> Reader:
    """A reader of files in one of the layouts, the more particular ones first; `name`: the reader's own,
    `title`, `layout` and `assumed` as `Reader` has them."""

    def read(document: Document, asked: ReadOptions) -> Recording:
        fits = [each for each in layouts if _recognises(each, document)]
        return _read(name, (fits or layouts)[0], document, asked)

    return Reader(
        title,
        layout,
        lambda document: any(_recognises(each, document) for each in layouts),
        read,
        "; ".join(each.met for each in layouts if each.met),
        assumed,
    )
