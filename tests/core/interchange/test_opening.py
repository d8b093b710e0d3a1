"""What other programs found, beside the pictures that it was found in and alone."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from handfit_core.capturing.options import CaptureOptions
from handfit_core.capturing.pipeline import capture
from handfit_core.capturing.sources import open_input
from handfit_core.common.errors import InputError, NoHandFoundError, OptionError, PictureSizeError
from handfit_core.common.skeleton import other_side
from handfit_core.geometry.camera import Intrinsics
from handfit_core.interchange.opening import RecordedMedia, beside, read_recording
from handfit_core.interchange.recording import Recording
from handfit_core.interchange.writers import writer_for
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.opening import open_media
from handfit_core.take import Take
from handfit_core.tasks.inputs import expand
from handfit_core.worker.answering import probe
from tests.conftest import ROOT

SAMPLE = ROOT / "samples" / "rendered_hand"
TRUTH = Take.load(SAMPLE / "truth.take.npz")
PIXELS = TRUTH.hands[0].keypoints_2d
SIDE = TRUTH.hands[0].side
COUNT = 5


def openpose(path: Path, rows: range, first: int = 0, scale: float = 1.0) -> Path:
    """OpenPose's folder for some of the sample's frames, counted from `first`."""
    path.mkdir()
    for i, row in enumerate(rows):
        hand = np.column_stack([PIXELS[row] * scale, np.full(21, 0.8)])
        people = [{f"hand_{SIDE}_keypoints_2d": hand.ravel().tolist()}]
        (path / f"clip_{first + i:012d}_keypoints.json").write_text(json.dumps({"people": people}))
    return path


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("video") / "clip.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (TRUTH.width, TRUTH.height))
    for i in range(1, COUNT + 1):
        writer.write(cv2.imread(str(SAMPLE / f"hand.{i:04d}.jpg")))
    writer.release()
    return path


def apart(take: Take, rows: range) -> float:
    """Pixels by which the take's keypoints differ from those of the sample's frames."""
    assert take.hands[0].side == SIDE
    return float(np.abs(take.hands[0].keypoints_2d - PIXELS[list(rows)]).max())


def numbered(path: Path, first: int, count: int = COUNT) -> Path:
    """The sample's first pictures, numbered from `first`."""
    path.mkdir()
    for i in range(count):
        shutil.copy(SAMPLE / f"hand.{i + 1:04d}.jpg", path / f"shot.{i + first:04d}.jpg")
    return path


def laid_beside(pictures: Path, keypoints: Path, frames: str | None = None) -> Recording:
    media = open_media(pictures, FrameRange.parse(frames) if frames else None)
    return beside(media, read_recording(keypoints))


def samples(recording: Recording) -> dict[int, int]:
    """Which of the sample's frames, counted from 0, each picture with a hand has the keypoints of."""
    assert recording.seen is not None
    numbers = recording.frame_numbers[recording.seen.row].tolist()
    rows = [int(np.abs(PIXELS - hand).max(axis=(1, 2)).argmin()) for hand in recording.seen.keypoints]
    return dict(zip(numbers, rows, strict=True))


EQUAL = [(1, 0), (1, 1), (0, 1), (3, 0), (3, 1), (1001, 0)]


@pytest.mark.parametrize(
    ("pictures", "rows", "first", "found", "said"),
    [
        *((p, range(5), k, {p + i: i for i in range(5)}, "as there are as many of both") for p, k in EQUAL),
        (3, range(3), 0, {3: 0, 4: 1, 5: 2}, "as it counts from 0"),
        (1, range(10), 0, {1 + i: i for i in range(5)}, "as it counts from 0"),
        (3, range(2), 4, {4: 0, 5: 1}, "by their numbers"),
        (1, range(2, 4), 2, {2: 2, 3: 3}, "by their numbers; if it counts from 0, give it a frame 0 without"),
    ],
)
def test_which_frame_is_which_pictures(
    tmp_path: Path, pictures: int, rows: range, first: int, found: dict[int, int], said: str
) -> None:
    """Of five pictures, and of a part of them; what is taken for what is said."""
    shot, path = numbered(tmp_path / "shot", pictures), openpose(tmp_path / "op", rows, first)
    whole = laid_beside(shot, path)
    part = laid_beside(shot, path, f"{pictures + 2}-{pictures + 3}")
    assert samples(whole) == found
    assert samples(part) == {n: row for n, row in found.items() if n - pictures in (2, 3)}
    for recording in (whole, part):
        assert f"its frame {first} is taken for the pictures' frame {min(found)}, {said}" in " ".join(
            recording.assumed
        )


def test_captures_beside_pictures(tmp_path: Path, video: Path) -> None:
    """Without a landmark model: nobody looks at the pictures. OpenPose counts from 0, and a photo's file may
    have any number."""
    every, sequence = openpose(tmp_path / "op", range(24)), str(SAMPLE / "hand.%04d.jpg")
    shot, five = numbered(tmp_path / "shot", 1001), openpose(tmp_path / "five", range(COUNT))
    from_1 = openpose(tmp_path / "from_1", range(COUNT), 1)
    photo = openpose(tmp_path / "photo", range(7, 8), first=12) / "clip_000000000012_keypoints.json"
    for pictures, keypoints, frames, numbers, first in (
        (sequence, every, None, range(1, 25), 0),
        (sequence, every, "3-6", range(3, 7), 2),
        (shot, five, None, range(1001, 1001 + COUNT), 0),
        (video, five, None, range(1, 1 + COUNT), 0),
        (video, from_1, None, range(1, 1 + COUNT), 0),
        (video, five, "3-4", range(3, 5), 2),
        (SAMPLE / "hand.0008.jpg", photo, None, range(1, 2), 7),
    ):
        take = capture(pictures, keypoints=keypoints, frames=frames, landmark_model="none")
        assert take.frame_numbers.tolist() == list(numbers)
        assert (take.width, take.height) == (TRUTH.width, TRUTH.height)
        assert apart(take, range(first, first + len(numbers))) < 1e-6
        assert take.source.kind == ("video" if pictures is video else take.source.kind)


def test_frames_that_the_keypoints_lack_have_no_hand(tmp_path: Path) -> None:
    path = openpose(tmp_path / "op", range(10))
    for gone in (4, 5, 9):
        (path / f"clip_{gone:012d}_keypoints.json").unlink()
    take = capture(str(SAMPLE / "hand.%04d.jpg"), keypoints=path)
    assert take.frame_numbers.tolist() == list(range(1, 25))
    assert np.flatnonzero(take.hands[0].detected).tolist() == [0, 1, 2, 3, 6, 7, 8]


def test_keypoints_of_pictures_of_another_size(tmp_path: Path, points: Path) -> None:
    """They are brought to the pictures' size, which the file tells or an option; else they are refused."""
    path, pictures = openpose(tmp_path / "op", range(24), scale=3.0), str(SAMPLE / "hand.%04d.jpg")
    with pytest.raises(InputError, match=r"outside the pictures.*--picture-size"):
        capture(pictures, keypoints=path)
    take = capture(pictures, keypoints=path, picture_size=(3 * TRUTH.width, 3 * TRUTH.height))
    assert apart(take, range(24)) < 1e-6
    hand = {"side": SIDE, "keypoints_2d": (PIXELS / 2.0).tolist()}
    camera = {name: value / 2.0 for name, value in vars(TRUTH.intrinsics).items()}
    changed(points, hands=[hand], intrinsics=camera, width=TRUTH.width // 2, height=TRUTH.height // 2)
    take = capture(pictures, keypoints=points, frames="3-4")
    assert apart(take, range(2, 4)) < 0.01
    assert vars(take.intrinsics) == pytest.approx(vars(TRUTH.intrinsics)), "the file's camera"
    own = Intrinsics.assumed(TRUTH.width, TRUTH.height)
    assert capture(pictures, keypoints=points, frames="3-4", intrinsics=own).intrinsics == own


def test_keypoints_of_another_clip_or_hand_are_refused(tmp_path: Path, video: Path) -> None:
    with pytest.raises(InputError, match=r"its frames are 500 to 504, and the pictures' are 1 to 5"):
        capture(video, keypoints=openpose(tmp_path / "op", range(COUNT), first=500))
    with pytest.raises(NoHandFoundError):
        capture(video, hands=other_side(SIDE), keypoints=openpose(tmp_path / "five", range(COUNT)))


# Recordings alone


@pytest.fixture
def points(tmp_path: Path) -> Path:
    path = tmp_path / "hand.points.json"
    writer_for(path).write(TRUTH, path)
    return path


def changed(path: Path, **values: Any) -> Path:
    """The file with other values, or without those that are None."""
    content = json.loads(path.read_text(encoding="utf-8")) | values
    path.write_text(json.dumps({name: value for name, value in content.items() if value is not None}))
    return path


def test_points_become_hands_again(points: Path) -> None:
    take = capture(points, frames="5-12")
    assert (take.source.kind, take.frame_numbers.tolist()) == ("data", list(range(5, 13)))
    (hand,) = take.hands
    assert (hand.side, hand.refinable) == (SIDE, True)
    off = np.degrees(hand.hand_pose - TRUTH.hands[0].hand_pose[4:12])
    assert np.linalg.norm(off, axis=1).max() < 10.0 * np.sqrt(45)


def test_a_size_and_a_rate_that_the_file_does_not_tell(points: Path) -> None:
    hand = {"side": SIDE, "keypoints_2d": PIXELS.tolist()}
    changed(points, hands=[hand], width=None, height=None, intrinsics=None, fps=None)
    for fps, rate, assumed in ((50.0, 50.0, 0), (None, 24.0, 1)):
        media = open_input(points, CaptureOptions(picture_size=(640, 480), fps=fps))
        assert isinstance(media, RecordedMedia)
        assert (media.width, media.height, media.fps) == (640, 480, rate)
        assert len(media.recording.assumed) == assumed
    with pytest.raises(PictureSizeError, match="--picture-size"):
        open_input(points, CaptureOptions())
    asked = probe({"input": [str(points)]})
    assert [asked[name] for name in ("kind", "width", "height", "frames")] == ["data", 0, 0, 24]


@pytest.mark.parametrize("kind", ["keypoints_2d", "keypoints_3d"])
def test_frames_without_the_hand_are_told_from_a_mistake(points: Path, kind: str) -> None:
    """Alone, and beside pictures; and a hand that is in no wanted frame is none of the take."""
    hand = json.loads(points.read_text(encoding="utf-8"))["hands"][0]
    rows = [row if i < 5 else None for i, row in enumerate(hand[kind])]
    changed(points, hands=[{"side": SIDE, kind: rows}])
    for source, more in ((points, {}), (str(SAMPLE / "hand.%04d.jpg"), {"keypoints": points})):
        with pytest.raises(NoHandFoundError, match="is in frames 6 to 10; choose other frames"):
            capture(source, frames="6-10", **more)
    changed(points, hands=[{"side": SIDE, kind: rows}, {"side": other_side(SIDE), kind: hand[kind]}])
    assert [h.side for h in capture(points, frames="6-10").hands] == [other_side(SIDE)]
    changed(points, hands=[{"side": SIDE, kind: [[p, *[None] * 20] for p in hand[kind][0][:1]] * 24}])
    with pytest.raises((InputError, NoHandFoundError), match="6 points"):
        capture(points, frames="1-3")


def test_questions_of_pictures_are_refused(points: Path) -> None:
    with pytest.raises(OptionError, match="holds no pictures"):
        capture(points, keypoints=points)
    with pytest.raises(OptionError, match="holds no pictures, in whose regions"):
        capture(points, regions=["0,0,9,9"])
    with pytest.raises(OptionError, match=r"either regions.* or keypoints"):
        CaptureOptions(keypoints=str(points), regions=((0, 0, 9, 9),))


def test_a_take_is_not_captured_again(tmp_path: Path) -> None:
    path = TRUTH.save(tmp_path / "hand.take.npz")
    for source, more in ((path, {}), (str(SAMPLE / "hand.0001.jpg"), {"keypoints": path})):
        with pytest.raises(InputError, match=r"this is a take, which is captured already.*convert"):
            capture(source, **more)


def test_a_batch_takes_such_files_and_tells_takes_from_them(points: Path, tmp_path: Path) -> None:
    take, other = TRUTH.save(tmp_path / "hand.take.npz"), tmp_path / "other.npz"
    np.savez(other, poses=np.zeros((3, 165)))
    folder = openpose(tmp_path / "frames", range(1))
    assert expand(str(take))[0].take == take
    for path in (points, other, folder):
        assert (expand(str(path))[0].take, expand(str(path))[0].source) == (None, (str(path),))


def test_frames_beyond_blenders_are_counted(points: Path) -> None:
    changed(points, frames=[20260101000000 + n for n in range(24)])
    assert capture(points, frames="2-3").frame_numbers.tolist() == [2, 3]
