"""The one reader of points: a `PointLayout` says what differs between programs (formats/keypoints.py)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

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
from handfit_core.interchange.point_hands import (
    UNKNOWN,
    ParsedHands,
    ParsedPoints,
    check_some,
    hands_in_space,
    metres_of,
    odd_sides,
    own_sides,
    seen_hands,
    with_sides,
    without_hidden,
)
from handfit_core.interchange.readers import Reader
from handfit_core.interchange.recording import PointsHand, ReadOptions, Recording, known
from handfit_core.interchange.settings import LIMITS
from handfit_core.interchange.skeletons import UP_AXES
from handfit_core.interchange.table_points import HandTable, columns_of


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
    """The key of a frame's list of people; empty: hands stand in the frame itself"""
    parts: Mapping[int, Mapping[Side | None, int]] = field(default_factory=lambda: {NUM_KEYPOINTS: {None: 0}})
    """The first point of each hand, by how many points a list has"""
    hands: Callable[[Any], Any] = lambda frame: frame
    """From a frame to objects with `side` and `points`, where hands are told in another way"""
    read: Callable[[Document], ParsedPoints | None] = lambda _: None
    """The hands of what is neither a table nor frames of JSON"""
    persons: Literal["one", "told", "unknown"] = "unknown"
    """Whether a file is of one person, or tells them; else nobody can be chosen"""
    least: float = 0.0
    """Mean confidence below which a hand is left out"""
    from_below: bool = False
    """Whether parts of a picture count from its lower left corner"""
    halved: Callable[[JsonFrames], bool] = lambda _: False
    """Whether parts of a picture's size go from -1 to 1"""
    units: Mapping[str, float] | None = None
    """Metres of the units that points in space may have, the usual one first; None: points are in the plane,
    or in metres of the camera frame"""
    up: str = "y"
    """The axis of such space that is up"""
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
    unseen: bool = False
    """Whether no real file of it has ever been read here"""
    hint: str = ""
    """What to do where there are no hands"""

    @property
    def reader(self) -> Reader:
        """What reads it."""
        return Reader(self.title, self.files, self._recognises, self._read, self.unseen)

    def _recognises(self, document: Document) -> bool:
        if document.table is not None:
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
            told = self.read(document)
            if told is None and document.table is not None:
                told = HandTable(document.table, document.path).hands(
                    first=self.first, in_space=self.units is not None, ours=self.ours
                )
            return self._recording(told or self._of_json(document, asked), document, asked)
        except InputError:
            raise
        except ValueError as error:
            raise InputError(f"{path}: it is not as {self.title} writes it ({str(error)[:300]})") from error

    def _is_one(self, content: Any) -> bool:
        """Whether JSON is one frame: a hand, or a list of people."""
        if not self.people:
            return is_hand(content)
        return isinstance(content, list) and bool(content) and "keypointscores" in keyed(content[0])

    def _of_json(self, document: Document, asked: ReadOptions) -> ParsedPoints:
        frames = frames_of(document, self._is_one)
        columns = {len(each): each for each in self.columns.split()}
        told: list[tuple[Any, ...]] = []
        most, mirrored = 0, set()
        for row, content in enumerate(frames.contents):
            try:
                people = list(self._people(content))
                most = max(most, len(people))
                for number, human in enumerate(people, 1):
                    if self.persons != "told" or asked.person in (None, number):
                        for hand in hands_in(human, columns):
                            mirrored.add(hand.mirrored)
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
            in_space=self.units is not None,
            mirrored=True if mirrored == {True} else None,
            halved=self.halved(frames),
            assumed=frames.assumed,
        )

    def _people(self, content: Any) -> Sequence[Any]:
        """What of a frame is asked for hands. Raises ValueError."""
        if not self.people:
            return [self.hands(content)]
        people = content.get(self.people) if isinstance(content, Mapping) else content
        if not isinstance(people, list):
            raise ValueError(f"it has no list of {self.people}")
        return people

    def _parts(self, hand: JsonHand) -> Iterator[tuple[Any, ...]]:
        """Side, score, points (21, 4) and world (21, 3) of each hand that a list of points has."""
        if len(hand.points) not in self.parts or len(hand.world) != NUM_KEYPOINTS:
            raise ValueError(
                f"a hand of {len(hand.points)} points; expected {', '.join(map(str, self.parts))}"
            )
        for side, first in self.parts[len(hand.points)].items():
            named = side or hand.side
            code = UNKNOWN if named is None else SIDES.index(named)
            yield code, hand.score, hand.points[first : first + NUM_KEYPOINTS], hand.world

    def _recording(self, told: ParsedPoints, document: Document, asked: ReadOptions) -> Recording:
        """The recording: hands of known sides, in pixels or in parts of the picture, or before the camera."""
        hands, what = told.hands, f"{shown(document.path)}: {self.title}'s hands{self.hint}"
        made = Recording(
            self.name,
            (str(document.path.absolute()),),
            asked.fps or told.fps,
            told.numbers,
            size=told.size,
            intrinsics=told.intrinsics,
        )
        told_sides = self.ours or self.units is not None
        if told_sides and np.any(hands.side == UNKNOWN):
            raise ValueError("some of them have no side; expected left or right")
        said, in_space = told.assumed, told.in_space
        if not in_space and (not known(hands.points[..., :2]).any() or _is_world(hands)):
            world = hands.points if known(hands.points).any() else hands.world
            hands = replace(hands, points=world, confidence=known(world).astype(float))
            said, in_space = (
                (*said, "its points are metres without a place: the hands stay where they are"),
                True,
            )
        hands, hidden = without_hidden(hands, 0.0 if in_space else self.least)
        check_some(hands, what)
        said = (*said, *hidden)
        if not told_sides:
            whole = np.isfinite(hands.world).all(axis=(1, 2), keepdims=True)
            shapes = np.where(whole, hands.world, hands.points)
            hands, swapped = own_sides(hands, shapes, told.mirrored)
            hands, sides = with_sides(hands, asked.hands, shapes)
            said = (*said, *swapped, *sides)
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
            axes = unit * UP_AXES[self.up].T
            points = tuple(replace(hand, points=hand.points @ axes) for hand in points)
            # Devices that know joints know which hand they see.
            said = (*said, *guessed, *(() if self.on_joints else odd_sides(points)))
        return points, said


def _is_world(hands: ParsedHands) -> bool:
    """Whether what is told as points is in metres about each hand's middle."""
    points = hands.points[known(hands.points).all(axis=1)]
    if not len(points):
        return False
    middles, reach = np.abs(points.mean(axis=1)), np.abs(points).max(axis=(1, 2))
    return bool(np.median(middles[:, :2].max(axis=1)) < 0.05 and np.median(reach) < 0.2)


def is_hand_table(table: Table) -> bool:
    """Whether a table holds points of hands."""
    return columns_of(table) is not None or HandTable(table, Path()).is_long
