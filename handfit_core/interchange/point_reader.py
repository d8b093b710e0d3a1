"""The one reader of points: a `PointLayout` says what differs between programs (formats/keypoints.py)."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any, Final, Literal

import numpy as np

from handfit_core.common.errors import InputError, OptionError
from handfit_core.common.files import shown
from handfit_core.common.skeleton import SIDES, Side
from handfit_core.hand_model import load_model
from handfit_core.hand_model.data import HandModel
from handfit_core.hand_model.motion import HandMotion
from handfit_core.interchange.document import Document, Table
from handfit_core.interchange.frames import (
    Frames,
    frames_of_arrays,
    frames_of_json,
    objects_in,
    some_contents,
)
from handfit_core.interchange.json_hands import JsonHand, hands_in, keyed
from handfit_core.interchange.opening import RELATIVE, scaled
from handfit_core.interchange.orders import BODIES, HANDS, WHOLE_BODIES
from handfit_core.interchange.point_hands import (
    in_metres,
    is_world,
    metres_of,
    odd_sides,
    ordered,
    own_sides,
    tracks_of,
    with_sides,
    without_hidden,
)
from handfit_core.interchange.readers import Reader
from handfit_core.interchange.recording import (
    LEAST_POINTS,
    UNKNOWN,
    PointsHand,
    ReadOptions,
    Recording,
    SeenHands,
    known,
)
from handfit_core.interchange.settings import LIMITS
from handfit_core.interchange.skeletons import UP_AXES
from handfit_core.interchange.table_points import frames_of_table, is_hand_table

AXES: Final = UP_AXES | {
    "camera": np.eye(3),
    # Of Aria's glasses: down, to the left, away from who wears them
    "aria": np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
}
"""(3, 3) rotations to the camera's axes, by the axis that is up, or by the device"""


@dataclass(frozen=True)
class PointLayout:
    """How a program writes the 21 points of hands: an entry of a table."""

    name: str
    title: str
    files: str
    """A phrase for such a file, for messages and lists"""
    source: str
    """The address of the page on which the program describes its files"""
    marks: tuple[str, ...] = ()
    """Keys of an object, or columns of a table, by which a file is recognised: all that stand in one of
    these, as in "a b\""""
    names: Callable[[Iterable[str]], bool] | None = None
    """True for names of points, an object's keys or a table's columns, by which a file is recognised"""
    table: Callable[[Table], bool] = lambda _: False
    """True if a table is of this layout"""
    recognises: Callable[[Document], bool] = lambda _: False
    """True if any other file or folder is of this layout"""
    columns: str = "xy xyz xyzc"
    """The meaning of a list of numbers that stands for a point, for each length that it may have: c is the
    confidence"""
    people: str = ""
    """The keys under which a frame may have its list of people; empty where hands stand in the frame
    itself"""
    order: str = ""
    """The order of the points, a key of `ORDERS`; empty where the names of points or the bones tell it"""
    grouped: bool = False
    """True if each person or hand stands alone in a list, with the number of its frame"""
    hands: Callable[[Any], Any] = lambda frame: frame
    """Turns a frame, or with `people` each person, into objects with `side` and `points`, where a file tells
    hands in another way"""
    read: Callable[[Document], Frames | None] = lambda _: None
    """Returns the frames of a file that is neither JSON's frames nor a table or arrays"""
    persons: Literal["one", "told", "unknown"] = "unknown"
    """Whether a file is of one person, or tells which person a hand is of; with "unknown" no person can be
    chosen"""
    least: float = 0.0
    """Mean confidence, 0..1, below which a hand in a picture is left out"""
    from_below: bool = False
    """True if parts of a picture count from its lower left corner"""
    halved: bool = False
    """True if parts of a picture's size may go from -1 to 1"""
    units: Mapping[str, float] | None = None
    """Metres of each unit that points in space may have, the usual one first; None where points are in the
    plane, or in metres of the camera frame"""
    up: str = "y"
    """The axes of space in which points are, a key of `AXES`: which axis is up, or whose axes they are"""
    mirrored: bool = False
    """True if such space may be left-handed, with z away from who looks, as Unity's is"""
    on_joints: bool = False
    """True if points in space are a skeleton's joints, rather than points on the skin"""
    posed: Callable[[np.ndarray, HandModel, list[str]], HandMotion] | None = None
    """Turns joints (T, 21, 7), places in metres and quaternions, into the pose of that model; adds what was
    assumed to the list. None where hands are fitted to points"""
    sigma: float | None = 0.005
    """Metres that points in space are expected to be off; None where the change of the bones' lengths tells
    it"""
    first: int = 1
    """The number of the first of frames without numbers"""
    ours: bool = False
    """True if this project writes it: several hands of a side stay apart, and what is not told is an error"""
    assumed: tuple[str, ...] = ()
    """Phrases about what is assumed of every file"""
    met: str = ""
    """The real file that it was tried with: project and date; empty: it was written by the description"""
    assumes: str = ""
    """What is assumed of every file, for the table of docs/interchange.md"""
    hint: str = ""
    """What the user can do where a file has no hands"""

    @property
    def reader(self) -> Reader:
        """The reader of files in this layout."""
        return Reader(self.title, self.files, self._recognises, self._read, self.met, self.assumes)

    def _recognises(self, document: Document) -> bool:
        table = document.table if document.numbers is None else None
        marks = [set(mark.split()) for mark in self.marks]
        for names in _names_in(document) if marks or self.names else ():
            if any(mark <= set(names) for mark in marks):
                return True
            if self.names and self.names(islice(names, 200)):
                return True
        return self.recognises(document) if table is None else self.table(table)

    def _read(self, document: Document, asked: ReadOptions) -> Recording:
        path = shown(document.path)
        if asked.person is not None and self.persons == "unknown":
            raise OptionError(f"{path}: {self.title}'s hands belong to no persons; leave --person out")
        try:
            frames = (
                self.read(document)
                or frames_of_arrays(document, document.arrays, self.first)
                or frames_of_table(document, first=self.first, ours=self.ours)
                or frames_of_json(document, grouped=self.grouped)
            )
            frames, hands = self._with_hands(frames, document, asked)
            made = Recording(
                self.name,
                (str(document.path.absolute()),),
                asked.fps or frames.fps,
                frames.numbers,
                size=frames.size,
                intrinsics=frames.intrinsics,
                assumed=(document.cut, *frames.assumed) if document.cut else frames.assumed,
            )
            return self._recording(made, frames, hands, asked)
        except InputError:
            raise
        except ValueError as error:
            raise InputError(f"{path}: read as {self.title}, {str(error)[:300]}") from error

    def _with_hands(self, frames: Frames, document: Document, asked: ReadOptions) -> tuple[Frames, SeenHands]:
        """Return the frames with what their hands tell about them, and these hands as the file has them."""
        columns = {len(each): each for each in self.columns.split()}
        told: list[tuple[Any, ...]] = []
        most, mirrored, named, guessed = 0, set(), set(), False
        for row, content in enumerate(frames.contents):
            try:
                people = list(self._people(content))
                most = max(most, len(people))
                for number, human in enumerate(people, 1):
                    if self.persons != "told" or asked.person in (None, number):
                        for hand in hands_in(human, columns):
                            count = len(hand.points)
                            mirrored.add(hand.mirrored)
                            named.add(hand.named or count in set(WHOLE_BODIES) - {42})
                            guessed |= count == 42
                            hand = hand._replace(number=number) if len(people) > 1 else hand
                            told += ((row, *part) for part in self._parts(hand))
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
        hands = SeenHands.of(*(zip(*told, strict=True) if told else ((),) * 6))
        deep = hands.points[..., 2]
        # MediaPipe's depths count from the wrist, whose own is zero.
        zero = np.abs(deep) < 1e-9
        counted = (zero | np.isnan(deep)).all(axis=0) & zero.any(axis=0)
        in_space = self.units is not None and bool(np.isfinite(deep).any() and not counted.any())
        frames = replace(
            frames,
            in_space=frames.in_space or in_space,
            mirrored=mirrored == {True},
            halved=self.halved and _from_minus_one(told),
            order=self.order or frames.order or ("mediapipe" if named == {True} else ""),
            guessed=guessed,
        )
        return frames, hands

    def _people(self, content: Any) -> Sequence[Any]:
        """Return the people of a frame, or the frame itself, in which hands are looked for. Raises
        ValueError."""
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
        """Yield side, number, score, points (K, 8) and world (K, 3) of each hand that a list of points
        has."""
        count = len(hand.points)
        if count in BODIES:
            return
        if count not in HANDS and count not in WHOLE_BODIES:
            raise ValueError(
                f"{count} points, of which it is not known where hands are; expected 20 or 21 a hand"
            )
        whole: dict[Side | None, Sequence[int]] = {None: range(count)}
        for side, points in (whole if count in HANDS else WHOLE_BODIES[count]).items():
            named = side or hand.side
            code = UNKNOWN if named is None else SIDES.index(named)
            chosen = list(points)
            yield code, hand.number, hand.score, hand.points[chosen], hand.world[chosen]

    def _recording(self, made: Recording, frames: Frames, hands: SeenHands, asked: ReadOptions) -> Recording:
        """Return the recording with hands of known sides, in pixels or in parts of the picture, or before the
        camera."""
        said, in_space = [*made.assumed], frames.in_space
        if self.ours and np.any(hands.side == UNKNOWN):
            raise ValueError("some of them have no side; expected left or right")
        parts = bool(np.nanmax(np.abs(hands.keypoints), initial=0.0) <= LIMITS.relative)
        if not in_space and parts and self.units is None and in_metres(hands):
            in_space = True
            said.append("its points are metres before the camera: x right, y down, z away")
        hands = ordered(hands, replace(frames, in_space=in_space), asked.order, said, parts=parts)
        if not in_space and (not known(hands.points[..., :2]).any() or is_world(hands)):
            world = hands.points if known(hands.points).any() else hands.world
            hands = replace(hands, points=world, confidence=known(world).astype(float))
            in_space = True
            said.append("its points are metres without a place: the hands stay where they are")
        hands = without_hidden(hands, 0.0 if in_space else self.least, said)
        if not np.any(known(hands.keypoints).sum(axis=1) >= LEAST_POINTS):
            raise ValueError(f"none of its frames has a hand with at least {LEAST_POINTS} points{self.hint}")
        shapes = np.where(np.isfinite(hands.world).all(axis=(1, 2), keepdims=True), hands.world, hands.points)
        if frames.guessed or (not self.ours and self.units is None):
            hands = own_sides(hands, shapes, said, mirrored=frames.mirrored)
        hands = with_sides(hands, asked.hands, shapes, said)
        if not in_space:
            points, relative = self._scaled(hands, frames, asked, said)
            size = RELATIVE if relative else made.size
            made = replace(made, seen=replace(hands, points=points), size=size, assumed=tuple(said))
            return made if frames.size is None else scaled(made, *frames.size)
        said += self.assumed
        tracks = tracks_of(hands, len(made.frame_numbers), said, counted=self.ours)
        if self.posed is not None:
            posed = [self.posed(track, load_model(asked.model, side), said) for side, track in tracks]
            return replace(made, posed=tuple(posed), assumed=tuple(dict.fromkeys(said)))
        points = self._placed(
            [PointsHand(s, t, on_joints=self.on_joints, sigma=self.sigma) for s, t in tracks], said
        )
        return replace(made, points=tuple(points), assumed=tuple(said))

    def _scaled(
        self, hands: SeenHands, frames: Frames, asked: ReadOptions, said: list[str]
    ) -> tuple[np.ndarray, bool]:
        """Return points (N, 21, 3) counted from the upper left corner, and whether they are parts of the
        picture's size."""
        points, deep = hands.points.copy(), hands.points[..., 2]
        if np.nanmax(np.abs(hands.keypoints)) > LIMITS.relative:
            if np.isfinite(deep).any() and np.nanmax(np.abs(deep)) <= LIMITS.relative:
                # Pixels beside a depth in parts of the picture's width.
                size = frames.size or asked.picture_size
                points[..., 2] = deep * size[0] if size is not None else np.nan
            if self.from_below:
                said.append("its points are pixels, which are taken to count from the upper left corner")
            return points, False
        if frames.halved:
            points[..., :2] = (points[..., :2] + 1.0) / 2.0
        if self.from_below:
            points[..., 1] = 1.0 - points[..., 1]
        if self.people:
            where = "lie between -1 and 1" if frames.halved else "are parts of the picture's size"
            said.append(f"its points {where}")
        return points, True

    def _placed(self, hands: list[PointsHand], said: list[str]) -> list[PointsHand]:
        """Return the hands in metres before the camera."""
        if not self.units:
            return hands
        guessed: list[str] = []
        axes = metres_of(hands, self.units, guessed) * AXES[self.up].T
        hands = [replace(hand, points=hand.points @ axes) for hand in hands]
        if self.mirrored and odd_sides(hands):
            hands = [replace(hand, points=hand.points * [1.0, 1.0, -1.0]) for hand in hands]
            said.append("its space is left-handed, as Unity's: so its fingers bend as their sides'")
        # Devices that know joints know which hand they see.
        said += guessed if self.on_joints else [*guessed, *odd_sides(hands)]
        return hands


def _names_in(document: Document) -> Iterator[Collection[str]]:
    """Yield the keys of objects in JSON, or a table's columns, and the first rows' cells of a table of
    hands."""
    table = document.table
    if table is None:
        yield from (each for content in some_contents(document) for each in objects_in(content))
    else:
        yield table.columns
        yield from table.rows[:50] if is_hand_table(table) else ()


def _from_minus_one(told: Sequence[tuple[Any, ...]]) -> bool:
    """Return whether the points of hands lie between -1 and 1 (OpenPose's --keypoint_scale 4), where a
    missing point is at (-1, -1), with the others at (0, 0)."""
    points = np.concatenate([np.empty((0, 8)), *(hand[4] for hand in told)])
    missing = points[points[:, 3] == 0.0, :2]
    at_corner, at_zero = (np.all(missing == place, axis=1).any() for place in (-1.0, 0.0))
    trusted = points[points[:, 3] > 0.0, :2]
    return bool(at_corner or (not at_zero and np.nanmin(trusted, initial=0.0) < -0.1))
