"""Keypoints beside the pictures that they were found in, of every kind of input."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from handfit_core.errors import InputError, NoHandFoundError
from handfit_core.interchange.opening import beside, read_recording
from handfit_core.interchange.recording import Recording
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.opening import open_media
from handfit_core.options import CaptureOptions
from handfit_core.pipeline import capture
from handfit_core.take import Take
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


def test_a_sequence_from_1_and_keypoints_from_0(tmp_path: Path) -> None:
    take = capture(str(SAMPLE / "hand.%04d.jpg"), keypoints=openpose(tmp_path / "op", range(24)))
    assert take.frame_numbers.tolist() == list(range(1, 25))
    assert apart(take, range(24)) < 1e-6


def test_a_sequence_whose_numbers_the_keypoints_have(tmp_path: Path) -> None:
    path = openpose(tmp_path / "op", range(2, 6), first=3)
    take = capture(str(SAMPLE / "hand.%04d.jpg"), keypoints=path, frames="3-6")
    assert apart(take, range(2, 6)) < 1e-6


def numbered(path: Path, first: int, count: int = COUNT) -> Path:
    """The sample's first pictures, numbered from `first`."""
    path.mkdir()
    for i in range(count):
        shutil.copy(SAMPLE / f"hand.{i + 1:04d}.jpg", path / f"shot.{i + first:04d}.jpg")
    return path


def laid_beside(pictures: Path, keypoints: Path, frames: str | None = None) -> Recording:
    media = open_media(pictures, FrameRange.parse(frames) if frames else None)
    return beside(media, read_recording(keypoints, CaptureOptions()))


def samples(recording: Recording) -> dict[int, int]:
    """Which of the sample's frames, counted from 0, each picture with a hand has the keypoints of."""
    assert recording.seen is not None
    numbers = recording.frame_numbers[recording.seen.row].tolist()
    rows = [int(np.abs(PIXELS - hand).max(axis=(1, 2)).argmin()) for hand in recording.seen.keypoints]
    return dict(zip(numbers, rows, strict=True))


@pytest.mark.parametrize(("pictures", "keypoints"), [(1, 0), (1, 1), (0, 1), (3, 0), (3, 1), (1001, 0)])
def test_a_part_of_a_sequence_has_its_own_frames_keypoints(
    tmp_path: Path, pictures: int, keypoints: int
) -> None:
    shot, path = numbered(tmp_path / "shot", pictures), openpose(tmp_path / "op", range(COUNT), keypoints)
    assert samples(laid_beside(shot, path)) == {pictures + i: i for i in range(COUNT)}
    part = laid_beside(shot, path, f"{pictures + 2}-{pictures + 3}")
    assert samples(part) == {pictures + 2: 2, pictures + 3: 3}
    said = f"its frame {keypoints} is taken for the pictures' frame {pictures}, as there are as many of both"
    assert said in part.assumed


def test_keypoints_of_some_of_a_sequence(tmp_path: Path) -> None:
    shot = numbered(tmp_path / "shot", 3)
    recording = laid_beside(shot, openpose(tmp_path / "from_0", range(3)))
    assert samples(recording) == {3: 0, 4: 1, 5: 2}
    assert "its frame 0 is taken for the pictures' frame 3, as it counts from 0" in recording.assumed
    recording = laid_beside(shot, openpose(tmp_path / "by_number", range(2), first=4))
    assert samples(recording) == {4: 0, 5: 1}
    assert "its frame 4 is taken for the pictures' frame 4, by their numbers" in recording.assumed
    with pytest.raises(InputError, match="its frames are 4 to 4, and the pictures' are 5 to 5"):
        laid_beside(shot, openpose(tmp_path / "one", range(1), first=4), "5")


def test_keypoints_that_may_count_from_0_are_doubted(tmp_path: Path) -> None:
    """The first frames have no hand, and the file tells nothing of them."""
    shot, path = numbered(tmp_path / "shot", 1), openpose(tmp_path / "op", range(2, 4), first=2)
    recording = laid_beside(shot, path)
    assert samples(recording) == {2: 2, 3: 3}
    assert any("if it counts from 0, give it a frame 0 without" in phrase for phrase in recording.assumed)
    (path / "clip_000000000000_keypoints.json").write_text(json.dumps({"people": []}))
    assert samples(laid_beside(shot, path)) == {3: 2, 4: 3}


def test_a_sequence_from_1001_and_keypoints_that_are_counted(tmp_path: Path) -> None:
    pictures = numbered(tmp_path / "pictures", 1001)
    take = capture(pictures, keypoints=openpose(tmp_path / "op", range(COUNT)))
    assert take.frame_numbers.tolist() == list(range(1001, 1001 + COUNT))
    assert apart(take, range(COUNT)) < 1e-6


@pytest.mark.parametrize("first", [0, 1])
def test_a_video_and_keypoints_from_0_or_1(tmp_path: Path, video: Path, first: int) -> None:
    take = capture(video, keypoints=openpose(tmp_path / "op", range(COUNT), first))
    assert (take.fps, take.source.kind) == (30.0, "video")
    assert apart(take, range(COUNT)) < 1e-6


def test_a_part_of_a_video_has_its_own_frames_keypoints(tmp_path: Path, video: Path) -> None:
    """OpenPose counts from 0: frame 3 of the video is its number 2."""
    take = capture(video, keypoints=openpose(tmp_path / "op", range(COUNT)), frames="3-4")
    assert take.frame_numbers.tolist() == [3, 4]
    assert apart(take, range(2, 4)) < 1e-6


def test_a_photo_and_a_file_of_any_number(tmp_path: Path) -> None:
    keypoints = openpose(tmp_path / "op", range(7, 8), first=12) / "clip_000000000012_keypoints.json"
    take = capture(SAMPLE / "hand.0008.jpg", keypoints=keypoints)
    assert apart(take, range(7, 8)) < 1e-6


def test_frames_that_the_keypoints_lack_have_no_hand(tmp_path: Path) -> None:
    path = openpose(tmp_path / "op", range(10))
    for gone in (4, 5, 9):
        (path / f"clip_{gone:012d}_keypoints.json").unlink()
    take = capture(str(SAMPLE / "hand.%04d.jpg"), keypoints=path)
    assert take.frame_numbers.tolist() == list(range(1, 25))
    assert np.flatnonzero(take.hands[0].detected).tolist() == [0, 1, 2, 3, 6, 7, 8]


def test_missing_points_do_not_pull_the_hand(tmp_path: Path) -> None:
    path = openpose(tmp_path / "op", range(24))
    for file in path.iterdir():
        content = json.loads(file.read_text())
        content["people"][0][f"hand_{SIDE}_keypoints_2d"][8 * 3 : 9 * 3] = [0.0, 0.0, 0.0]
        file.write_text(json.dumps(content))
    hand = capture(str(SAMPLE / "hand.%04d.jpg"), keypoints=path).hands[0]
    fitted = TRUTH.intrinsics.project(hand.joints_3d)
    size = np.ptp(PIXELS, axis=1).max(axis=1)
    off = np.linalg.norm(fitted - PIXELS, axis=-1) / size[:, None]
    assert np.median(off[:, [5, 6, 7, 9, 12]]) < 0.05
    # Where the zeros would pull it, half of the picture away.
    assert np.median(off[:, 8]) < 0.3


def test_doubtful_points_pull_less(tmp_path: Path) -> None:
    off = []
    for sure in (0.9, 0.02):
        path = openpose(tmp_path / f"op{sure}", range(24))
        for file in path.iterdir():
            content = json.loads(file.read_text())
            hand = np.array(content["people"][0][f"hand_{SIDE}_keypoints_2d"]).reshape(21, 3)
            hand[8] = [*(hand[8, :2] + 0.4 * np.ptp(hand[:, 0])), sure]
            content["people"][0][f"hand_{SIDE}_keypoints_2d"] = hand.ravel().tolist()
            file.write_text(json.dumps(content))
        fitted = capture(str(SAMPLE / "hand.%04d.jpg"), keypoints=path).hands[0].joints_3d
        off.append(np.linalg.norm(TRUTH.intrinsics.project(fitted)[:, 8] - PIXELS[:, 8], axis=-1).mean())
    assert off[1] < 0.7 * off[0]


def test_the_pictures_size_is_told_or_its_keypoints_are_refused(tmp_path: Path) -> None:
    path = openpose(tmp_path / "op", range(24), scale=3.0)
    pictures = str(SAMPLE / "hand.%04d.jpg")
    with pytest.raises(InputError, match=r"outside the pictures.*--picture-size"):
        capture(pictures, keypoints=path)
    take = capture(pictures, keypoints=path, picture_size=(3 * TRUTH.width, 3 * TRUTH.height))
    assert apart(take, range(24)) < 1e-6


def test_keypoints_of_another_clip_are_refused(tmp_path: Path, video: Path) -> None:
    with pytest.raises(InputError, match=r"its frames are 500 to 504, and the pictures' are 1 to 5"):
        capture(video, keypoints=openpose(tmp_path / "op", range(COUNT), first=500))


def test_the_other_side_is_not_there(tmp_path: Path, video: Path) -> None:
    other = "left" if SIDE == "right" else "right"
    with pytest.raises(NoHandFoundError):
        capture(video, hands=other, keypoints=openpose(tmp_path / "op", range(COUNT)))
