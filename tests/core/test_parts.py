"""Clips that are detected in parts: the take is that of one capture, byte for byte, or a sentence says why
not."""

import io
import itertools
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from handfit_core.errors import Cancelled, InputError, OptionError
from handfit_core.geometry.camera import Intrinsics
from handfit_core.media.frame_range import FrameRange, part_ranges
from handfit_core.media.opening import open_media
from handfit_core.media.settings import MEDIA
from handfit_core.options import CaptureOptions
from handfit_core.parts import Part, Parts, chunks_in
from handfit_core.pipeline import Progress, capture_to_file, detect_to_file
from handfit_core.worker.answering import answer
from tests.core.detect.clips import SAMPLE, picture, write_two_hands

pytestmark = pytest.mark.usefixtures("landmark_model")

ALONE = CaptureOptions(processes=1)


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("parts") / "two.mp4"
    write_two_hands(path)
    return path


@pytest.fixture(scope="module")
def chunks(clip: Path) -> list[Path]:
    """The clip's three chunks, each a part of its own."""
    parts = [clip.parent / f"chunk{i}.npz" for i in range(3)]
    for path, part in zip(parts, ("1-96", "97-192", "193-"), strict=True):
        detect_to_file(clip, path, ALONE, FrameRange.parse(part))
    return parts


@pytest.fixture(scope="module")
def captured(clip: Path) -> bytes:
    """The take of one capture."""
    path = clip.parent / "captured.npz"
    capture_to_file(clip, path, ALONE)
    return path.read_bytes()


def solved(clip: Path | str, paths: list[Path], folder: Path, options: CaptureOptions = ALONE) -> bytes:
    """The take of those parts."""
    capture_to_file(clip, folder / "solved.npz", options, parts=Parts(paths))
    return (folder / "solved.npz").read_bytes()


def same_arrays(a: bytes, b: bytes) -> bool:
    """Whether two takes are equal in every bit, also where a test's failure should not show megabytes."""
    first, second = (np.load(io.BytesIO(data)) for data in (a, b))
    return first.files == second.files and all(first[n].tobytes() == second[n].tobytes() for n in first.files)


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1), (1, 2, 1, 0, 0)])
def test_chunks_of_any_order_and_some_twice(
    clip: Path, chunks: list[Path], captured: bytes, order: tuple[int, ...], tmp_path: Path
) -> None:
    found = solved(clip, [chunks[i] for i in order], tmp_path)
    assert same_arrays(found, captured)
    assert found == captured


@pytest.mark.parametrize("ranges", [["-"], ["2-200", "-1", "201-210", "500-"], ["-120", "100-9999"]], ids=str)
def test_ranges_that_fit_no_chunk(clip: Path, captured: bytes, ranges: list[str], tmp_path: Path) -> None:
    """One part, odd ranges, ranges in which nothing begins, that overlap or lie past the end."""
    paths = []
    for i, text in enumerate(ranges):
        paths.append(tmp_path / f"{i}.npz")
        done = detect_to_file(clip, paths[-1], ALONE, FrameRange.parse(text))
        assert done["frames"] == 0 or done["first"] % MEDIA.chunk_frames == 1
    assert solved(clip, paths, tmp_path) == captured


@pytest.mark.parametrize(
    "options",
    [
        {"hands": "right", "max_hands": 1, "smoothing": 3.0, "processes": 2},
        {"frames": "11-205:2", "hands": "both"},
        {"regions": [(660.0, 70.0, 142.0, 200.0, 112)], "only_regions": True, "threshold": 0.3},
    ],
    ids=lambda options: next(iter(options)),
)
def test_options_of_the_clip(clip: Path, options: dict[str, Any], tmp_path: Path) -> None:
    known = CaptureOptions(**{"processes": 1, **options})
    done = [detect_to_file(clip, tmp_path / f"{i}.npz", known, part) for i, part in
            enumerate((FrameRange(None, 150), FrameRange(151, None)))]  # fmt: skip
    assert min(part["frames"] for part in done) > 0
    capture_to_file(clip, tmp_path / "captured.npz", replace(known, processes=1))
    parts = [tmp_path / "1.npz", tmp_path / "0.npz"]
    assert solved(clip, parts, tmp_path, Parts(parts).options) == (tmp_path / "captured.npz").read_bytes()


def test_a_sequence_with_holes_that_was_copied(tmp_path: Path) -> None:
    for folder in (tmp_path / "here", tmp_path / "there"):
        folder.mkdir()
        for i in itertools.chain(range(900, 950), range(1000, 1070)):
            bgr = cv2.resize(picture(i)[..., ::-1], (320, 240), interpolation=cv2.INTER_AREA)
            cv2.imwrite(str(folder / f"shot.{i}.jpg"), bgr)
    pattern = "shot.####.jpg"
    paths = [tmp_path / "0.npz", tmp_path / "1.npz"]
    detect_to_file(tmp_path / "there" / pattern, paths[0], ALONE, FrameRange(None, 1045))
    detect_to_file(tmp_path / "here" / pattern, paths[1], ALONE, FrameRange(1046, None))
    assert [chunk.numbers[0] for path in paths for chunk in Part.load(path).chunks] == [900, 1046]
    capture_to_file(str(tmp_path / "here" / pattern), tmp_path / "captured.npz", ALONE)
    found = solved(str(tmp_path / "here" / pattern), paths, tmp_path)
    assert found == (tmp_path / "captured.npz").read_bytes()


def test_parts_are_solved_with_other_options_of_the_fit(
    clip: Path, chunks: list[Path], tmp_path: Path
) -> None:
    """Nothing is detected again."""
    options = CaptureOptions(
        smoothing=0.0,
        solver="fast-per-frame",
        hands="right",
        intrinsics=Intrinsics(900.0, 900.0, 480.0, 180.0),
    )
    capture_to_file(clip, tmp_path / "captured.npz", replace(options, processes=1))
    assert solved(clip, chunks, tmp_path, options) == (tmp_path / "captured.npz").read_bytes()


def test_requests_of_the_worker(clip: Path, captured: bytes, tmp_path: Path) -> None:
    told: list[tuple[str, int, int]] = []
    common = {"input": [str(clip)], "options": {"processes": 1}}
    for i, part in enumerate(("-100", "101-")):
        message = {"request": "detect", **common, "part": part, "output": str(tmp_path / f"{i}.npz")}
        done = answer(message, lambda: False, lambda *progress: told.append(progress))
        assert (done["first"], done["last"], done["frames"]) == ((1, 192, 192), (193, 210, 18))[i]
    assert told[-1] == ("detect", 18, 18)
    parts = [str(tmp_path / f"{i}.npz") for i in range(2)]
    message = {"request": "capture", **common, "parts": parts, "output": str(tmp_path / "take.npz")}
    done = answer(message, lambda: False, lambda *_: None)
    assert (done["frames"], done["stopped"], len(done["hands"])) == (210, False, 2)
    assert (tmp_path / "take.npz").read_bytes() == captured
    for wrong, said in (
        ({"parts": []}, "parts must be a list of the paths"),
        ({"parts": ["no.npz"]}, "read"),
    ):
        with pytest.raises((OptionError, InputError), match=said):
            answer({**message, **wrong}, lambda: False, lambda *_: None)


def changed(path: Path, folder: Path, **fields: Any) -> Path:
    """A part with other fields."""
    return replace(Part.load(path), **fields).save(folder / "changed.npz")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (lambda s, _: [s[0], s[2]], "no part has the frames 97-192; detect them, too, with --frames"),
        (lambda s, _: [s[1]], r"no part has the frames 1-96; detect"),
        (lambda s, _: s[:2], "the parts end before the clip does; detect what is left, .* --frames 193-$"),
        (lambda s, to: [s[0], changed(s[2], to, first=7, chunks=[])], "no part has the frames 97-672"),
        (
            lambda s, to: [*s, changed(s[1], to, first=0)],
            r"frames 97 to 192 are in .*chunk0\.npz and, with other hands, in .*changed\.npz; leave one",
        ),
        (lambda s, to: [s[0], changed(s[0], to, first=1), s[2]], "changed.npz: the part is damaged"),
        (lambda s, to: [s[0], changed(s[1], to, fingerprint="0")], "is of another input than"),
        (lambda s, to: [changed(s[0], to, fingerprint="0")], "is of another input than .*two.mp4, or"),
        (lambda s, to: [s[0], changed(s[1], to, made_by="elder")], "by elder, and .*one of them"),
        (lambda s, to: [changed(s[0], to, made_by="elder")], "by elder, and this is handfit-core"),
        (
            lambda s, to: [s[0], changed(s[1], to, options=CaptureOptions(threshold=0.4, smoothing=0.0))],
            r"other options than .* \(threshold, smoothing\); detect one of them again",
        ),
        (lambda s, to: [changed(s[0], to, options=CaptureOptions(threshold=0.4))], r"options \(threshold\)"),
        (lambda _, to: [to / "captured.npz"], "the part cannot be read"),
        (lambda s, _: [s[0].parent / "captured.npz"], "not a part of a clip, or a damaged one"),
        (lambda *_: [], "no part was given"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)  # fmt: skip
@pytest.mark.usefixtures("captured")
def test_parts_that_do_not_fit(
    clip: Path,
    chunks: list[Path],
    given: Callable[[list[Path], Path], list[Path]],
    said: str,
    tmp_path: Path,
) -> None:
    output = tmp_path / "solved.npz"
    with pytest.raises(InputError) as raised:
        capture_to_file(clip, output, ALONE, parts=Parts(given(chunks, tmp_path)))
    assert re.search(said, str(raised.value))
    assert "\n" not in str(raised.value)
    assert not output.exists()


def test_a_clip_that_has_changed(chunks: list[Path], clip: Path, tmp_path: Path) -> None:
    data = bytearray(clip.read_bytes())
    data[len(data) // 2] ^= 1
    (tmp_path / "two.mp4").write_bytes(data)
    with pytest.raises(InputError, match=r"another input than .*two\.mp4, or that has changed since"):
        solved(tmp_path / "two.mp4", chunks, tmp_path)


@pytest.mark.parametrize(
    ("source", "options", "part", "said"),
    [
        (SAMPLE / "hand.0001.jpg", {}, None, "hand.0001: a photo has no parts; capture it"),
        (None, {"detector": "mediapipe"}, None, "the detector mediapipe looks at a clip from its beginning"),
        (None, {}, FrameRange(1, 90, 2), "1-90:2 must have no step; give the clip's with --clip-frames"),
    ],
    ids=str,
)
def test_what_has_no_parts(
    clip: Path,
    source: Path | None,
    options: dict[str, Any],
    part: FrameRange | None,
    said: str,
    tmp_path: Path,
) -> None:
    with pytest.raises(OptionError, match=re.escape(said)):
        detect_to_file(source or clip, tmp_path / "a.npz", CaptureOptions(**options), part)
    assert list(tmp_path.iterdir()) == []


def test_a_stopped_part_is_none(clip: Path, tmp_path: Path) -> None:
    told: list[Progress] = []
    with pytest.raises(Cancelled):
        detect_to_file(clip, tmp_path / "a.npz", ALONE, None, told.append, lambda: len(told) > 5)
    assert list(tmp_path.iterdir()) == []


def test_where_the_header_does_not_tell_how_long_a_clip_is(clip: Path) -> None:
    media = open_media(clip)
    assert chunks_in(media, FrameRange(97, 210)) == slice(1, None)
    assert chunks_in(media, FrameRange(98, 209)) == slice(2, 3)
    assert chunks_in(media, FrameRange(98, 150)) == slice(2, 2)
    media.expected_frames = 0
    assert chunks_in(media, FrameRange(97, 210)) == slice(1, 3)
    assert chunks_in(media, FrameRange(97, None)) == slice(1, None)


@pytest.mark.parametrize("frames", [range(1, 2), range(1, 400), range(5, 20_001, 3), range(1001, 433_001)])
@pytest.mark.parametrize("most", [1, 2, 7, 1000])
def test_proposed_ranges_tile_a_clip(frames: range, most: int) -> None:
    parts = part_ranges(frames, most)
    assert 1 <= len(parts) <= most
    counts = [sum(number in part for number in frames[:: MEDIA.chunk_frames]) for part in parts]
    assert sum(counts) == len(frames[:: MEDIA.chunk_frames])
    assert max(counts) - min(counts) <= 1
    assert len(parts) == 1 or (min(counts) >= 4 and (len(parts) == most or max(counts) < 8))
    assert parts[0].first == frames[0]
    assert parts[-1].last is None
    assert all(a.last + 1 == b.first for a, b in itertools.pairwise(parts) if a.last and b.first)
