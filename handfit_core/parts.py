"""Parts of a clip that were detected for themselves, on whichever machines, and are solved together.

A chunk's hands depend on its frames alone, so that the chunks of all parts are what one capture would
have found in the whole clip. docs/batch.md tells how parts are made.
"""

from __future__ import annotations

import hashlib
import json
import os
from bisect import bisect_left, bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, islice
from pathlib import Path
from typing import Any, Final

import numpy as np

from handfit_core.arrays import LARGEST
from handfit_core.detect.chunks import Chunk
from handfit_core.detect.clips import TrackedHand
from handfit_core.detect.detector import DETECTORS
from handfit_core.detect.keypoints import HandDetection, check_crowd
from handfit_core.detect.opening import settings_of
from handfit_core.detect.shot_boundary import Thumbnail
from handfit_core.detection import ChunkSource, at_least_two
from handfit_core.doors.npz import NotNpz, NpzArchive
from handfit_core.doors.values import path as checked_path
from handfit_core.doors.values import text, whole
from handfit_core.errors import HandfitError, InputError, OptionError
from handfit_core.files import read_file, samples, shown, why, written_whole
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.settings import MEDIA
from handfit_core.media.source import Media
from handfit_core.options import OPTIONS, CaptureOptions
from handfit_core.skeleton import NUM_KEYPOINTS, SIDES
from handfit_core.take import TAKE_LIMITS
from handfit_core.version import __version__

FORMAT_NAME: Final = "handfit-part"
FORMAT_VERSION: Final = 1

_MOST_MEMORY: Final = 1 << 28
"""bytes that the arrays of a small part may have"""
_MOST_PACKED: Final = 20
"""times the size of a larger file that its arrays may have: where no hand is, they pack well"""

OF_A_MACHINE: Final = ("processes", "landmark_model")
"""Options that may differ between parts: `made_by` knows what the landmark model holds"""
FREE: Final = (
    *OF_A_MACHINE,
    *("hands", "only_regions", "solver", "model", "smoothing", "hand_length", "intrinsics", "lens"),
)
"""Options that have no influence on what is found in a chunk, so that a clip can be solved with others"""

_KINDS: Final = {
    **dict.fromkeys(("counts", "sides", "given", "sizes", "numbers", "seen", "cuts"), "i"),
    **dict.fromkeys(
        ("score", "right_side", "certainty", "shown", "keypoints", "world", "keypoints_2020", "spread"), "f"
    ),
    **{"velocity": "f", "looked": "b", "glances": "u"},
}
"""The arrays of `chunks_to_arrays`, and NumPy's kinds of them"""


def chunks_in(media: Media, part: FrameRange | None) -> slice:
    """Which chunks of a clip belong to a part: those whose first frame lies in that range of frame numbers
    (None: all), and, where it reaches the clip's end as far as the header tells, all that may come after.
    Raises OptionError for a range with a step."""
    if part is None:
        return slice(0, None)
    if part.step != 1:
        raise OptionError(
            f"a part takes every frame of the clip that lies in it, so {part} must have no step; give the "
            "clip's with --clip-frames"
        )
    firsts = media.numbers()[:: MEDIA.chunk_frames]
    begin = 0 if part.first is None else bisect_left(firsts, part.first)
    if part.last is None or (media.expected_frames and part.last >= media.first_and_last[1]):
        return slice(begin, None)
    return slice(begin, max(bisect_right(firsts, part.last), begin))


@dataclass(frozen=True, eq=False)
class Part:
    """Consecutive chunks of a clip."""

    input: list[str]
    """What was opened: absolute, one path or pattern, or the pictures of one sequence"""
    fingerprint: str
    """of the input, see `fingerprint`"""
    made_by: str
    """The versions that decide what is found, see `made_by`"""
    options: CaptureOptions
    """of the capture of the whole clip"""
    first: int
    """How many chunks of the clip lie before it"""
    chunks: list[Chunk]
    ended: bool
    """Whether the clip is known to have no chunks after these"""

    @classmethod
    def found(cls, media: Media, options: CaptureOptions, part: slice, chunks: list[Chunk]) -> Part:
        """The part of an opened clip that has those chunks, detected with these options."""
        given = media.given if isinstance(media.given, list) else [str(media.given)]
        short = bool(chunks) and len(chunks[-1].numbers) < MEDIA.chunk_frames
        return cls(
            [str(Path(name).expanduser().absolute()) for name in given],
            fingerprint(media),
            made_by(options),
            options,
            part.start,
            chunks,
            ended=short or part.stop is None or len(chunks) < part.stop - part.start,
        )

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write it as `.npz`, whole or not at all. Raises OutputError."""
        header = {
            "format": FORMAT_NAME,
            "version": FORMAT_VERSION,
            "input": self.input,
            "fingerprint": self.fingerprint,
            "made_by": self.made_by,
            "options": self.options.to_message(),
            "first": self.first,
            "ended": self.ended,
        }
        arrays: dict[str, Any] = chunks_to_arrays(self.chunks)
        arrays["header"] = np.array(json.dumps(header, ensure_ascii=False))
        with written_whole(path, Part.load) as beside, beside.open("wb") as stream:
            np.savez_compressed(stream, **arrays)
        return Path(path)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Part:
        """Read a part. Raises InputError for anything that is none that this version understands."""
        try:
            data = read_file(path, TAKE_LIMITS.max_file_bytes)
        except (OSError, ValueError) as error:
            raise InputError(f"{shown(path)}: the part cannot be read ({why(error)})") from error
        try:
            archive = NpzArchive(data, max(_MOST_MEMORY, _MOST_PACKED * len(data)))
            del data
            header = archive.header()
            if header.get("format") != FORMAT_NAME:
                raise NotNpz("is of another format")
            if whole("version", header.get("version"), 1) > FORMAT_VERSION:
                raise InputError(
                    f"{shown(path)}: a newer version wrote this part; solve it with that version"
                )
            options = CaptureOptions.of_message(header["options"])
            arrays = {name: archive.array(name, kind) for name, kind in _KINDS.items()}
            for name, array in arrays.items():
                if array.dtype.kind == "f" and np.any(np.abs(array) > LARGEST):
                    raise ValueError(f"{name} holds numbers beyond {LARGEST:g}")
            return cls(
                [checked_path("input", name) for name in header["input"]],
                text("fingerprint", header.get("fingerprint"), 64),
                text("made_by", header.get("made_by"), 1000),
                options,
                whole("first", header.get("first"), 0),
                chunks_from_arrays(arrays, options.threshold),
                header.get("ended") is True,
            )
        except InputError:
            raise
        except (NotNpz, HandfitError, KeyError, IndexError, TypeError, ValueError) as error:
            raise InputError(
                f"{shown(path)}: not a part of a clip, or a damaged one; detect it again, or give the .npz "
                "that detect wrote"
            ) from error


def fingerprint(media: Media) -> str:
    """Tells an input from others wherever it lies: the size and number of its pictures, its files' sizes, the
    names of a sequence's, and what some places in them hold. Raises InputError."""
    files = [Path(file) for file in media.source.files]
    names = [file.name for file in files] if media.source.kind == "sequence" else []
    try:
        sizes = [file.stat().st_size for file in files]
        known = [media.source.kind, media.width, media.height, media.expected_frames, sizes, names]
        digest = hashlib.sha256(json.dumps(known).encode())
        for sample in samples(files, sizes):
            digest.update(sample)
    except (OSError, IndexError) as error:
        raise InputError(
            f"{media.source.name}: the input changes while it is read; wait until it is there"
        ) from error
    return digest.hexdigest()


def made_by(options: CaptureOptions) -> str:
    """The versions of what decides which hands are found. Raises LandmarkModelError."""
    import cv2

    detector = DETECTORS.get(options.detector).fingerprint(settings_of(options, video=True))
    return f"handfit-core {__version__}|opencv {cv2.__version__}|{detector}"


class Parts:
    """The parts of one clip, in any order; a chunk that is in several counts once."""

    def __init__(self, paths: Sequence[str | os.PathLike[str]]) -> None:
        """Read them. Raises InputError for parts that do not belong together."""
        self._where: dict[int, str] = {}
        self._chunks: dict[int, Chunk] = {}
        self._end: int | None = None
        """Chunks of the clip at most, as far as its parts tell"""
        first: Part | None = None
        for path in paths:
            part, name = Part.load(path), shown(path)
            first = first or part
            self._check_alike(shown(paths[0]), first, name, part)
            for index, chunk in enumerate(part.chunks, part.first):
                self._add(index, chunk, name)
            if part.ended:
                end = part.first + len(part.chunks)
                self._end = end if self._end is None else min(end, self._end)
        if first is None:
            raise InputError("no part was given; name the .npz files that detect wrote")
        self.files = tuple(paths)
        self._fingerprint, self._made_by, self._path = first.fingerprint, first.made_by, shown(paths[0])
        self.input: list[str] = first.input
        """as the first part has it"""
        self.options: CaptureOptions = first.options
        """of all parts, but for those `OF_A_MACHINE`, which are the first part's"""

    @staticmethod
    def _check_alike(known: str, first: Part, name: str, part: Part) -> None:
        if part.fingerprint != first.fingerprint:
            raise InputError(f"{name} is of another input than {known}; give the parts of one clip")
        if part.made_by != first.made_by:
            raise InputError(
                f"{name} was detected by {part.made_by}, and {known} by {first.made_by}; detect one of "
                "them again"
            )
        if others := _differing(part.options, first.options, OF_A_MACHINE):
            raise InputError(
                f"{name} was detected with other options than {known} ({others}); detect one of them again "
                "with the other's"
            )

    def _add(self, index: int, chunk: Chunk, name: str) -> None:
        if index in self._chunks:
            one, other = (chunks_to_arrays([each]) for each in (self._chunks[index], chunk))
            if any(one[key].tobytes() != other[key].tobytes() for key in one):
                raise InputError(
                    f"frames {chunk.numbers[0]} to {chunk.numbers[-1]} are in {self._where[index]} and, "
                    f"with other hands, in {name}; leave one of the two out"
                )
        self._chunks[index], self._where[index] = chunk, name

    def of(self, media: Media, options: CaptureOptions) -> ChunkSource:
        """What gives the whole clip's chunks to `detection.detect_frames`, once. Raises InputError unless
        all are there, are this input's, and were found with these options and this version."""
        if fingerprint(media) != self._fingerprint:
            raise InputError(
                f"{self._path} is of another input than {media.source.files[0]}, or that has changed since; "
                "detect its parts again, or name the right one"
            )
        if others := _differing(at_least_two(options), at_least_two(self.options), FREE):
            raise InputError(
                f"{self._path} was detected with other options ({others}); detect the clip's parts again, or "
                "take theirs"
            )
        if (here := made_by(options)) != self._made_by:
            raise InputError(
                f"{self._path} was detected by {self._made_by}, and this is {here}; solve it with that "
                "version, or detect the clip's parts again"
            )
        count = self._checked_count(media)
        thumbnail = Thumbnail.of(np.broadcast_to(np.uint8(0), (media.height, media.width, 3))).pixels.shape
        for index in range(count):
            chunk = self._chunks[index]
            fits = chunk.numbers == list(media.numbers(index * MEDIA.chunk_frames, len(chunk.numbers)))
            shapes = [each.pixels.shape for each in (chunk.first, chunk.last) if each is not None]
            if not fits or any(shape != thumbnail for shape in shapes):
                raise InputError(f"{self._where[index]}: the part is damaged; detect it again")

        def chunk_source(_: Any, __: CaptureOptions, on_frame: Any, ___: Any) -> list[Chunk]:
            chunks = [self._chunks.pop(index) for index in range(count)]
            on_frame(sum(len(chunk.numbers) for chunk in chunks))
            return chunks

        return chunk_source

    def _checked_count(self, media: Media) -> int:
        """How many chunks the clip has. Raises InputError where some are missing."""
        count = max(self._chunks, default=-1) + 1
        end = count if self._end is None else max(self._end, count)
        missing = [index for index in range(end) if index not in self._chunks]
        if missing:
            # A run of neighbours is as far from its place in the list everywhere.
            runs = [
                [i for _, i in run] for _, run in groupby(enumerate(missing), lambda pair: pair[1] - pair[0])
            ]
            ranges = [FrameRange(_number(media, run[0]), _number(media, run[-1] + 1) - 1) for run in runs[:3]]
            raise InputError(
                f"no part has the frames {', '.join(map(str, ranges))}"
                f"{' and others' if len(runs) > 3 else ''}; detect them, too, with --frames"
            )
        if self._end is None:
            raise InputError(
                f"the parts end before the clip does; detect what is left, too, with --frames "
                f"{_number(media, count)}-"
            )
        if any(len(self._chunks[index].numbers) != MEDIA.chunk_frames for index in range(count - 1)):
            raise InputError(
                "the clip has grown between the detection of its parts; detect all of them again"
            )
        return count


def _differing(a: CaptureOptions, b: CaptureOptions, but: Sequence[str]) -> str:
    """The names of the options that differ, but for some."""
    return ", ".join(name for name in OPTIONS if name not in but and getattr(a, name) != getattr(b, name))


def _number(media: Media, chunk: int) -> int:
    """The number of the first frame of a chunk, or of what would come after the last one."""
    numbers = media.numbers(chunk * MEDIA.chunk_frames, 1)
    return numbers[0] if numbers else media.first_and_last[1] + 1


_COLUMNS: Final[dict[str, tuple[int, ...]]] = {
    "score": (),
    "right_side": (),
    "certainty": (),
    "shown": (),
    "keypoints": (NUM_KEYPOINTS, 3),
    "world": (NUM_KEYPOINTS, 3),
    "keypoints_2020": (NUM_KEYPOINTS, 3),
    "spread": (NUM_KEYPOINTS, 3),
}
"""Fields of a detection that become arrays, and their shapes; NaN stands for None"""


def hands_to_arrays(frames: Sequence[Sequence[HandDetection]]) -> dict[str, np.ndarray]:
    """The H hands of T frames as arrays: `counts` (T,) hands of each frame, all others (H, ...)."""
    hands = [hand for frame in frames for hand in frame]

    def column(name: str, shape: tuple[int, ...]) -> np.ndarray:
        values = [getattr(hand, name) for hand in hands]
        nothing = np.full(shape, np.nan)
        return np.array([nothing if v is None else v for v in values], dtype=np.float64)

    return {
        "counts": np.array([len(frame) for frame in frames], dtype=np.int64),
        "sides": np.array([SIDES.index(hand.side) for hand in hands], dtype=np.int64),
        "given": np.array([SIDES.index(h.given_side) if h.given_side else -1 for h in hands], dtype=np.int64),
        **{name: column(name, shape).reshape(-1, *shape) for name, shape in _COLUMNS.items()},
    }


def hands_from_arrays(arrays: Mapping[str, np.ndarray]) -> list[tuple[HandDetection, ...]]:
    """The inverse of `hands_to_arrays`. Raises KeyError, IndexError, TypeError and ValueError where the
    arrays do not fit together."""
    hands = []
    for name, shape in _COLUMNS.items():
        if arrays[name].shape != (len(arrays["sides"]), *shape):
            raise ValueError(f"{name} has the shape {arrays[name].shape}")
    for i, side in enumerate(arrays["sides"]):
        known: dict[str, Any] = {}
        for name, shape in _COLUMNS.items():
            if np.isfinite(value := arrays[name][i]).all():
                known[name] = value if shape else float(value)
        known |= {"shown": known["shown"] > 0.0, "given_side": (*SIDES, None)[arrays["given"][i]]}
        hands.append(HandDetection(SIDES[side], **known))
    counts = arrays["counts"]
    # Each count is checked first, so that their sum does not overflow.
    if np.any((counts < 0) | (counts > len(hands))) or counts.sum() != len(hands):
        raise ValueError(f"{len(hands)} hands are not as many as its frames count")
    check_crowd(np.repeat(np.arange(len(counts)), counts))
    return [tuple(hands[end - n : end]) for n, end in zip(counts, np.cumsum(counts), strict=True)]


def chunks_to_arrays(chunks: Sequence[Chunk]) -> dict[str, np.ndarray]:
    """C chunks as arrays for `.npz` files and messages: `sizes` (C, 4) counts the frames, tracked hands,
    counts and cuts of each chunk; the other arrays have the rows of all chunks, one after the other."""
    readable = [c for c in chunks if c.first is not None and c.last is not None]
    thumbnails = [[each.pixels for each in (c.first, c.last) if each is not None] for c in readable]
    sizes = [(len(c.numbers), len(c.tracked), len(c.counts), len(c.cuts)) for c in chunks]
    return hands_to_arrays([h for c in chunks for h in (*c.frames, [t.last for t in c.tracked])]) | {
        "sizes": np.array(sizes, dtype=np.int64).reshape(-1, 4),
        "numbers": np.array([n for c in chunks for n in c.numbers], dtype=np.int64),
        "velocity": np.array([t.velocity for c in chunks for t in c.tracked]).reshape(-1, 2),
        "seen": np.array([n for c in chunks for n in c.counts], dtype=np.int64),
        "cuts": np.array([n for c in chunks for n in c.cuts], dtype=np.int64),
        "looked": np.array([c.first is not None for c in chunks], dtype=bool),
        "glances": np.array(thumbnails, dtype=np.uint8) if readable else np.zeros((0, 2, 0, 0, 3), np.uint8),
    }


def chunks_from_arrays(arrays: Mapping[str, np.ndarray], threshold: float) -> list[Chunk]:
    """The inverse of `chunks_to_arrays`. Raises KeyError, IndexError, TypeError and ValueError where the
    arrays do not fit together."""
    rows = {name: iter(arrays[name].tolist()) for name in ("numbers", "seen", "cuts")}
    velocities, thumbnails = iter(arrays["velocity"]), iter(arrays["glances"])
    hands = iter(hands_from_arrays(arrays))
    chunks = []
    for sizes, readable in zip(arrays["sizes"].tolist(), arrays["looked"], strict=True):
        frame_count, tracked_count, counts, cuts = sizes
        numbers = list(islice(rows["numbers"], frame_count))
        frames = list(islice(hands, frame_count))
        last_hands = next(hands, None)
        if last_hands is None or (len(numbers), len(last_hands)) != (frame_count, tracked_count):
            raise ValueError("its rows do not fit together")
        moving = zip(last_hands, islice(velocities, tracked_count), strict=True)
        first, last = map(Thumbnail, next(thumbnails, ())) if readable else (None, None)
        chunks.append(
            Chunk(
                numbers,
                frames,
                [TrackedHand.of(hand, threshold, velocity) for hand, velocity in moving],
                list(islice(rows["seen"], counts)),
                list(islice(rows["cuts"], cuts)),
                first,
                last,
            )
        )
    return chunks
