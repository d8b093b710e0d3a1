"""Every option of a capture and of a live run, once: its name, kind, range, unit, default and help.

`pipeline.capture`, the command line, batches, the worker's protocol and Blender's properties read them from
here. An option is added as a field of `CaptureOptions` or `LiveOptions`; tests then ask for a value in their
table, and for its flag in docs/batch.md.
"""
# ruff: noqa: RUF009 (what a dataclass's default calls here makes a field)

from __future__ import annotations

import argparse
import dataclasses
import functools
import math
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from numbers import Real
from typing import Any, ClassVar, Final, Literal, Self, get_args

from handfit_core.common.errors import OptionError
from handfit_core.common.skeleton import SIDES, HandChoice, Side
from handfit_core.common.values import shortly
from handfit_core.detect.detector import DETECTORS, DetectorSettings, Quality, Region
from handfit_core.fit.solvers import MOST_SMOOTHING, USUAL_SMOOTHING, solver_names
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.lens import Lens
from handfit_core.interchange.recording import ReadOptions
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.lenses import NUMBERS, lens_numbers, lens_of_numbers, saved_lens
from handfit_core.media.size_limit import PICTURE, VIDEO
from handfit_core.media.source import DEFAULT_FPS
from handfit_core.take import TAKE_LIMITS

HandMean = Literal["auto", "flat", "mean"]

VIEW_OPTIONS: Final = ("view", "view_lens", "cameras", "offset", "baseline")
"""Names of the options that describe a second view"""

FARTHEST: Final = 1e6
"""Farthest that a region may lie from the picture's corner, in pixels, and its largest size"""

CLIP_HANDS: Final = 2
"""How many hands of a clip are kept where nobody says how many; further ones are not even searched"""

NEAREST_FOCAL: Final = 0.05
FARTHEST_FOCAL: Final = 1000.0
"""Largest focal length that is accepted, in times of the picture's longer side, as `NEAREST_FOCAL` is the
least: three minutes of arc, as a crop of a telescope's picture may have, and a view of 169 degrees"""

CROWD: Final = 10
"""Most hands that are built without asking, since each is a rig"""


def region_of(given: Any) -> Region:
    """Make a region of four or five numbers and perhaps a side, or of a text in which commas separate them.
    Raises ValueError for anything else."""
    what = "regions X,Y,WIDTH,HEIGHT in pixels, and perhaps FRAME and left or right, as in 120,80,60,70"
    try:
        parts = given.split(",") if isinstance(given, str) else list(given)
        side: Side | None = parts.pop() if parts and parts[-1] in SIDES else None  # type: ignore
        *box, frame = _numbers(parts if len(parts) == 5 else [*parts, -1], what, count=5)
    except TypeError:
        raise ValueError(what) from None
    if min(box[2:]) < 1.0 or max(map(abs, box)) > FARTHEST or not float(frame).is_integer():
        raise ValueError(what)
    return Region(*box, frame=None if len(parts) == 4 else int(frame), side=side)


@dataclass(frozen=True)
class Option:
    """The declaration of one option: its value's kind and range, and what is said of it."""

    kind: Callable[[Any], Any]
    """Function that makes the option's value of what somebody gave, or raises ValueError with what it must
    be"""
    help: str
    """A phrase that begins with a small letter and has no full stop"""
    metavar: str | None = None
    least: float = -math.inf
    most: float = math.inf
    choices: Callable[[], Iterable[str]] | None = None
    """Function that returns the values which help can list; it is called when help is wanted, since plug-ins
    are looked up for it"""
    closed: bool = False
    """True if only the `choices` may be given"""
    unit: str = ""
    """Name of the command line's unit, where it is not the library's; empty: it is"""
    units: float = 1.0
    """How many of the command line's units make one of the library's"""
    by_default: str = ""
    """Text that help shows for a default that explains nothing by itself"""
    repeated: bool = False
    """True if the option may be given several times on the command line, each time with one of its values"""
    spelled: str = ""
    """The option's flag, where it is not made of the option's name"""
    called: str = ""
    """The name by which messages call the option; empty: the option's own"""
    advice: str = ""
    """Text at the end of messages about a number that is out of range"""
    name: str = ""
    default: Any = None

    @property
    def flag(self) -> str:
        """The option's spelling on the command line."""
        return self.spelled or "--" + self.name.replace("_", "-").removesuffix("s" if self.repeated else "")

    @property
    def dest(self) -> str:
        """The option's name among parsed arguments."""
        return self.spelled.removeprefix("--") or self.name

    def read(self, given: Any) -> Any:
        """Return what was given, by a program, a message or the command line, as the option's value; None is
        as good as nothing and gives the default. Raises OptionError for what the option cannot be."""
        if given is None:
            return self.default
        try:
            value = self.kind(given)
        except ValueError as error:
            raise OptionError(f"the option '{self.name}' must be {error}; got {shortly(given)}") from None
        if self.closed and self.choices is not None and value not in self.choices():
            raise OptionError(f"{self.name} must be one of {', '.join(self.choices())}; got {shortly(given)}")
        if isinstance(value, int | float) and not self.least <= value <= self.most:
            raise OptionError(
                f"{self.called or self.name} must {self._range()}, not {value * self.units:g}"
                f"{self._unit}{self.advice}"
            )
        return value

    @property
    def _unit(self) -> str:
        return f" {self.unit}" if self.unit else ""

    def _range(self) -> str:
        least, most = self.least * self.units, self.most * self.units
        if math.isinf(most):
            return f"be a number of at least {least:g}"
        return f"lie between {least:g} and {most:g}{self._unit}"

    def add_to(self, parser: argparse._ActionsContainer) -> None:
        """Add the option to a command line; where it is not given, the parsed argument is None."""
        if self.kind is as_flag:
            parser.add_argument(self.flag, action="store_true", default=None, help=self.help)
            return
        text, named = self.help, {}
        if self.choices is not None:
            text, named = f"{text}: %(listed)s", {"action": _Listing, "listed": self.choices}
        if self.repeated:
            named |= {"action": "append", "dest": self.dest}
        default = self.by_default or f"{self.default * self.units if self.unit else self.default}"
        number = {as_number: float, as_positive: float, as_whole: int}
        parser.add_argument(
            self.flag,
            metavar=self.metavar,
            type=number.get(self.kind, str),
            help=f"{text}{f', in {self.unit}' if self.unit else ''} (default: {default})",
            **named,
        )


class _Listing(argparse._StoreAction):
    """Has %(listed)s in its help: choices that are looked up when the help is shown, and not before."""

    def __init__(self, *arguments: Any, listed: Callable[[], Iterable[str]], **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._choices, self.listed = listed, self

    def __str__(self) -> str:
        return ", ".join(self._choices())


def as_text(given: Any) -> str:
    """Return a text that is not empty, or raise ValueError."""
    if not isinstance(given, str) or not given:
        raise ValueError("a text")
    return given


def _path(given: Any) -> str:
    return as_text(os.fspath(given) if isinstance(given, os.PathLike) else given)


def as_number(given: Any) -> float:
    """Return a number, NaN included, or raise ValueError."""
    if not isinstance(given, Real) or isinstance(given, bool):
        raise ValueError("a number")
    try:
        return float(given)
    except OverflowError:  # JSON's whole numbers have no limit
        raise ValueError("a finite number") from None


def as_positive(given: Any) -> float:
    """Return a finite number above 0, or raise ValueError."""
    number = as_number(given)
    if not 0.0 < number < math.inf:
        raise ValueError("a number above 0")
    return number


def as_whole(given: Any) -> int:
    """Return a whole number, or raise ValueError."""
    number = as_number(given)
    if not number.is_integer():  # nor are NaN and infinity
        raise ValueError("a whole number")
    return int(number)


def as_flag(given: Any) -> bool:
    """Return True or False as given, or raise ValueError."""
    if not isinstance(given, bool):
        raise ValueError("true or false")
    return given


def _frames(given: Any) -> FrameRange:
    return given if isinstance(given, FrameRange) else FrameRange.parse(as_text(given))


def _numbers(given: Any, what: str, count: int) -> tuple[float, ...]:
    """Return numbers out of a list, or out of a text in which commas separate them."""
    try:
        parts = given.split(",") if isinstance(given, str) else list(given)
        numbers = tuple(as_number(float(part) if isinstance(part, str) else part) for part in parts)
    except (TypeError, ValueError):
        numbers = ()
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise ValueError(what)
    return numbers


def _camera(given: Any) -> Intrinsics:
    if isinstance(given, Intrinsics):
        return given
    return Intrinsics(
        *_numbers(given, "four numbers, FX,FY,CX,CY in pixels, as in 1200,1200,960,540", count=4)
    )


def _lens(given: Any) -> Lens | tuple[float, ...]:
    if isinstance(given, Lens):
        return given
    if isinstance(given, Mapping):
        return lens_of_numbers(given)
    if isinstance(given, str) and not NUMBERS.fullmatch(given):
        return saved_lens(given).lens
    what = (
        "three numbers, F,X,Y: the focal length in picture widths, the principal point in widths and "
        "heights; or the name of a measured lens"
    )
    return _numbers(given, what, count=3)


def _size(given: Any) -> tuple[int, int]:
    what = "a width and a height in pixels, as in 1920x1080"
    parts = given.lower().split("x") if isinstance(given, str) else given
    width, height = _numbers(parts, what, count=2)
    if not all(side.is_integer() and 0 < side < 1 << 24 for side in (width, height)):
        raise ValueError(what)
    return int(width), int(height)


def _regions(given: Any) -> tuple[Region, ...]:
    if not isinstance(given, Iterable) or isinstance(given, str):
        raise ValueError("a list of regions")
    return tuple(each if isinstance(each, Region) else region_of(each) for each in given)


def _orders() -> Iterable[str]:
    from handfit_core.interchange.orders import ORDERS  # which Blender does not need to start

    return ORDERS


def _readers() -> Iterable[str]:
    from handfit_core.interchange.readers import READERS  # which Blender does not need to start

    return READERS.names()


def option(default: Any, kind: Callable[[Any], Any], help: str, metavar: str | None = None, **more: Any):
    """Declare a field of `Options`, with what belongs to the option."""
    return dataclasses.field(
        default=default, metadata={"option": Option(kind, help, metavar, default=default, **more)}
    )


@functools.cache
def options_of(cls: type[Options]) -> dict[str, Option]:
    """Return the options that a class declares, by their names."""
    declared = {each.name: each.metadata["option"] for each in fields(cls) if each.metadata}  # type: ignore
    return {name: dataclasses.replace(option, name=name) for name, option in declared.items()}


@dataclass(frozen=True)
class Options:
    """A set of options, an `option` a field. Whatever is given is checked and brought into the form of its
    field, and None is as good as nothing. Raises OptionError for a value that its option cannot be."""

    whose: ClassVar[str]
    """Names in messages what the options are of"""

    def __post_init__(self) -> None:
        for name, option in options_of(type(self)).items():
            object.__setattr__(self, name, option.read(getattr(self, name)))

    @classmethod
    def of_message(cls, options: object, **others: Any) -> Self:
        """Read the options of a request to the worker, and `others` that are no options. Raises OptionError
        also for an option that does not exist."""
        if not isinstance(options, Mapping):
            raise OptionError(f"the options of {cls.whose} must be an object, not {shortly(options)}")
        declared = options_of(cls)
        for name in options:
            if name not in declared:
                raise OptionError(
                    f"there is no option {shortly(name)} of {cls.whose}; choose from {', '.join(declared)}"
                )
        return cls(**options, **others)

    def to_message(self) -> dict[str, Any]:
        """Return the options for a request to the worker: those that are not the defaults."""
        given = {name: (getattr(self, name), each.default) for name, each in options_of(type(self)).items()}
        return {name: _plain(value) for name, (value, default) in given.items() if value != default}

    @classmethod
    def of_arguments(cls, arguments: argparse.Namespace, **others: Any) -> Self:
        """Read the options that a command line was told, and `others` that are no options; options that the
        command line does not have count as not given."""
        given = others
        for name, option in options_of(cls).items():
            value = getattr(arguments, option.dest, None)
            given[name] = value / option.units if option.unit and value is not None else value
        return cls(**given)


@dataclass(frozen=True)
class CaptureOptions(Options):
    """What a capture can be told. Raises OptionError."""

    whose = "a capture"
    frames: FrameRange | None = option(
        None, _frames, "source frames, as in 10-200:2", "A-B:S", by_default="all"
    )
    hands: HandChoice = option(
        "auto",
        as_text,
        "which hands to keep",
        "CHOICE",
        choices=lambda: ("auto", "left", "right", "both"),
        closed=True,
    )
    max_hands: int | None = option(
        None,
        as_whole,
        "how many hands to keep at most, the surest first",
        "N",
        least=1,
        most=TAKE_LIMITS.max_hands,
        by_default=f"all of a photo, {CLIP_HANDS} of a clip",
    )
    regions: tuple[Region, ...] = option(
        (),
        _regions,
        "a box in which there is a hand that was not found, in pixels, the frame that shows it there, and "
        "which hand it is",
        "X,Y,W,H[,FRAME][,SIDE]",
        repeated=True,
        by_default="none; the first frame; as it looks",
    )
    only_regions: bool = option(False, as_flag, "keep the hands of the regions, and no others")
    detector: str = option("direct", as_text, "what finds the hands", "NAME", choices=DETECTORS.names)
    threshold: float = option(
        0.5,
        as_number,
        "detection threshold, 0 to 1: lower finds more hands, and more that are none",
        "T",
        least=0.0,
        most=1.0,
        called="the detection threshold",
    )
    plain_detection: bool = option(
        False, as_flag, "look once at the whole picture: faster for photos, misses more hands"
    )
    quality: Quality = option(
        "standard",
        as_text,
        "how closely hands are looked at: draft takes 0.4 of the standard's time, and is rougher; best takes "
        "4 times as long for clips, and is a little more exact",
        "CHOICE",
        choices=lambda: get_args(Quality),
        closed=True,
    )
    landmark_model: str | None = option(
        None, _path, "MediaPipe's hand_landmarker.task", "PATH", by_default="the one that was fetched"
    )
    processes: int | None = option(
        None,
        as_whole,
        "how many threads find the hands of a clip; its result is the same",
        "N",
        least=1,
        most=64,
        by_default="one a core, at most 8",
    )
    solver: str = option("fast", as_text, "what fits the hand model", "NAME", choices=solver_names)
    arms: bool = option(
        False,
        as_flag,
        "find the arms of the hands, too, where shoulder and elbow are in the picture: takes a third longer",
    )
    model: str | None = option(
        None, _path, "a MANO file, or a folder with both sides", "PATH", by_default="the open hand"
    )
    smoothing: float = option(
        USUAL_SMOOTHING,
        as_number,
        "how smooth motion is, for solvers that smooth: 0 takes every frame by itself, at most 10",
        "S",
        least=0.0,
        most=MOST_SMOOTHING,
    )
    hand_length: float | None = option(
        None,
        as_number,
        "length of the hand from the wrist to the tip of the middle finger",
        "MM",
        least=0.05,
        most=0.30,
        unit="mm",
        units=1000.0,
        by_default="an average adult's",
        called="a hand's length",
        advice="; measure from the wrist to the tip of the middle finger",
    )
    intrinsics: Intrinsics | None = option(
        None,
        _camera,
        "the camera in pixels",
        "FX,FY,CX,CY",
        by_default="what the file tells, or one with a 53 degree view",
    )
    lens: Lens | tuple[float, float, float] | None = option(
        None,
        _lens,
        "the name of a lens that was measured with the command lens; or the camera where the picture's size "
        "is not known: focal length in picture widths, principal point in widths and heights",
        "NAME|F,X,Y",
        by_default="as --intrinsics",
    )
    view: str | None = option(
        None,
        _path,
        "a second clip of the same hands, filmed at the same time from another place by a camera that stood "
        "still",
        "PATH",
        by_default="none",
    )
    view_lens: Lens | tuple[float, float, float] | None = option(
        None, _lens, "the second clip's lens, as --lens", "NAME|F,X,Y", by_default="what the file tells"
    )
    cameras: str | None = option(
        None,
        _path,
        "where both cameras stood, and their lenses: a calibration in aniposelib's TOML layout",
        "RIG.toml",
        by_default="found from the hands",
    )
    offset: float | None = option(
        None,
        as_number,
        "seconds from the start of the first view to that of the second one, below 0 where that came first",
        "SECONDS",
        least=-86400.0,
        most=86400.0,
        by_default="found from the fingers",
    )
    baseline: float | None = option(
        None,
        as_number,
        "distance between both cameras in metres, which tells the hand's size",
        "M",
        least=0.05,
        most=20.0,
        by_default="told by the hand's size",
    )
    max_megapixels: float | None = option(
        None,
        as_positive,
        "largest picture or frame that is read, in megapixels",
        "M",
        by_default=f"{PICTURE}; for videos {VIDEO}",
    )

    keypoints: str | None = option(
        None,
        _path,
        "a file or folder with the hands or keypoints that another program has found in the input",
        "PATH",
        by_default="hands are looked for",
    )
    reader: str | None = option(
        None,
        as_text,
        "the format of hands or keypoints of another program",
        "NAME",
        choices=_readers,
        by_default="recognised",
    )
    order: str | None = option(
        None,
        as_text,
        "the order of a hand's points in another program's file",
        "NAME",
        choices=_orders,
        closed=True,
        by_default="the program's, else as the hand's bones tell",
    )
    person: int | None = option(
        None,
        as_whole,
        "which person's hands to read from another program's file, counted from 1 as they are in it",
        "N",
        least=1,
        by_default="all",
    )
    fps: float | None = option(
        None,
        as_positive,
        "frames per second of another program's file",
        "RATE",
        by_default=f"what it tells, else {DEFAULT_FPS:g}",
    )
    picture_size: tuple[int, int] | None = option(
        None,
        _size,
        "the pictures' size, where another program's file does not tell it",
        "WIDTHxHEIGHT",
        by_default="what it tells",
    )
    hand_mean: HandMean = option(
        "auto",
        as_text,
        "what MANO poses of another program's file count from: the flat hand, or the mean pose of the model",
        "CHOICE",
        choices=lambda: ("auto", "flat", "mean"),
        closed=True,
    )
    refit: bool = option(
        False, as_flag, "fit and smooth poses of another program anew, instead of taking them as they are"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.lens is not None and self.intrinsics is not None:
            raise OptionError("give the camera either as intrinsics or as a lens, not both")
        told = [name for name in VIEW_OPTIONS if name != "view" and getattr(self, name) is not None]
        if told and self.view is None:
            raise OptionError(f"{told[0]} tells of a second view, and there is none: give it with --view")
        if self.cameras is not None and self.baseline is not None:
            raise OptionError("a calibration tells the distance between the cameras: leave the baseline out")
        if self.keypoints is not None and self.regions:
            raise OptionError(
                "give either regions, in which a hand is looked for, or keypoints that another program has "
                "found, not both"
            )

    def measured_lens(self, width: int, height: int) -> Lens | None:
        """Return the measured lens in pictures of that size in pixels; None where none is chosen. Raises
        OptionError for pictures of another shape."""
        return self.lens.scaled(width, height) if isinstance(self.lens, Lens) else None

    def camera(self, width: int, height: int) -> Intrinsics | None:
        """Return the camera that was given, for pictures of that size in pixels; None where none was. Raises
        OptionError for a camera that cannot have taken such pictures."""
        camera = self.intrinsics
        if isinstance(self.lens, tuple):
            focal, x, y = self.lens
            camera = Intrinsics(focal * width, focal * width, x * width, y * height)
        elif (lens := self.measured_lens(width, height)) is not None:
            camera = lens.intrinsics
        low, high = (times * max(width, height) for times in (NEAREST_FOCAL, FARTHEST_FOCAL))
        if camera is not None and not all(low <= focal <= high for focal in (camera.fx, camera.fy)):
            raise OptionError(
                f"the camera's focal length must lie between {low:g} and {high:g} pixels for a picture of "
                f"{width}x{height}; got fx={camera.fx:g}, fy={camera.fy:g}"
            )
        return camera

    def most_hands(self, *, clip: bool) -> int | None:
        """Return how many hands of one picture are wanted, be it of a clip or a photo; None: all."""
        return CLIP_HANDS if clip and self.max_hands is None else self.max_hands

    def detector_settings(self, *, video: bool = False) -> DetectorSettings:
        """Return the settings for a detector; `video`: for the frames of one clip."""
        return DetectorSettings(
            self.most_hands(clip=video),
            video,
            self.threshold,
            self.landmark_model,
            self.quality,
            plain=self.plain_detection,
        )

    def read_options(self) -> ReadOptions:
        """Return the options for a reader of another program's files."""
        return ReadOptions(**{field.name: getattr(self, field.name) for field in fields(ReadOptions)})


def _plain(value: Any) -> Any:
    """Return an option's value as JSON can hold it."""
    if isinstance(value, FrameRange):
        return str(value)
    if isinstance(value, Intrinsics):
        return list(vars(value).values())
    if isinstance(value, Lens):
        return lens_numbers(value)
    if isinstance(value, Region):
        return [part for part in vars(value).values() if part is not None]
    return [_plain(each) for each in value] if isinstance(value, tuple) else value


@dataclass(frozen=True)
class LiveOptions(Options):
    """What a live run can be told. Raises OptionError."""

    whose = "a live run"
    capture: CaptureOptions = dataclasses.field(default_factory=CaptureOptions)
    """`hands`, `hand_length`, `model`, `intrinsics`, `lens`, `threshold` and `landmark_model` count"""
    online: bool = option(False, as_flag, "addresses of other machines may be opened")
    size: tuple[int, int] = option(
        (640, 480), _size, "the pictures that a camera is asked for", "WIDTHxHEIGHT", by_default="640x480"
    )
    fps: float = option(
        30.0,
        as_number,
        "frames per second that a camera is asked for",
        "FPS",
        least=1.0,
        most=1000.0,
        spelled="--rate",
        by_default="30",
    )
    loop: bool = option(False, as_flag, "begin a file again at its end")
    min_cutoff: float = option(
        2.0,
        as_number,
        "smoothing of still hands: lower is smoother, and lags",
        "HZ",
        least=0.01,
        most=1000.0,
        by_default="2",
    )
    """Cut-off frequency, in Hz, of the filter of a hand that is still"""
    beta: float = option(
        1.0, as_number, "how fast smoothing gives way to motion", "B", least=0.0, most=1000.0, by_default="1"
    )
    """Hz by which the cut-off frequency grows for each radian a second that something turns or travels in the
    view"""


OPTIONS: Final = options_of(CaptureOptions)
"""Every option of a capture, by its name"""
LIVE_OPTIONS: Final = options_of(LiveOptions)


def add_options(
    parser: argparse._ActionsContainer,
    names: Iterable[str] | None = None,
    of: type[Options] = CaptureOptions,
) -> None:
    """Add options to a command line, all of them or those of these names; `of_arguments` reads what it was
    told."""
    declared = options_of(of)
    for name in declared if names is None else names:
        declared[name].add_to(parser)


def add_progress(parser: argparse.ArgumentParser) -> None:
    """Add `--progress` to a command line."""
    said = "how to show progress (default: bar)"
    parser.add_argument("--progress", choices=("bar", "json", "none"), default="bar", help=said)
