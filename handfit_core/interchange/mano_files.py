"""The one reader of MANO's parameters: a `ManoLayout` is an entry of the table in formats/mano.py."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
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

_SUFFIXES: Final = (".npz", ".json", ".npy", ".pkl")
_NUMBERS: Final = re.compile(r"(?<!\d)\d{1,18}(?!\d)")
_MOST_DIGITS: Final = 2
"""of a hand's number in a file's name; longer ones are frames'"""
_LOOKED_AT: Final = 2000
"""Dictionaries of a file in which a hand is looked for before it is said that it has none"""
_WORLDS: Final = {"y": UP_AXES["y"], "z": UP_AXES["z"], "opengl": np.diag([1.0, -1.0, -1.0])}


@dataclass(frozen=True)
class ManoLayout:
    """How a program keeps MANO's parameters in a file, or in the files of a folder."""

    source: str
    """The address where this is written down"""
    keys: Mapping[str, str]
    """The names in a file, parted by blanks, of `global_orient`, `hand_pose`, `transl`, `betas`, `right` (1
    and 0), `frame`, `time` (nanoseconds), `present`, `fps`, `focal`, `size`, `intrinsics` (fx, fy, cx, cy, or
    a 3x3 matrix), `cam_R`, `cam_t`; with `body_pose`, `global_orient` is a body's. `SIDE` in a name stands
    for left and right"""
    needs: str
    """Which of them a file of this layout must have; `a|b`: one of the two"""
    met: str = ""
    """The real file that it was tried with: a project and when; empty: it is read by its description"""
    rows: Literal["hands", "sides", "tracks"] = "hands"
    """What rows are: hands of any frame; the frames of each side; or tracks with frames, whose sides are
    `right`, else a left and a right hand"""
    side: Literal["", "right", "asked"] = ""
    """Whose all hands are, where the file has one side only: right, or what --hands says"""
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
    """An expression that names of a folder's files match; with groups (`first` and `last`, `frame`,
    `person`), each of these files must have hands"""
    matrices: bool = False
    """Whether poses are only recognised by being matrices"""
    directions: bool = False
    """Whether poses are coefficients of MANO's principal directions, however many"""
    counted: mano.Counted = "flat"
    mean_where: tuple[str, str] | None = None
    """A name and what stands under it where poses count from the mean"""
    zeros_missing: bool = False
    """Whether a hand of nothing but zeros is a missing one"""
    mirrored: Literal["no", "hands", "world"] = "no"
    """Whether left hands are right ones in a mirror, which takes their places along or not"""
    world: Literal["", "y", "z", "opengl"] = ""
    """Which axis of the hands' frame is up, where it is not the camera's"""
    camera: Literal["none", "told", "centred", "focal"] = "none"
    """How the camera is given: not; by `size` and `intrinsics`; by `intrinsics` with the picture's centre; by
    `focal`"""
    first_frame: int = 0
    """What is added to the frames' numbers in files' names"""
    assumed: tuple[str, ...] = ()
    left_assumed: str = ""
    """What is assumed where there is a left hand"""
    mirrored_by: str = ""
    """What to do, or to think, where left hands bend as if mirrored"""

    @cached_property
    def wanted(self) -> dict[str, str]:
        """Which of the values a name in a file is; of several names, the last one counts most."""
        named = {
            each.replace("SIDE", side): what.replace("SIDE", side)
            for what, names in self.keys.items()
            for side in (SIDES if "SIDE" in names else ("",))
            for each in names.split()
        }
        return dict(reversed(named.items()))


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
    """What names of files, folders and keys say: `first`, `last`, `frame`, `person`, `side`"""

    def __contains__(self, what: str) -> bool:
        return what in self.values

    def numbers(self, what: str, *shape: int) -> np.ndarray | None:
        return mano.numbers(*self.values[what], *shape) if what in self else None

    def rotations(self, what: str, joints: int, count: int | None = None) -> np.ndarray:
        if what not in self:
            raise Unfit(f"{self.layout.keys[what].split()[0]} is missing")
        return mano.rotations(*self.values[what], joints, count)

    @property
    def is_hands(self) -> bool:
        """Whether all is there that the layout needs, for one side at least."""
        if not self.values:
            return False
        needs = [self.layout.needs.replace("SIDE", side).split() for side in SIDES]
        return any(all(any(each in self for each in what.split("|")) for what in of) for of in needs)

    def under(self, key: str) -> _Part:
        """What stands under a key, or in a file or folder of that name."""
        if key in self.layout.sides:
            return replace(self, fixed={**self.fixed, "side": SIDES.index(self.layout.sides[key])})
        return replace(self, name=f"{self.name}/{key}".strip("/")) if _NUMBERS.search(key) else self

    def of(self, names: Iterable[Any], value: Callable[[Any], Any]) -> _Part:
        """With the values of a dictionary, as far as they are wanted."""
        layout, flat = self.layout, dict[str, Any]()
        nested = layout.nested.split()
        for name in names:
            key = str(name)
            for each in nested:
                key = key.removeprefix(f"{each}.").removeprefix(f"{each}/").removeprefix(f"{each}_")
            if key in layout.wanted or key in layout.columns:
                flat[key] = value(name)
            elif key in nested and isinstance(inside := value(name), dict):
                flat |= {str(k): v for k, v in inside.items() if str(k) in layout.wanted}
        return self.having(flat)

    def having(self, flat: Mapping[str, Any]) -> _Part:
        layout = self.layout
        values = {w: (k, flat[k]) for k, w in layout.wanted.items() if flat.get(k) is not None}
        values = {what: named for what, named in values.items() if not _holds(named[1])}
        for key, widths in layout.columns.items():
            if flat.get(key) is not None:
                values |= {what: (key, flat[key]) for parts in widths.values() for what in parts}
        return replace(self, values={**self.values, **values})

    def unpacked(self) -> _Part:
        """With the columns of its arrays apart. Raises Unfit."""
        values = dict(self.values)
        for what, (name, value) in self.values.items():
            if name not in self.layout.columns:
                continue
            widths, array = self.layout.columns[name], np.asarray(value, dtype=np.float64)
            array = array.reshape(len(array), -1) if array.ndim > 2 else np.atleast_2d(array)
            if array.shape[-1] not in widths or not array.size:
                found, known = "x".join(map(str, array.shape)), " or ".join(map(str, widths))
                raise Unfit(
                    f"{name} must have {known} numbers a frame, and is {found}; without hands it has fewer"
                )
            if what in widths[array.shape[-1]]:
                values[what] = name, array[:, widths[array.shape[-1]][what]]
        return replace(self, values=values)


def _holds(value: Any) -> bool:
    """Whether dictionaries may be in a value."""
    while isinstance(value, list) and value:
        value = value[0]
    return value is None or isinstance(value, dict)


def _walk(held: Any, part: _Part, row: int | None = None) -> Iterator[_Part]:
    """The dictionaries in what a file holds, each with what stands around it, down to the hands."""
    layout = part.layout
    if isinstance(held, list) and layout.listed and len(held) == len(layout.listed.split()):
        held = dict(zip(layout.listed.split(), held, strict=True))
    if isinstance(held, np.ndarray):
        yield part.having({"": held})
    elif isinstance(held, dict):
        mine = part.of(held, held.get)
        yield mine
        if not mine.is_hands:
            mine = mine if row is None else replace(mine, row=row)
            for key, value in held.items():
                if isinstance(value, dict) or (isinstance(value, list) and _holds(value)):
                    yield from _walk(value, mine.under(str(key)))
    elif isinstance(held, list):
        part = part if row is None else replace(part, row=row)
        for number, each in enumerate(held, 1):
            if isinstance(each, dict | list) and _holds(each):
                yield from _walk(each, part, number)


def _in_file(document: Document, part: _Part) -> Iterator[_Part]:
    if document.npz is None:
        held = next((h for h in (document.held, document.lines, document.npy) if h is not None), None)
        if "" in part.layout.columns and isinstance(held, list) and not _holds(held):
            held = np.asarray(held, dtype=np.float64)
        yield from _walk(held, part)
        return
    mine = part.of(document.names, document.value)
    yield mine
    for name in () if mine.is_hands else set(document.names) & set(part.layout.sides):
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
            match = re.fullmatch(layout.files, path.stem)
            if match is None:
                continue
            fixed = {key: int(text) for key, text in match.groupdict().items()}
            part = _Part(layout, fixed=fixed).under(within)
            found = _in_file(Document(path), part if fixed else part.under(path.stem))
            found = [each for each in found if each.is_hands]
            if fixed and not found:
                found_ = Document(path).found
                raise Unfit(f"{path.name} must hold hands, or a body with hands, and is {found_}")
            yield from found


def _recognises(layout: ManoLayout, document: Document) -> bool:
    try:
        parts = islice(_parts(layout, document), _LOOKED_AT)
        first = next((part for part in parts if part.is_hands), None)
        if first is None or not layout.matrices:
            return first is not None
        shape = np.shape(first.values["hand_pose"][1])
    except (Unfit, ValueError, TypeError):
        return False
    return shape[-2:] == (3, 3) and np.prod(shape) % (9 * 15) == 0


def _hands(part: _Part, asked: ReadOptions, path: Path, assumed: list[str]) -> Iterator[FoundHands]:
    """The hands of a part, in the camera's frame. Raises Unfit, InputError and OptionError."""
    part = part.unpacked()
    if part.layout.rows == "sides":
        yield from _of_sides(part, asked, path, assumed)
        return
    LIMITS.check(path, np.size(part.values["global_orient"][1]) // 6, 2)
    count, first, last = None, part.fixed.get("first"), part.fixed.get("last")
    if first is not None and last is not None:
        LIMITS.check(path, max(count := last - first + 1, 0))
        if count < 1:
            raise Unfit(f"{first}_{last} are no frames")
    if part.layout.rows == "tracks":
        side, person, frames = _tracks(part, path)
        orient = part.rotations("global_orient", 1, len(side))
    else:
        side = _side(part, asked, assumed)
        orient = part.rotations("global_orient", 1, count if len(side) == 1 else len(side))
        side = np.resize(side, len(orient))
        person, frames = np.full(len(side), -1), _frames(part, side, assumed)
    hands = _found(part, asked, frames + part.layout.first_frame, side, person, orient)
    yield _before_camera(part, hands, asked, assumed)


def _side(part: _Part, asked: ReadOptions, assumed: list[str]) -> np.ndarray:
    """Which of SIDES each row is of (N,), or all rows are of (1,)."""
    if "side" in part.fixed:
        return np.array([part.fixed["side"]])
    if part.layout.side:
        which = part.layout.side
        if which == "asked":
            which = "left" if asked.hands == "left" else "right"
            tell(assumed, f"it was taken for a {which} hand, as the file does not say (--hands)")
        return np.array([SIDES.index(which)])
    right = part.numbers("right", 1)
    if right is None or not np.isin(right, (0.0, 1.0)).all():
        raise Unfit("right must be 1 for right hands and 0 for left ones")
    return np.where(right[:, 0] > 0.0, SIDES.index("right"), SIDES.index("left"))


def _tracks(part: _Part, path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Side, person and frame of each row of tracks: (tracks * frames,) each."""
    of = "right" if "right" in part else "present"
    name, value = part.values[of]
    flags = np.asarray(value, dtype=np.float64)
    if flags.ndim != 2 or not flags.size or (of == "present" and len(flags) != len(SIDES)):
        raise Unfit(f"{name} must have the shape {'BxT: tracks and frames' if of == 'right' else '2xT'}")
    count = flags.shape[1]
    LIMITS.check(path, count, len(flags))
    if of == "right":
        side = (np.mean(flags > 0.5, axis=1) >= 0.5) * SIDES.index("right")
    else:
        side = np.arange(len(SIDES))
    person = [int(np.sum(side[:track] == side[track])) for track in range(len(side))]
    frames = np.tile(np.arange(1, count + 1), len(side))
    return np.repeat(side, count), np.repeat(person, count), frames


def _found(
    part: _Part,
    asked: ReadOptions,
    frames: np.ndarray,
    side: np.ndarray,
    person: np.ndarray,
    orient: np.ndarray,
) -> FoundHands:
    """Hands of these frames, sides and orientations (N, 3), with the part's other values of them."""
    count = len(orient)
    place = part.numbers("transl", 3)
    if place is None:
        place = np.full((count, 3), np.inf)
    elif len(place) != count:
        raise Unfit(f"{part.values['transl'][0]} has {len(place)} rows where {count} are expected")
    shapes = np.full((count, NUM_BETAS), np.nan)
    if "betas" in part and np.size(part.values["betas"][1]):
        name, value = part.values["betas"]
        try:
            rows = np.asarray(value, dtype=np.float64)[..., :NUM_BETAS]
        except (TypeError, ValueError, IndexError):
            raise Unfit(f"{name} must be numbers of the shape Nx{NUM_BETAS}") from None
        rows = mano.numbers(name, rows, NUM_BETAS)
        # One shape for each row, each track or all; else nobody knows whose they are
        if len(rows) and count % len(rows) == 0:
            shapes = np.repeat(rows, count // len(rows), axis=0)
    found = FoundHands(frames, side, person, shapes, orient, _pose(part, asked, side), place)
    if part.layout.zeros_missing:
        found = found.at(np.any(found.hand_pose != 0.0, axis=1) | np.any(orient != 0.0, axis=1))
    if "present" in part:
        name, value = part.values["present"]
        rows = mano.numbers(name, value, 1)[:, 0]
        if len(rows) != count:
            rows = mano.numbers(name, value, 2)[:, int(side[0])]
        if len(rows) != count:
            raise Unfit(f"{name} tells of {len(rows)} frames whether there is a hand, and there are {count}")
        found = found.at(rows > 0.0)
    if part.layout.mirrored != "no":
        found = found.mirrored(places=part.layout.mirrored == "world")
    return found.from_flat(asked, part.layout.counted) if part.layout.directions else found


def _pose(part: _Part, asked: ReadOptions, side: np.ndarray) -> np.ndarray:
    """(N, 45) axis-angle of the fingers; without MANO's mean where they are coefficients."""
    name, value = part.values["hand_pose"]
    width = np.shape(value)[-1] if np.ndim(value) else 0
    if not part.layout.directions and (width == 3 or width >= POSE or not np.size(value)):
        return mano.rotations(name, value, 15, len(side))
    coefficients = np.asarray(value, dtype=np.float64).reshape(len(side), -1)
    pose = np.empty((len(side), POSE))
    for index in set(side.tolist()):
        mine = side == index
        pose[mine] = mano.from_directions(coefficients[mine], SIDES[index], asked)
    return pose


def _frames(part: _Part, side: np.ndarray, assumed: list[str]) -> np.ndarray:
    """Each hand's frame; any where the part's name has it."""
    count = len(side)
    if "first" in part.fixed or "frame" in part.fixed:
        return part.fixed.get("frame", 0) + np.arange(count) + part.fixed.get("first", 0)
    if "frame" in part:
        rows = mano.numbers(*part.values["frame"], 1)[:, 0]
        rows = np.repeat(rows, count) if len(rows) == 1 else rows
        if len(rows) != count or not np.all(rows == np.round(rows)):
            raise Unfit(f"frame must be {count} whole numbers, one for each hand")
        return rows.astype(np.int64)
    if part.row is not None or part.name:
        return np.full(count, part.row or 0)
    if count > 1 and len(set(side.tolist())) == 1:
        tell(assumed, "its rows were taken as one hand's frames, as it does not tell whose they are")
        return np.arange(1, count + 1)
    return np.ones(count, dtype=int)


def _before_camera(part: _Part, hands: FoundHands, asked: ReadOptions, assumed: list[str]) -> FoundHands:
    """The hands of a world, or of a camera of other axes, in the camera's frame."""
    layout = part.layout
    if layout.world:
        return hands.seen_from(_WORLDS[layout.world], np.zeros(3), asked)
    if "cam_R" not in layout.keys:
        return hands
    if "cam_R" not in part or "cam_t" not in part:
        tell(assumed, "the camera is not told (cam_R, cam_t): the world was taken to have its axes")
        return hands
    rotation, shift = mano.numbers(*part.values["cam_R"], 3, 3), mano.numbers(*part.values["cam_t"], 3)
    frames = len(set(hands.frame.tolist()))
    if len(rotation) != len(shift) or len(rotation) not in (frames, len(hands)):
        raise Unfit(f"cam_R and cam_t must have {frames} frames, and have {len(rotation)}, {len(shift)}")
    times = len(hands) // len(rotation)
    rotation = mano.checked_matrices("cam_R", rotation)
    return hands.seen_from(np.tile(rotation, (times, 1, 1)), np.tile(shift, (times, 1)), asked)


def _of_sides(part: _Part, asked: ReadOptions, path: Path, assumed: list[str]) -> Iterator[FoundHands]:
    """The frames of a left and a right hand, or of a body with both."""
    body, pelvis, turn = None, np.empty((0, 3)), None
    if "body_pose" in part:
        LIMITS.check(path, np.size(part.values["body_pose"][1]) // (3 * mano.BODY_JOINTS), 2)
        body = part.rotations("body_pose", mano.BODY_JOINTS)
        pelvis = part.rotations("global_orient", 1, len(body))
        tell(assumed, _NO_PLACE)
        if "person" not in part.fixed:
            turn = mano.standing(pelvis, assumed)
    still = []
    for index, side in enumerate(SIDES):
        if f"{side}_hand_pose" not in part:
            continue
        LIMITS.check(path, np.size(part.values[f"{side}_hand_pose"][1]) // POSE, 2)
        own = {what.removeprefix(f"{side}_"): of for what, of in part.values.items()}
        own = own if body is None else {k: v for k, v in own.items() if k not in ("transl", "betas")}
        one = replace(part, values=own)
        if body is not None:
            orient = mano.wrist_of_body(pelvis, body, side)
        else:
            orient = one.rotations("global_orient", 1, len(mano.rotations(*own["hand_pose"], 15)))
        sides = np.full(len(orient), index)
        if "frame" in part.fixed and len(orient) != 1:
            raise Unfit(f"each file must hold one body, and one has {len(orient)}")
        counted = "frame" in part.fixed or "frame" in part
        frames = _frames(part, sides, assumed) if counted else np.arange(1, len(orient) + 1)
        hands = _found(one, asked, frames, sides, np.full(len(orient), part.fixed.get("person", 0)), orient)
        still.append(hands.hand_pose)
        yield hands if turn is None else hands.turned(turn)
    if part.layout.columns and not any(np.any(np.nan_to_num(pose)) for pose in still):
        raise Unfit("the fingers of this body never move: it has none")
    if body is not None and len(body) > 1 and not any(np.any(np.nan_to_num(p - p[0])) for p in still):
        tell(assumed, "the fingers never move: this body was captured without its hands")


_NO_PLACE: Final = (
    "where the wrists are is not known without the body's model: each hand stays in its place, and only turns"
)


def _by_names(names: Collection[str], assumed: list[str]) -> dict[str, int]:
    """The frames that files or keys are of, by their last numbers, or by those before them where the last
    ones count the hands of a picture. Raises Unfit for names of several clips."""
    found = {name: [*_NUMBERS.finditer(name)] for name in names}
    around = {(name[: each[-1].start()], name[each[-1].end() :]) for name, each in found.items()}
    short = [len(each) > 1 and len(each[-1][0]) <= _MOST_DIGITS for each in found.values()]
    if len(around) == 1:
        if any(short):
            tell(assumed, f"the last numbers in the names are the frames', as in {shown(min(names))}")
        return {name: int(each[-1][0]) for name, each in found.items()}
    beside = {
        (name[: each[-2].start()], name[each[-2].end() : each[-1].start()], name[each[-1].end() :])
        for name, each in found.items()
        if all(short)
    }
    if len(beside) == 1:
        tell(assumed, f"the last numbers in the names are the hands', as in {shown(min(names))}")
        return {name: int(each[-2][0]) for name, each in found.items()}
    first, second = ("..".join(each) for each in sorted(around)[:2])
    raise Unfit(
        f"its frames belong to several clips ({first} and {second}, for example); give each its own folder, "
        "with names as frame_0001, or frame_0001_0 with a hand's number"
    )


def _by_time(parts: Sequence[_Part]) -> tuple[float, list[int]]:
    """Frames per second and the frames, from 1, of parts with times."""
    times = np.concatenate([mano.numbers(*part.values["time"], 1)[0] for part in parts]) / 1e9
    steps = np.diff(np.unique(times))
    step = float(np.median(steps)) if len(steps) else 1.0
    frames = 1.0 + np.round((times - times.min()) / step)
    return (1.0 / step if len(steps) else 0.0), frames.astype(np.int64).tolist()


def _read(name: str, layout: ManoLayout, document: Document, asked: ReadOptions) -> Recording:
    assumed = list(layout.assumed)
    found: list[FoundHands] = []
    named: dict[str, list[FoundHands]] = {}
    parts = [part for part in _parts(layout, document) if part.is_hands]
    if not parts:
        raise Unfit(f"there is no hand in {document.found}")
    rate, frames_ = _by_time(parts) if "time" in parts[0] else (0.0, [])
    for number, part in enumerate(parts):
        hands = [*_hands(part, asked, document.path, assumed)]
        if frames_:
            found += [replace(each, frame=np.full(len(each), frames_[number])) for each in hands]
        elif not part.name or "frame" in part:
            found += hands
        else:
            named.setdefault(part.name, []).extend(hands)
        LIMITS.check(document.path, 1, sum(map(len, found)))
    numbers = _by_names(named, assumed) if named else {}
    found += [replace(h, frame=np.full(len(h), numbers[key])) for key, each in named.items() for h in each]
    hands = FoundHands.concatenate(found)
    if not layout.directions:
        wanted, why = layout.mean_where or ("", "")
        counted = "mean" if wanted and str(document.value(wanted)) == why else layout.counted
        hands = hands.from_flat(asked, counted)
    del found
    frames = np.unique(hands.frame)
    posed = mano.followed(hands, frames, asked, assumed)
    posed = tuple(hand for hand in posed if hand.present.any())
    if not posed:
        raise Unfit("there is no hand in any of its frames")
    if "transl" in layout.keys and hands.nowhere:
        key = layout.keys["transl"].split()[0]
        tell(assumed, f"where the hands are is not told ({key}): each stays in its place")
    if layout.left_assumed and any(hand.side == "left" for hand in posed):
        tell(assumed, layout.left_assumed)
    if len(set(hands.person.tolist())) > 1 and "person" in parts[0].fixed:
        tell(assumed, "persons are told apart by the number in the files' names, which may change places")
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
    layout: ManoLayout, parts: Iterable[_Part], asked: ReadOptions, assumed: list[str], *, nowhere: bool
) -> tuple[tuple[int, int] | None, Intrinsics | None]:
    """The pictures' size and the camera, as the parts tell them."""

    def told(what: str, *shapes: int) -> np.ndarray:
        rows = [rows for part in parts if (rows := part.numbers(what, *shapes)) is not None]
        return np.concatenate(rows or [np.empty((0, *shapes))])

    sizes = told("size", 2)
    if layout.camera in ("told", "centred"):
        matrix = any(
            np.shape(part.values["intrinsics"][1])[-2:] == (3, 3) for part in parts if "intrinsics" in part
        )
        if matrix:
            intrinsics = told("intrinsics", 3, 3)[:, [0, 1, 0, 1], [0, 1, 2, 2]]
        else:
            intrinsics = told("intrinsics", 4)
        if not len(intrinsics) or (layout.camera == "told" and not len(sizes)):
            return None, None
        fx, fy, cx, cy = intrinsics[0].tolist()
        if layout.camera == "told":
            return (int(sizes[0, 0]), int(sizes[0, 1])), Intrinsics(fx, fy, cx, cy)
        width, height = round(2.0 * cx), round(2.0 * cy)
        if not 0 < min(width, height) <= max(width, height) < 1 << 24:
            raise Unfit(f"intrins must be fx, fy, cx, cy in pixels, and has cx {cx:g}, cy {cy:g}")
        tell(assumed, f"pictures of {width}x{height} pixels, twice the principal point")
        return (width, height), Intrinsics(fx, fy, cx, cy)
    if layout.camera != "focal" or nowhere:
        return None, None
    size = asked.picture_size or ((int(sizes[0, 0]), int(sizes[0, 1])) if len(sizes) else None)
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


def mano_reader(name: str, title: str, layout: str, *layouts: ManoLayout) -> Reader:
    """A reader of files in one of the layouts, the more particular ones first; `name`: the reader's own,
    `title` and `layout` as `Reader` has them."""

    def read(document: Document, asked: ReadOptions) -> Recording:
        fits = [each for each in layouts if _recognises(each, document)]
        return _read(name, (fits or layouts)[0], document, asked)

    return Reader(
        title,
        layout,
        lambda document: any(_recognises(each, document) for each in layouts),
        read,
        unseen=not any(each.met for each in layouts),
    )
