"""The one reader of points: a `PointLayout` says what differs between programs (formats/keypoints.py)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from handfit_core.errors import InputError, OptionError
from handfit_core.files import shown
from handfit_core.interchange.document import Document, Table
from handfit_core.interchange.json_points import (
    JsonFrames,
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
    Told,
    ToldHands,
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
from handfit_core.interchange.recording import Asked, Recording, known
from handfit_core.interchange.settings import LIMITS
from handfit_core.interchange.skeletons import UP_AXES
from handfit_core.interchange.table_points import HandTable, columns_of
from handfit_core.skeleton import NUM_KEYPOINTS, SIDES, Side


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
    recognises: Callable[[Document], bool] = lambda _: False
    """Whether a file or folder without such keys is of it"""
    columns: str = "xy xyz xyzc"
    """What a list of numbers is that stands for a point, for each length: c is the confidence"""
    people: str = ""
    """The key of a frame's list of people; empty: hands stand in the frame itself"""
    parts: Mapping[int, Mapping[Side | None, int]] = field(default_factory=lambda: {NUM_KEYPOINTS: {None: 0}})
    """The first point of each hand, by how many points a list has"""
    hands: Callable[[Any], Any] = lambda frame: frame
    """From a frame to objects with `side` and `points`, where hands are told in another way"""
    read: Callable[[Document], Told | JsonFrames | None] = lambda _: None
    """The hands, or frames with them, of what is neither a table nor frames of JSON"""
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
    up: str = ""
    """The axis of space that is up, if it is not the camera's frame"""
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
        marks = [set(mark.split()) for mark in self.marks]
        if marks and (document.is_folder or document.table is None):
            for content in some_contents(document):
                if any(mark <= set(each) for each in objects_in(content) for mark in marks):
                    return True
        return self.recognises(document)

    def _read(self, document: Document, asked: Asked) -> Recording:
        path = shown(document.path)
        if asked.person is not None and self.persons == "unknown":
            raise OptionError(f"{path}: {self.title}'s hands belong to no persons; leave --person out")
        try:
            told = self.read(document)
            if isinstance(told, Told):
                pass
            elif told is None and not document.is_folder and document.table is not None:
                told = HandTable(document.table, document.path).hands(
                    first=self.first, in_space=self.units is not None, ours=self.ours
                )
            else:
                told = self._of_json(told or frames_of(document, self._is_one), document, asked)
            return self._recording(told, document, asked)
        except InputError:
            raise
        except ValueError as error:
            raise InputError(f"{path}: it is not as {self.title} writes it ({str(error)[:300]})") from error

    def _is_one(self, content: Any) -> bool:
        """Whether JSON is one frame: a hand, or a list of people."""
        if not self.people:
            return is_hand(content)
        return isinstance(content, list) and bool(content) and "keypointscores" in keyed(content[0])

    def _of_json(self, frames: JsonFrames, document: Document, asked: Asked) -> Told:
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
        rows, hand, side, score, points, world = zip(*told, strict=True) if told else ((),) * 6
        points = np.array(points, dtype=np.float64).reshape(-1, NUM_KEYPOINTS, 4)
        return Told(
            frames.numbers,
            ToldHands.of(
                np.array(rows, dtype=int),
                np.array(side, dtype=int),
                np.array(hand, dtype=int),
                np.array(score, dtype=np.float64),
                points[..., :3],
                points[..., 3],
                np.array(world, dtype=np.float64).reshape(-1, NUM_KEYPOINTS, 3),
            ),
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

    def _parts(self, hand: Any) -> Iterator[tuple[Any, ...]]:
        """Side, score, points (21, 4) and world (21, 3) of each hand that a list of points has."""
        nothing = np.full((NUM_KEYPOINTS, 4), np.nan)
        points = nothing if hand.points is None else hand.points
        world = nothing[:, :3] if hand.world is None else hand.world
        if len(points) not in self.parts or len(world) != NUM_KEYPOINTS:
            expected = ", ".join(map(str, self.parts))
            raise ValueError(f"a hand of {len(points)} points; expected {expected}")
        if not np.isnan(points[:, 3]).all():
            points = np.concatenate([points[:, :3], np.nan_to_num(points[:, 3:])], axis=1)
        for side, first in self.parts[len(points)].items():
            name = side or hand.side
            code = UNKNOWN if name is None else SIDES.index(name)
            score = np.nan if hand.score is None else hand.score
            yield code, score, points[first : first + NUM_KEYPOINTS], world

    def _recording(self, told: Told, document: Document, asked: Asked) -> Recording:
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
        if (self.ours or self.units) and np.any(hands.side == UNKNOWN):
            raise ValueError("some of them have no side; expected left or right")
        if told.in_space:
            return self._in_space(told, made, what)
        if not known(hands.points[..., :2]).any() or _is_world(hands):
            world = hands.points if known(hands.points).any() else hands.world
            hands = replace(hands, points=world, confidence=known(world).astype(float))
            check_some(hands, what)
            hands, swapped = own_sides(hands, world, told.mirrored)
            hands, sides = with_sides(hands, asked.hands, world)
            points, several = hands_in_space(
                hands, len(told.numbers), counted=False, on_joints=self.on_joints, sigma=self.sigma
            )
            said = "its points are metres without a place, as of MediaPipe's world: hands stay where they are"
            return replace(made, points=points, assumed=(*told.assumed, said, *swapped, *sides, *several))
        hands, hidden = without_hidden(hands, self.least)
        check_some(hands, what)
        shapes = np.where(np.isfinite(hands.world).all(axis=(1, 2), keepdims=True), hands.world, hands.points)
        hands, swapped = own_sides(hands, shapes, told.mirrored)
        hands, sides = with_sides(hands, asked.hands, shapes)
        hands, relative, scale = self._scaled(hands, told, asked)
        made = replace(
            made,
            seen=seen_hands(hands),
            size=RELATIVE if relative else told.size,
            assumed=(*told.assumed, *scale, *hidden, *swapped, *sides),
        )
        return made if told.size is None else scaled(made, *told.size)

    def _scaled(self, hands: ToldHands, told: Told, asked: Asked) -> tuple[ToldHands, bool, tuple[str, ...]]:
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

    def _in_space(self, told: Told, made: Recording, what: str) -> Recording:
        check_some(told.hands, what)
        points, several = hands_in_space(
            told.hands, len(told.numbers), counted=self.ours, on_joints=self.on_joints, sigma=self.sigma
        )
        unit, said = 1.0, ()
        if self.units:
            unit, said = metres_of(points, self.units, next(iter(self.units)))
            # Devices that know joints know which hand they see.
            said = said if self.on_joints else (*said, *odd_sides(points))
        axes = UP_AXES[self.up].T if self.up else np.eye(3)
        points = tuple(replace(hand, points=hand.points * unit @ axes) for hand in points)
        return replace(made, points=points, assumed=(*told.assumed, *self.assumed, *several, *said))


def _is_world(hands: ToldHands) -> bool:
    """Whether what is told as points is in metres about each hand's middle."""
    points = hands.points[known(hands.points).all(axis=1)]
    if not len(points):
        return False
    middles, reach = np.abs(points.mean(axis=1)), np.abs(points).max(axis=(1, 2))
    return bool(np.median(middles[:, :2].max(axis=1)) < 0.05 and np.median(reach) < 0.2)


def tables(fits: Callable[[Table], bool]) -> Callable[[Document], bool]:
    """Whether a document is a table of hands, and fits."""

    def recognises(document: Document) -> bool:
        table = None if document.is_folder else document.table
        return table is not None and fits(table)

    return recognises


def is_hand_table(table: Table) -> bool:
    """Whether a table holds points of hands."""
    return columns_of(table) is not None or HandTable(table, Path()).is_long
