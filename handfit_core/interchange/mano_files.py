"""One reader of all trackers that keep MANO's parameters: a `ManoLayout` says how, `mano_reader` reads it."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from handfit_core.common.files import shown
from handfit_core.common.skeleton import NUM_BETAS, SIDES
from handfit_core.common.values import Unfit
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.files import load_model
from handfit_core.interchange import mano
from handfit_core.interchange.document import Document
from handfit_core.interchange.mano import FoundHands, tell
from handfit_core.interchange.readers import Reader
from handfit_core.interchange.recording import ReadOptions, Recording
from handfit_core.interchange.settings import LIMITS

_SUFFIXES: Final = (".npz", ".json", ".npy", ".pkl")
_NUMBERS: Final = re.compile(r"(?<!\d)\d{1,18}(?!\d)")
_MOST_DIGITS: Final = 2
"""of a hand's number in a file's name; longer ones are frames'"""


@dataclass(frozen=True)
class ManoLayout:
    """How a program keeps MANO's parameters in a file, or in the files of a folder."""

    source: str
    """Where that is written down: an address"""
    keys: Mapping[str, str]
    """Under which names, parted by blanks, stand `global_orient`, `hand_pose`, `transl`, `betas`, `right` (1
    and 0), `frame`, `present`, `fps`, `focal`, `size`, `intrinsics` (fx, fy, cx, cy), `cam_R`, `cam_t`; with
    `body_pose`, `global_orient` is a body's. `SIDE` in a name stands for left and right"""
    needs: str
    """Which of them tell that a file is of this layout; `a|b`: one of the two"""
    axes: Literal["hands", "sides", "tracks"] = "hands"
    """What rows are: hands of any frame, with `right`; the frames of each side; or tracks with frames, by
    `right`, else a left and a right hand"""
    nested: str = ""
    """Dictionaries within that have some of the keys, or begin their names"""
    listed: str = ""
    """The names of what stands in a list without any"""
    columns: Mapping[str, Mapping[int, Mapping[str, slice]]] = field(default_factory=dict)
    """Which columns of an array of so many hold which of the values"""
    folder: str = ""
    """The folder within the one that is given in which the files lie, if it is there"""
    side_folders: tuple[str, ...] = ()
    """In it, the folders of left and right hands"""
    files: str = ""
    """An expression that names of a folder's files match, with the groups `first` and `last` or `frame` and
    `person`"""
    many: bool = False
    """Whether a dictionary may stand for each frame or hand, in lists, by their names, and in files"""
    matrices: bool = False
    """Whether poses are only known by being matrices"""
    counted: mano.Counted = "flat"
    mean_where: tuple[str, str] | None = None
    """A name and what stands under it where poses count from the mean"""
    mirrored: Literal["no", "hands", "world"] = "no"
    """Whether left hands are right ones in a mirror, which takes their places along or not"""
    camera: Literal["none", "told", "centred", "focal"] = "none"
    """How the camera is told: not; by `size` and `intrinsics`; by `intrinsics` with the picture's centre; by
    `focal`"""
    first_frame: int = 0
    """What is added to the frames' numbers in files' names"""
    assumed: tuple[str, ...] = ()
    left_assumed: str = ""
    """What is assumed where there is a left hand"""
    mirrored_by: str = ""
    """What to do, or to think, where left hands bend as if mirrored"""


@dataclass(frozen=True, eq=False)
class _Part:
    """The values of one dictionary: name in the file and value, by the names of `ManoLayout.keys`."""

    values: Mapping[str, tuple[str, Any]]
    layout: ManoLayout
    frame: int | None = None
    name: str | None = None
    """The name of its file or its key, where that has the frame's number"""
    fixed: Mapping[str, int] = field(default_factory=dict)
    """What its file's name and folder tell: `first`, `last`, `person`, `side`"""

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
        needs = [self.layout.needs.replace("SIDE", side).split() for side in SIDES]
        return any(all(any(each in self for each in what.split("|")) for what in of) for of in needs)


def _part(layout: ManoLayout, held: Any, **told: Any) -> _Part | None:
    """The values in a document, a dictionary or a list; None where it is none of these."""
    if isinstance(held, Document):
        listed = held.held if isinstance(held.held, list) and held.npz is None else None
        names, value = held.names, held.value
    else:
        listed = None
        names, value = (list(held), held.get) if isinstance(held, dict) else ([], dict[str, Any]().get)
    wanted: dict[str, str] = {}
    for what, aliases in layout.keys.items():
        sides = SIDES if "SIDE" in aliases else ("",)
        wanted |= {
            each.replace("SIDE", side): what.replace("SIDE", side)
            for side in sides
            for each in aliases.split()
        }
    flat: dict[str, Any] = {}
    nested = layout.nested.split()
    for name in names:
        key = str(name)
        for each in nested:
            key = re.sub(rf"^{each}[._/]", "", key)
        if key in wanted or key in layout.columns:
            flat[key] = value(name)
        elif key in nested and isinstance(inside := value(name), dict):
            flat |= {str(k): v for k, v in inside.items() if str(k) in wanted}
    if listed is not None and len(listed) == len(layout.listed.split()):
        flat = dict(zip(layout.listed.split(), listed, strict=True))
    values = {wanted[key]: (key, flat[key]) for key in reversed(list(wanted)) if flat.get(key) is not None}
    for key, widths in layout.columns.items():
        if flat.get(key) is not None:
            values |= {what: (key, flat[key]) for parts in widths.values() for what in parts}
    return _Part(values, layout, **told) if flat else None


def _unpacked(part: _Part) -> _Part:
    """The part with the columns of its arrays apart. Raises Unfit."""
    values = dict(part.values)
    for what, (name, value) in part.values.items():
        if name not in part.layout.columns:
            continue
        widths = part.layout.columns[name]
        array = np.asarray(value, dtype=np.float64)
        array = array.reshape(len(array), -1) if array.ndim > 2 else array
        if array.ndim != 2 or array.shape[1] not in widths or not len(array):
            found, known = "x".join(map(str, array.shape)), " or ".join(map(str, widths))
            raise Unfit(
                f"{name} must have {known} numbers a frame, and is {found}; without hands it has fewer"
            )
        values[what] = name, array[:, widths[array.shape[1]][what]]
    return replace(part, values=values)


def _parts(layout: ManoLayout, document: Document) -> Iterator[_Part]:
    """The dictionaries in a file, or in the files of a folder. Raises Unfit."""
    if document.is_folder:
        folder = document.path / layout.folder
        folder = folder if layout.folder and folder.is_dir() else document.path
        for side, within in enumerate(layout.side_folders or ("",)):
            for path in Document(folder / within).files(*_SUFFIXES):
                match = re.fullmatch(layout.files, path.stem) if layout.files else None
                if match:
                    told = {key: int(text) for key, text in match.groupdict().items()}
                    part = _part(layout, Document(path), fixed=told | ({"side": side} if within else {}))
                    if part is None or not part.is_hands:
                        found = Document(path).found
                        raise Unfit(f"{path.name} must hold hands, or a body with hands, and is {found}")
                    yield part
                elif layout.many:
                    for part in _parts(layout, Document(path)):
                        yield replace(part, name=path.stem) if _NUMBERS.search(path.stem) else part
        return
    names = document.names
    by_frame = layout.many and bool(names) and all(re.search(r"\d", str(name)) for name in names)
    held: Any = document.held if by_frame or not names else None
    if not layout.many or not (by_frame or isinstance(held, list)):
        held = [document]
    rows = held.items() if isinstance(held, dict) else enumerate(held, 1)
    for key, value in rows:
        name = key if isinstance(held, dict) and _NUMBERS.search(str(key)) else None
        for values in value if isinstance(value, list) else [value]:
            of_row = key if isinstance(value, list) and not isinstance(held, dict) else None
            part = _part(layout, values, frame=of_row, name=None if name is None else str(name))
            if part is not None:
                yield part


def _recognises(layout: ManoLayout, document: Document) -> bool:
    if document.is_folder and not (layout.files or layout.many):
        return False
    try:
        first = next((part for part in _parts(layout, document) if part.is_hands), None)
    except (Unfit, ValueError, TypeError):
        return False
    if first is None or not layout.matrices:
        return first is not None
    try:
        shape = np.shape(first.values["hand_pose"][1])
    except ValueError:
        return False
    return shape[-2:] == (3, 3) and np.prod(shape) % (9 * 15) == 0


def _hands(part: _Part, path: Path, assumed: list[str]) -> FoundHands:
    """Rows of hands, with their sides."""
    first, last = part.fixed.get("first"), part.fixed.get("last")
    count = None
    if first is not None and last is not None:
        count = last - first + 1
        LIMITS.check(path, max(count, 0))
        if count < 1:
            raise Unfit(f"{first}_{last} are no frames")
    if "side" in part.fixed:
        orient = part.rotations("global_orient", 1, count)
        side = np.full(len(orient), part.fixed["side"])
    else:
        right = part.numbers("right", 1)
        if right is None or not np.isin(right, (0.0, 1.0)).all():
            raise Unfit("right must be 1 for right hands and 0 for left ones")
        LIMITS.check(path, len(right))
        side = np.where(right[:, 0] > 0.0, SIDES.index("right"), SIDES.index("left"))
        orient = part.rotations("global_orient", 1, len(right))
    frames = np.arange(first, first + len(side)) if first is not None else _frames(part, side, assumed)
    person = np.full(len(side), -1)
    return _found(part, frames + part.layout.first_frame, side, person, orient)


def _found(
    part: _Part,
    frames: np.ndarray,
    side: np.ndarray,
    person: np.ndarray,
    orient: np.ndarray,
    prefix: str = "",
) -> FoundHands:
    """Hands of these frames, sides and orientations (N, 3), with the part's other values of them."""
    count = len(orient)
    pose, transl, betas = (f"{prefix}{what}" for what in ("hand_pose", "transl", "betas"))
    place = part.numbers(transl, 3)
    if place is None:
        place = np.full((count, 3), np.inf)
    elif len(place) != count:
        raise Unfit(f"{part.values[transl][0]} has {len(place)} rows where {count} are expected")
    shapes = np.full((count, NUM_BETAS), np.nan)
    if betas in part and np.size(part.values[betas][1]):
        name, value = part.values[betas]
        try:
            rows = np.asarray(value, dtype=np.float64)[..., :NUM_BETAS]
        except (TypeError, ValueError, IndexError):
            raise Unfit(f"{name} must be numbers of the shape Nx{NUM_BETAS}") from None
        rows = mano.numbers(name, rows, NUM_BETAS)
        # A shape of each row, of each track, or of all; else it is not known whose it is
        if len(rows) and count % len(rows) == 0:
            shapes = np.repeat(rows, count // len(rows), axis=0)
    found = FoundHands(frames, side, person, shapes, orient, part.rotations(pose, 15, count), place)
    present = part.values.get("present") or part.values.get(f"{prefix}present")
    if present is not None:
        rows = mano.numbers(present[0], present[1], 1)[:, 0]
        if len(rows) != count:
            rows = mano.numbers(present[0], present[1], 2)[:, int(side[0])]
        if len(rows) != count:
            raise Unfit(
                f"{present[0]} tells of {len(rows)} frames whether there is a hand, and there are {count}"
            )
        found = found.at(rows > 0.0)
    if part.layout.mirrored != "no":
        found = found.mirrored(places=part.layout.mirrored == "world")
    return found


def _frames(part: _Part, side: np.ndarray, assumed: list[str]) -> np.ndarray:
    """Each hand's frame; any where the part's name has it."""
    count = len(side)
    if "frame" in part:
        rows = mano.numbers(*part.values["frame"], 1)[:, 0]
        rows = np.repeat(rows, count) if len(rows) == 1 else rows
        if len(rows) != count or not np.all(rows == np.round(rows)):
            raise Unfit(f"frame must be {count} whole numbers, one for each hand")
        return rows.astype(np.int64)
    if part.frame is not None or part.name is not None:
        return np.full(count, part.frame or 0)
    if count > 1 and len(set(side.tolist())) == 1:
        tell(assumed, "its rows were taken as one hand's frames, as it does not tell whose they are")
        return np.arange(1, count + 1)
    return np.ones(count, dtype=int)


def _tracks(part: _Part, asked: ReadOptions, path: Path, assumed: list[str]) -> Iterator[FoundHands]:
    """The hands of tracks: (tracks, frames, ...), in a world whose camera `cam_R` and `cam_t` tell."""
    of = "right" if "right" in part else "present"
    name, value = part.values[of]
    flags = np.asarray(value, dtype=np.float64)
    if flags.ndim != 2 or not flags.size or (of == "present" and len(flags) != len(SIDES)):
        raise Unfit(f"{name} must have the shape {'BxT: tracks and frames' if of == 'right' else '2xT'}")
    count = flags.shape[1]
    LIMITS.check(path, count, len(flags))
    whole = {
        what: np.asarray(value)
        for what, (_, value) in part.values.items()
        if what not in ("fps", "intrinsics")
    }
    for what, joints in (("global_orient", 1), ("hand_pose", 15), ("transl", 1)):
        rows = mano.numbers(*part.values[what], 3 * joints) if whole[what].shape[-2:] != (3, 3) else None
        if rows is not None and len(rows) != flags.size:
            raise Unfit(
                f"{part.values[what][0]} must have {len(flags)} tracks of {count} frames, and has "
                f"{len(rows)} rows"
            )
        whole[what] = whole[what].reshape(len(flags), count, -1)
    seen = [0, 0]
    for track in range(len(flags)):
        side = track if of == "present" else int(np.mean(flags[track] > 0.5) >= 0.5) * SIDES.index("right")
        mine = {
            what: (part.values[what][0], whole[what][track])
            for what in ("global_orient", "hand_pose", "transl", "betas", "present")
            if what in whole and len(whole[what]) == len(flags)
        }
        one = replace(part, values=mine)
        orient = one.rotations("global_orient", 1, count)
        person = 0 if of == "present" else seen[side]
        seen[side] += 1
        sides, persons = np.full(count, side), np.full(count, person)
        hands = _found(one, np.arange(1, count + 1), sides, persons, orient)
        yield _before_camera(part, hands, asked, track, flags.shape, assumed)


def _before_camera(
    part: _Part, hands: FoundHands, asked: ReadOptions, track: int, shape: tuple[int, ...], assumed: list[str]
) -> FoundHands:
    """A track's hands of a world in their camera's frame: x_camera = R x + t.

    MANO's root turns about the wrist, which does not lie at the origin of the model: with J the wrist of the
    model, the new transl is R (J + transl) + t - J.
    """
    if "cam_R" not in part.layout.keys:
        return hands
    if "cam_R" not in part or "cam_t" not in part:
        tell(assumed, "the camera is not told (cam_R, cam_t): the world was taken to have its axes")
        return hands
    rotation, shift = mano.numbers(*part.values["cam_R"], 3, 3), mano.numbers(*part.values["cam_t"], 3)
    tracks, count = shape
    if len(rotation) != len(shift) or len(rotation) not in (count, tracks * count):
        raise Unfit(f"cam_R and cam_t must have {count} frames, and have {len(rotation)}, {len(shift)}")
    rows = slice(track * count, (track + 1) * count) if len(rotation) == tracks * count else slice(None)
    rotation = mano.checked_matrices("cam_R", rotation[rows])
    side = SIDES[int(hands.side[0])]
    wrist = load_model(asked.model, side).shaped(mano.shape_of(hands.betas, asked, assumed)).joints[0]
    place = (rotation @ (hands.transl + wrist)[..., None])[..., 0] - wrist + shift[rows]
    return replace(hands.turned(rotation), transl=place)


def _sides(part: _Part, asked: ReadOptions, path: Path, assumed: list[str]) -> Iterator[FoundHands]:
    """The frames of a left and a right hand, or of a body with both."""
    part = _unpacked(part)
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
        name = f"{side}_hand_pose"
        if name not in part:
            continue
        LIMITS.check(path, np.size(part.values[name][1]) // mano.POSE, 2)
        value = part.values[name][1]
        if body is not None and np.size(value) and np.shape(value)[-1] not in (3, mano.POSE):
            coefficients = np.asarray(value, dtype=np.float64).reshape(len(body), -1)
            value = mano.from_directions(coefficients, side, asked)
        pose = mano.rotations(part.values[name][0], value, 15, None if body is None else len(body))
        still.append(pose)
        if body is None:
            orient = part.rotations(f"{side}_global_orient", 1, len(pose))
        else:
            orient = mano.wrist_of_body(pelvis, body, side)
        one = replace(part, values={**part.values, name: (name, pose)})
        frames = np.arange(1, len(pose) + 1)
        if "frame" in part.fixed:
            if len(pose) != 1:
                raise Unfit(f"each file must hold one body, and one has {len(pose)}")
            frames = np.array([part.fixed["frame"]])
        elif "frame" in part:
            frames = _frames(part, frames, assumed)
        persons = np.full(len(pose), part.fixed.get("person", 0))
        hands = _found(one, frames, np.full(len(pose), index), persons, orient, f"{side}_")
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
    counting = all(len(each) > 1 and len(each[-1][0]) <= _MOST_DIGITS for each in found.values())
    if len(around) == 1:
        if any(len(each) > 1 and len(each[-1][0]) <= _MOST_DIGITS for each in found.values()):
            tell(assumed, f"the last numbers in the names are the frames', as in {shown(min(names))}")
        return {name: int(each[-1][0]) for name, each in found.items()}
    beside = {
        (name[: each[-2].start()], name[each[-2].end() : each[-1].start()], name[each[-1].end() :])
        for name, each in found.items()
        if counting
    }
    if len(beside) == 1:
        tell(assumed, f"the last numbers in the names are the hands', as in {shown(min(names))}")
        return {name: int(each[-2][0]) for name, each in found.items()}
    first, second = ("..".join(each) for each in sorted(around)[:2])
    raise Unfit(
        f"its frames belong to several clips ({first} and {second}, for example); give each its own folder, "
        "with names as frame_0001, or frame_0001_0 with a hand's number"
    )


def _read(name: str, layout: ManoLayout, document: Document, asked: ReadOptions) -> Recording:
    assumed = list(layout.assumed)
    found: list[FoundHands] = []
    named: dict[str, list[FoundHands]] = {}
    parts = [part for part in _parts(layout, document) if part.is_hands]
    if not parts:
        raise Unfit(f"there is no hand in {document.found}")
    for part in parts:
        if layout.axes == "hands":
            hands = [_hands(part, document.path, assumed)]
        else:
            each = _tracks if layout.axes == "tracks" else _sides
            hands = [*each(part, asked, document.path, assumed)]
        if part.name is None or "frame" in part:
            found += hands
        else:
            named.setdefault(part.name, []).extend(hands)
        LIMITS.check(document.path, 1, sum(map(len, found)))
    numbers = _by_names(named, assumed) if named else {}
    found += [replace(h, frame=np.full(len(h), numbers[key])) for key, each in named.items() for h in each]
    counted = layout.counted
    if layout.mean_where is not None and str(document.value(layout.mean_where[0])) == layout.mean_where[1]:
        counted = "mean"
    hands = FoundHands.concatenate(found).from_flat(asked, counted)
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
    rates = [rate for part in parts[:1] if (rate := part.numbers("fps", 1)) is not None]
    return Recording(
        name,
        (str(document.path.absolute()),),
        float(rates[0][0, 0]) if rates else asked.rate,
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

    def told(what: str, count: int) -> np.ndarray:
        rows = [rows for part in parts if (rows := part.numbers(what, count)) is not None]
        return np.concatenate(rows or [np.empty((0, count))])

    intrinsics, sizes = told("intrinsics", 4), told("size", 2)
    if layout.camera == "told" and len(intrinsics) and len(sizes):
        return (int(sizes[0, 0]), int(sizes[0, 1])), Intrinsics(*intrinsics[0].tolist())
    if layout.camera == "centred" and len(intrinsics):
        fx, fy, cx, cy = intrinsics[0].tolist()
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
    )
