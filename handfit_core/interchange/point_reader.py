"""The one reader of points: a `PointLayout` says what differs between programs (formats/keypoints.py)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from handfit_core.common.errors import InputError, OptionError
from handfit_core.common.files import shown
from handfit_core.common.skeleton import NUM_KEYPOINTS, SIDES, Side
from handfit_core.interchange.document import Document, Table
from handfit_core.interchange.json_points import (
    JsonFrames,
    JsonHand,
    frames_of,
    hands_in,
    is_hand,
    keyed,
    objects_in,
    size_in,
    some_contents,
)
from handfit_core.interchange.opening import RELATIVE, scaled
from handfit_core.interchange.orders import BODIES, HANDS, WHOLE_BODIES, width_of
from handfit_core.interchange.point_hands import (
    UNKNOWN,
    ParsedHands,
    ParsedPoints,
    check_some,
    hands_in_space,
    in_metres,
    in_order,
    is_world,
    metres_of,
    odd_sides,
    own_sides,
    seen_hands,
    with_sides,
    without_hidden,
)
from handfit_core.interchange.point_names import side_named
from handfit_core.interchange.readers import Reader
from handfit_core.interchange.recording import PointsHand, ReadOptions, Recording, known
from handfit_core.interchange.settings import LIMITS
from handfit_core.interchange.skeletons import UP_AXES
from handfit_core.interchange.table_points import HandTable, columns_of

AXES: Final = UP_AXES | {
    "camera": np.eye(3),
    # Of Aria's glasses: down, to the left, away from who wears them
    "aria": np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
}
"""To the camera's axes, by the axis that is up, or by the device"""


@dataclass(frozen=True)
class PointLayout:
    """How a program writes the 21 points of hands: an entry of a table."""

    name: str
    title: str
    files: str
    """What such a file is, as a phrase for messages and lists"""
    source: str
    """Where the program says so"""
    marks: tuple[str, ...] = ()
    """Keys of an object by which such JSON is recognised: all that stand in one of these, as in "a b\""""
    table: Callable[[Table], bool] = lambda _: False
    """Whether a table is of it"""
    recognises: Callable[[Document], bool] = lambda _: False
    """Whether any other file or folder is of it"""
    columns: str = "xy xyz xyzc"
    """What a list of numbers is that stands for a point, for each length: c is the confidence"""
    people: str = ""
    """The keys that a frame's list of people may have; empty: hands stand in the frame itself"""
    parts: Mapping[int, Mapping[Side, Sequence[int]]] = field(default_factory=lambda: WHOLE_BODIES)
    """Which points each hand has, by how many a list of more than one hand has"""
    order: str = ""
    """Of `ORDERS`; empty: as the names of points or the bones tell"""
    grouped: bool = False
    """Whether each person or hand stands alone in a list, with the number of its frame"""
    hands: Callable[[Any], Any] = lambda frame: frame
    """From a frame, or with `people` from each of these, to objects with `side` and `points`, where hands are
    told in another way"""
    read: Callable[[Document], ParsedPoints | None] = lambda _: None
    """The hands of what is neither a table nor frames of JSON"""
    persons: Literal["one", "told", "unknown"] = "unknown"
    """Whether a file is of one person, or tells them; else nobody can be chosen"""
    least: float = 0.0
    """Mean confidence below which a hand in a picture is left out"""
    from_below: bool = False
    """Whether parts of a picture count from its lower left corner"""
    halved: Callable[[JsonFrames], bool] = lambda _: False
    """Whether parts of a picture's size go from -1 to 1"""
    units: Mapping[str, float] | None = None
    """Metres of the units that points in space may have, the usual one first; None: points are in the plane,
    or in metres of the camera frame"""
    up: str = "y"
    """Of `AXES`: which axis of such space is up, or whose axes they are"""
    mirrored: bool = False
    """Whether such space may be left-handed, with z away from who looks, as Unity's is"""
    on_joints: bool = False
    """Whether points in space are a skeleton's joints"""
    sigma: float | None = 0.005
    """Metres that points in space are expected to be off; None: as far as the lengths of bones change"""
    first: int = 1
    """From what frames without numbers count"""
    ours: bool = False
    """Whether this project writes it: several hands of a side stay apart, and what is not told is an error"""
    assumed: tuple[str, ...] = ()
    """What is always assumed"""
    met: str = ""
    """The real file that it was tried with: project and date; empty: it was written by the description"""
    assumes: str = ""
    """What is assumed of every file, for the table of docs/interchange.md"""
    hint: str = ""
    """What to do where there are no hands"""

    @property
    def reader(self) -> Reader:
        """What reads it."""
        return Reader(self.title, self.files, self._recognises, self._read, self.met, self.assumes)

    def _recognises(self, document: Document) -> bool:
        if document.table is not None and document.numbers is None:
            return self.table(document.table)
        marks = [set(mark.split()) for mark in self.marks]
        objects = (each for content in some_contents(document) for each in objects_in(content))
        if marks and any(mark <= set(each) for each in objects for mark in marks):
            return True
        return self.recognises(document)

    def _read(self, document: Document, asked: ReadOptions) -> Recording:
        path = shown(document.path)
        if asked.person is not None and self.persons == "unknown":
            raise OptionError(f"{path}: {self.title}'s hands belong to no persons; leave --person out")
        try:
            told = self.read(document) or points_of_arrays(document)
            if told is None and document.table is not None:
                told = HandTable(document.table, document.path).hands(
                    first=self.first, in_space=self.units is not None, ours=self.ours
                )
            told = told or self._of_json(document, asked)
            said = (document.cut, *told.assumed) if document.cut else told.assumed
            told = replace(told, order=told.order or self.order, assumed=said)
            return self._recording(told, document, asked)
        except InputError:
            raise
        except ValueError as error:
            raise InputError(f"{path}: read as {self.title}, {str(error)[:300]}") from error

    def _is_one(self, content: Any) -> bool:
        """Whether JSON is one frame: a hand, or a list of people."""
        if not self.people:
            return is_hand(content)
        return isinstance(content, list) and bool(content) and "keypointscores" in keyed(content[0])

    def _of_json(self, document: Document, asked: ReadOptions) -> ParsedPoints:
        frames = frames_of(document, self._is_one, grouped=self.grouped)
        columns = {len(each): each for each in self.columns.split()}
        told: list[tuple[Any, ...]] = []
        most, mirrored, named = 0, set(), set()
        for row, content in enumerate(frames.contents):
            try:
                people = list(self._people(content))
                most = max(most, len(people))
                for number, human in enumerate(people, 1):
                    if self.persons != "told" or asked.person in (None, number):
                        for hand in hands_in(human, columns):
                            mirrored.add(hand.mirrored)
                            named.add(hand.named or len(hand.points) in set(WHOLE_BODIES) - {42})
                            told += ((row, number, *part) for part in self._parts(hand))
                            LIMITS.check(document.path, 1, len(told))
            except (TypeError, ValueError, AttributeError, LookupError, OverflowError) as error:
                said = f"it lacks {error}" if isinstance(error, LookupError) else str(error)
                raise InputError(
                    f"{shown(document.path)}: frame {frames.numbers[row]} is not as {self.title} writes it "
                    f"({said[:200]})"
                ) from error
        if self.persons == "told" and (asked.person or 0) > most:
            raise InputError(
                f"{shown(document.path)}: there is no person {asked.person}; its frames have at most {most}"
            )
        row, hand, side, score, points, world = zip(*told, strict=True) if told else ((),) * 6
        return ParsedPoints(
            frames.numbers,
            ParsedHands.of(row, side, hand, score, points, world),
            frames.fps,
            size_in(frames.header) or size_in(keyed(frames.contents[0])),
            order="mediapipe" if named == {True} else "",
            in_space=self.units is not None,
            mirrored=True if mirrored == {True} else None,
            halved=self.halved(frames),
            assumed=frames.assumed,
        )

    def _people(self, content: Any) -> Sequence[Any]:
        """What of a frame is asked for hands. Raises ValueError."""
        if not self.people:
            return [self.hands(content)]
        found = keyed(content)
        key = next((key for key in self.people.split() if key in found), "")
        people = found[key] if key else content
        if not key and isinstance(content, Mapping):
            people = [content] if self.grouped else None
        if not isinstance(people, list):
            raise ValueError(f"it has no list of {self.people}")
        return [self.hands(each) for each in people]

    def _parts(self, hand: JsonHand) -> Iterator[tuple[Any, ...]]:
        """Side, score, points (K, 4) and world (K, 3) of each hand that a list of points has."""
        count = len(hand.points)
        if count in BODIES:
            return
        if count not in HANDS and count not in self.parts:
            raise ValueError(
                f"{count} points, of which it is not known where hands are; expected 20 or 21 a hand"
            )
        whole: dict[Side | None, Sequence[int]] = {None: range(count)}
        for side, points in (whole if count in HANDS else self.parts[count]).items():
            named = side or hand.side
            code = UNKNOWN if named is None else SIDES.index(named)
            chosen = list(points)
            yield code, hand.score, hand.points[chosen], hand.world[chosen]

    def _recording(self, told: ParsedPoints, document: Document, asked: ReadOptions) -> Recording:
        """The recording: hands of known sides, in pixels or in parts of the picture, or before the camera."""
        hands, what = told.hands, f"{shown(document.path)}: read as {self.title}"
        made = Recording(
            self.name,
            (str(document.path.absolute()),),
            asked.fps or told.fps,
            told.numbers,
            size=told.size,
            intrinsics=told.intrinsics,
        )
        if self.ours and np.any(hands.side == UNKNOWN):
            raise ValueError("some of them have no side; expected left or right")
        parts = bool(np.nanmax(np.abs(hands.in_plane), initial=0.0) <= LIMITS.relative)
        if not told.in_space and parts and self.units is None and in_metres(hands):
            said = "its points are metres before the camera: x right, y down, z away"
            told = replace(told, in_space=True, assumed=(*told.assumed, said))
        hands, ordered = in_order(told, asked.order, parts=parts)
        said, in_space = (*told.assumed, *ordered), told.in_space
        if not in_space and (not known(hands.points[..., :2]).any() or is_world(hands)):
            world = hands.points if known(hands.points).any() else hands.world
            hands = replace(hands, points=world, confidence=known(world).astype(float))
            said, in_space = (
                (*said, "its points are metres without a place: the hands stay where they are"),
                True,
            )
        hands, hidden = without_hidden(hands, 0.0 if in_space else self.least)
        check_some(hands, what, self.hint)
        said = (*said, *hidden)
        whole = np.isfinite(hands.world).all(axis=(1, 2), keepdims=True)
        shapes = np.where(whole, hands.world, hands.points)
        if told.guessed or (not self.ours and self.units is None):
            hands, swapped = own_sides(hands, shapes, told.mirrored)
            said = (*said, *swapped)
        hands, sides = with_sides(hands, asked.hands, shapes)
        said = (*said, *sides)
        if in_space:
            points, assumed = self._in_space(hands, len(told.numbers))
            return replace(made, points=points, assumed=(*said, *self.assumed, *assumed))
        hands, relative, scale = self._scaled(hands, told, asked)
        size = RELATIVE if relative else told.size
        made = replace(made, seen=seen_hands(hands), size=size, assumed=(*said, *scale))
        return made if told.size is None else scaled(made, *told.size)

    def _scaled(
        self, hands: ParsedHands, told: ParsedPoints, asked: ReadOptions
    ) -> tuple[ParsedHands, bool, tuple[str, ...]]:
        """The hands from the upper left corner, whether they are in parts of the picture's size, and what is
        said of that."""
        points, deep = hands.points.copy(), hands.points[..., 2]
        if np.nanmax(np.abs(hands.in_plane)) > LIMITS.relative:
            if np.isfinite(deep).any() and np.nanmax(np.abs(deep)) <= LIMITS.relative:
                # Pixels beside a depth in parts of the picture's width.
                size = told.size or asked.picture_size
                points[..., 2] = deep * size[0] if size is not None else np.nan
            said = "its points are pixels, which are taken to count from the upper left corner"
            return replace(hands, points=points), False, (said,) if self.from_below else ()
        if told.halved:
            points[..., :2] = (points[..., :2] + 1.0) / 2.0
        if self.from_below:
            points[..., 1] = 1.0 - points[..., 1]
        said = (
            "its points lie between -1 and 1" if told.halved else "its points are parts of the picture's size"
        )
        return replace(hands, points=points), True, (said,) if self.people else ()

    def _in_space(self, hands: ParsedHands, count: int) -> tuple[tuple[PointsHand, ...], tuple[str, ...]]:
        """The hands in metres before the camera, over that many frames, and what is said of them."""
        points, said = hands_in_space(
            hands, count, counted=self.ours, on_joints=self.on_joints, sigma=self.sigma
        )
        if self.units:
            unit, guessed = metres_of(points, self.units)
            axes = unit * AXES[self.up].T
            points = tuple(replace(hand, points=hand.points @ axes) for hand in points)
            if self.mirrored and odd_sides(points):
                points = tuple(replace(hand, points=hand.points * [1.0, 1.0, -1.0]) for hand in points)
                said = (*said, "its space is left-handed, as Unity's: so its fingers bend as their sides'")
            # Devices that know joints know which hand they see.
            said = (*said, *guessed, *(() if self.on_joints else odd_sides(points)))
        return points, said


def arrays_of(document: Document) -> list[tuple[str, np.ndarray]]:
    """Names and numbers of the arrays of a .npy, a .npz or a table without names that may be hands' points:
    (T, P, K, D), T frames of P hands or persons with K points each."""
    return [(name, laid) for name, array in document.arrays.items() if (laid := _laid_out(array)) is not None]


def _laid_out(array: np.ndarray) -> np.ndarray | None:
    """An array as (T, P, K, D); None for one that can be no points of hands."""
    counts = HANDS | set(WHOLE_BODIES)
    if array.ndim == 2 and array.shape[0] in counts and array.shape[1] in (2, 3, 4):
        return array[None, None]
    if array.ndim == 2 and array.size:
        if len(array) > 1 and (np.diff(array[:, 0]) == 1.0).all():
            array = array[:, 1:]  # The first column counts frames.
        width = width_of(array.shape[1], (2, 3, 4))
        fits = width and array.shape[1] // width in counts
        return array.reshape(len(array), 1, -1, width) if fits else None
    if array.ndim == 3:
        array = array[:, None]
    fits = array.size and array.ndim == 4 and array.shape[2] in counts and array.shape[3] in (2, 3, 4)
    return array if fits and 0 < array.shape[1] < 20 else None


def points_of_arrays(document: Document) -> ParsedPoints | None:
    """The hands of a document's arrays; None where there are none. Raises ValueError."""
    told: list[tuple[np.ndarray, ...]] = []
    arrays = arrays_of(document)
    widest = max((array.shape[-1] for _, array in arrays), default=0)
    arrays = [(name, array) for name, array in arrays if array.shape[-1] == widest]
    if len(arrays) > 1 and not all(side_named(name) for name, _ in arrays):
        names = ", ".join(name for name, _ in arrays)[:200]
        raise ValueError(
            f"it has several arrays of points ({names}); save the right "
            "one as .npy, or both hands' as left and right"
        )
    for name, array in arrays:
        frames, people, count, width = array.shape
        LIMITS.check(document.path, frames, people * (2 if count in WHOLE_BODIES else 1))
        whole: dict[Side | None, Sequence[int]] = {side_named(name): range(count)}
        for side, chosen in (whole if count in HANDS else WHOLE_BODIES[count]).items():
            points = np.full((frames * people, len(chosen), 4), np.nan)
            points[..., :width] = array[:, :, list(chosen)].reshape(len(points), -1, width)
            x, third = (np.nan_to_num(points[..., axis]) for axis in (0, 2))
            if (
                width == 3
                and third.min(initial=1.0) >= 0.0
                and third.max(initial=0.0) <= 1.0 < x.max() / 10.0
            ):
                points[..., 3], points[..., 2] = third, np.nan
            code = UNKNOWN if side is None else SIDES.index(side)
            row, hand = np.divmod(np.arange(len(points)), people)
            told.append((row, np.full(len(row), code), hand + people * len(told), points))
    if not told:
        return None
    if len({(len(each[0]), each[3].shape[1]) for each in told}) > 1:
        raise ValueError("its arrays have different numbers of frames, hands or points")
    row, side, hand, points = (np.concatenate(each) for each in zip(*told, strict=True))
    hands = ParsedHands.of(row, side, hand, np.full(len(row), np.nan), points)
    # MediaPipe's depths count from the wrist, whose own is zero.
    deep = np.nan_to_num(hands.points[..., 2], nan=0.0)
    in_space = bool(len(hands) and not (np.abs(deep) < 1e-9).all(axis=0).any())
    both = any(array.shape[2] == 2 * NUM_KEYPOINTS for _, array in arrays)
    return ParsedPoints(np.arange(1, row.max() + 2), hands, in_space=in_space, guessed=both)


def is_hand_table(table: Table) -> bool:
    """Whether a table holds points of hands."""
    return columns_of(table) is not None or HandTable(table, Path()).is_long
