"""Points of this project's own: written, read back, fitted again; and what is said of other files."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.__main__ import main
from handfit_core.errors import InputError, NoHandFoundError, OptionError, PictureSizeError
from handfit_core.interchange.opening import RecordedMedia, is_recording, open_input, read_recording
from handfit_core.interchange.writers import writer_for
from handfit_core.media.frame_range import FrameRange
from handfit_core.options import CaptureOptions
from handfit_core.pipeline import capture
from handfit_core.skeleton import other_side
from handfit_core.take import Take, chosen, is_take
from handfit_core.tasks.inputs import expand
from handfit_core.worker.answering import probe
from tests.conftest import ROOT

SAMPLE = ROOT / "samples" / "rendered_hand"


@pytest.fixture(scope="module")
def truth() -> Take:
    return Take.load(SAMPLE / "truth.take.npz")


@pytest.fixture
def written(truth: Take, tmp_path: Path) -> Path:
    path = tmp_path / "hand.points.json"
    writer_for(path).write(truth, path)
    return path


def changed(path: Path, **values: Any) -> Path:
    content = json.loads(path.read_text(encoding="utf-8")) | values
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def in_pictures(path: Path) -> Path:
    hands = json.loads(path.read_text(encoding="utf-8"))["hands"]
    return changed(path, hands=[{k: v for k, v in hand.items() if k != "keypoints_3d"} for hand in hands])


def test_what_is_written_is_read_back(truth: Take, written: Path) -> None:
    read = read_recording(written, CaptureOptions())
    assert (read.format, read.fps, read.size) == ("points", truth.fps, (truth.width, truth.height))
    assert np.array_equal(read.frame_numbers, truth.frame_numbers)
    assert read.intrinsics == truth.intrinsics
    (points,) = read.points
    assert points.side == truth.hands[0].side
    assert np.abs(points.points - truth.hands[0].joints_3d).max() < 1e-6


def test_points_in_pictures_are_read_back(truth: Take, written: Path) -> None:
    read = read_recording(in_pictures(written), CaptureOptions())
    assert read.seen is not None
    assert np.abs(read.seen.keypoints - truth.hands[0].keypoints_2d).max() < 1e-3
    assert read.seen.left.tolist() == [truth.hands[0].side == "left"] * len(truth.frame_numbers)


def test_a_size_and_a_rate_that_the_file_does_not_tell(truth: Take, written: Path) -> None:
    content = json.loads(in_pictures(written).read_text(encoding="utf-8"))
    kept = {key: value for key, value in content.items() if key not in ("width", "height", "intrinsics")}
    written.write_text(json.dumps({key: value for key, value in kept.items() if key != "fps"}))
    told = open_input(written, CaptureOptions(picture_size=(640, 480), fps=50.0))
    assert isinstance(told, RecordedMedia)
    assert (told.width, told.height, told.fps) == (640, 480, 50.0)
    assert told.recording.assumed == ()
    no_rate = open_input(written, CaptureOptions(picture_size=(640, 480)))
    assert isinstance(no_rate, RecordedMedia)
    assert (no_rate.fps, len(no_rate.recording.assumed)) == (24.0, 1)
    with pytest.raises(PictureSizeError, match="--picture-size"):
        open_input(written, CaptureOptions())
    asked = probe({"input": [str(written)]})
    assert (asked["kind"], asked["width"], asked["height"], asked["frames"]) == (
        "data",
        0,
        0,
        len(truth.frame_numbers),
    )


@pytest.mark.parametrize("by_the_file", [True, False])
def test_points_of_a_smaller_copy(truth: Take, written: Path, by_the_file: bool) -> None:
    """They are brought to the pictures' size."""
    content = json.loads(in_pictures(written).read_text(encoding="utf-8"))
    content["width"], content["height"] = size = truth.width // 2, truth.height // 2
    for hand in content["hands"]:
        hand["keypoints_2d"] = (np.array(hand["keypoints_2d"]) / 2.0).tolist()
    for name in () if by_the_file else ("width", "height", "intrinsics"):
        del content[name]
    written.write_text(json.dumps(content))
    told = {} if by_the_file else {"picture_size": size}
    take = capture(str(SAMPLE / "hand.%04d.jpg"), keypoints=written, frames="3-4", **told)
    rows = np.isin(truth.frame_numbers, take.frame_numbers)
    assert np.abs(take.hands[0].keypoints_2d - truth.hands[0].keypoints_2d[rows]).max() < 0.01


def test_points_become_hands_again(truth: Take, written: Path) -> None:
    take = capture(written, frames="5-12")
    assert take.source.kind == "data"
    assert take.frame_numbers.tolist() == list(range(5, 13))
    (hand,) = take.hands
    assert hand.side == truth.hands[0].side
    assert hand.refinable
    rows = np.isin(truth.frame_numbers, take.frame_numbers)
    apart = np.linalg.norm(np.degrees(hand.hand_pose - truth.hands[0].hand_pose[rows]), axis=1) / np.sqrt(45)
    assert apart.max() < 10.0


def test_points_beside_their_pictures_take_the_place_of_a_search(truth: Take, written: Path) -> None:
    """Without a landmark model: nobody looks at the pictures."""
    take = capture(
        str(SAMPLE / "hand.%04d.jpg"), keypoints=in_pictures(written), frames="3-10", landmark_model="none"
    )
    assert take.source.kind == "sequence"
    assert (take.width, take.height) == (truth.width, truth.height)
    rows = np.isin(truth.frame_numbers, take.frame_numbers)
    seen = take.hands[0].keypoints_2d
    assert np.abs(seen - truth.hands[0].keypoints_2d[rows]).max() < 1e-3


def test_points_of_another_clip_are_refused(written: Path) -> None:
    other = changed(written, frames=[n + 1000 for n in json.loads(written.read_text())["frames"]])
    with pytest.raises(InputError, match=r"its frames are 1001 to .*give the keypoints of these pictures"):
        capture(str(SAMPLE / "hand.%04d.jpg"), keypoints=other)


def test_frames_beyond_blenders_are_counted(written: Path) -> None:
    first = 20260101000000
    far = changed(written, frames=[first + n for n in range(len(json.loads(written.read_text())["frames"]))])
    assert capture(far, frames="2-3").frame_numbers.tolist() == [2, 3]


def test_frames_without_any_hand_are_named(written: Path) -> None:
    hands = json.loads(written.read_text())["hands"]
    for hand in hands:
        hand["keypoints_3d"][:4] = [None] * 4
    with pytest.raises(NoHandFoundError, match="no hand, of which 6 points or more are known"):
        capture(changed(written, hands=hands), frames="1-3")


def test_a_file_of_points_has_no_other_keypoints(written: Path) -> None:
    with pytest.raises(OptionError, match="holds no pictures"):
        capture(written, keypoints=written)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"version": 2}, "newer version"),
        ({"frames": []}, "reshape"),
        ({"frames": [1] * 24}, "numbers do not increase"),
        ({"frames": [1], "hands": [{"side": "both", "keypoints_3d": [None]}]}, "must be left or right"),
        ({"hands": [{"side": "Left", "keypoints_2d": []}]}, "must be left or right"),
        ({"hands": []}, "none of its frames has a hand"),
        ({"hands": 3}, "not iterable"),
        ({"hands": [{"side": "left", "keypoints_3d": [[[1, 2]] * 21]}]}, "inhomogeneous|reshape"),
        ({"frames": [1], "hands": [{"side": "left", "keypoints_3d": [[[1e300] * 3] * 21]}]}, "beyond"),
        ({"fps": 0}, "fps must be"),
        ({"width": -3}, "width must be"),
        ({"intrinsics": {"fx": "wide"}}, "fx must be"),
    ],
)
def test_what_is_wrong_with_a_file_is_one_sentence(written: Path, values: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        read_recording(changed(written, **values), CaptureOptions())


@pytest.mark.parametrize("content", ["", "{", "[]", '{"format": "another"}', "a,b\n1,2\n", "\0\1\2"])
def test_a_file_of_no_known_format_is_described(tmp_path: Path, content: str) -> None:
    path = tmp_path / "file.csv"
    path.write_text(content)
    with pytest.raises(InputError, match=r"no hands or keypoints of a program that is known \(.*Points"):
        read_recording(path, CaptureOptions())


@pytest.mark.parametrize("kind", ["keypoints_2d", "keypoints_3d"])
def test_frames_without_the_hand_are_told_from_a_mistake(truth: Take, written: Path, kind: str) -> None:
    """Alone, and beside pictures; and a hand that is in no wanted frame is none of the take."""
    hand = json.loads(written.read_text(encoding="utf-8"))["hands"][0]
    rows = [row if i < 5 else None for i, row in enumerate(hand[kind])]
    changed(written, hands=[{"side": hand["side"], kind: rows}])
    first, last = int(truth.frame_numbers[5]), int(truth.frame_numbers[9])
    for source, more in ((written, {}), (str(SAMPLE / "hand.%04d.jpg"), {"keypoints": written})):
        with pytest.raises(NoHandFoundError, match=f"is in frames {first} to {last}; choose other frames"):
            capture(source, frames=f"{first}-{last}", **more)
    other = "left" if hand["side"] == "right" else "right"
    changed(written, hands=[{"side": hand["side"], kind: rows}, {"side": other, kind: hand[kind]}])
    assert [h.side for h in capture(written, frames=f"{first}-{last}").hands] == [other]


def test_regions_are_no_question_of_keypoints(written: Path) -> None:
    with pytest.raises(OptionError, match=r"either regions.* or keypoints"):
        CaptureOptions(keypoints=str(written), regions=((0, 0, 9, 9),))
    with pytest.raises(OptionError, match="holds no pictures, in whose regions"):
        capture(written, regions=["0,0,9,9"])


def test_the_command_line_converts_and_tells(
    truth: Take, written: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["info", str(written)]) == 0
    assert (
        f"points in space: {truth.hands[0].side} hand in {len(truth.frame_numbers)} frames"
        in capsys.readouterr().out
    )
    take = tmp_path / "hand.take.npz"
    assert main(["convert", str(written), "-o", str(take), "--frames", "1-4", "--progress", "none"]) == 0
    assert is_take(take)
    assert main(["info", str(take)]) == 0
    assert "take of data" in capsys.readouterr().out
    again = tmp_path / "again.points.json"
    assert main(["convert", str(take), "-o", str(again), "--progress", "none"]) == 0
    assert len(json.loads(again.read_text())["frames"]) == 4
    assert main(["convert", str(take), "-o", str(tmp_path / "hand.xyz"), "--progress", "none"]) == 1
    assert "end the name with one of" in capsys.readouterr().err


def two_hands(truth: Take) -> Take:
    """Ten frames; the second hand, of the other side, is in the first three and less certain."""
    take = chosen(truth, "auto", FrameRange(1, 10), None)
    (hand,) = take.hands
    late = np.arange(10) >= 3
    of_frames = {k: np.array(v) for k, v in vars(hand).items() if isinstance(v, np.ndarray) and k != "betas"}
    for name, array in of_frames.items():
        array[late] = False if array.dtype == bool else np.nan
        of_frames[name] = array
    return replace(take, hands=(replace(hand, side=other_side(hand.side), **of_frames), hand))


def test_hands_and_frames_of_a_take_are_chosen(truth: Take, tmp_path: Path) -> None:
    path, out = two_hands(truth).save(tmp_path / "two.take.npz"), tmp_path / "out.take.npz"
    sure, other = truth.hands[0].side, other_side(truth.hands[0].side)
    command = ["convert", str(path), "-o", str(out), "--progress", "none"]

    def made(*options: str) -> Take:
        assert main([*command, *options]) == 0
        return Take.load(out)

    take = made("--hands", other, "--frames", "2-3")
    assert (take.frame_numbers.tolist(), [hand.side for hand in take.hands]) == ([2, 3], [other])
    np.testing.assert_array_equal(take.hands[0].transl, truth.hands[0].transl[1:3])
    assert [Path(file).name for file in take.source.files] == ["hand.0002.jpg", "hand.0003.jpg"]
    assert [hand.side for hand in made("--max-hands", "1").hands] == [sure]
    assert [hand.side for hand in made("--frames", "5-10:2").hands] == [sure]
    assert [hand.side for hand in made().hands] == [other, sure]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--smoothing", "2", "--refit"], "take, which is captured already: leave --smoothing, --refit out"),
        (["--frames", "100-200"], "none of the take's frames lies in 100-200; it has 1 to 10"),
        (["--frames", "7-9", "--hands", "OTHER"], "no OTHER hand in these frames"),
    ],
)
def test_what_a_take_cannot_give_is_one_sentence(
    truth: Take, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], said: str
) -> None:
    path, other = two_hands(truth).save(tmp_path / "two.take.npz"), other_side(truth.hands[0].side)
    options = [option.replace("OTHER", other) for option in options]
    command = ["convert", str(path), "-o", str(tmp_path / "out.take.npz"), "--progress", "none"]
    assert main([*command, *options]) == 1
    assert said.replace("OTHER", other) in capsys.readouterr().err
    assert not (tmp_path / "out.take.npz").exists()


def test_a_take_is_not_captured_again(truth: Take, tmp_path: Path) -> None:
    path = truth.save(tmp_path / "hand.take.npz")
    for source, more in ((path, {}), (str(SAMPLE / "hand.0001.jpg"), {"keypoints": path})):
        with pytest.raises(InputError, match=r"this is a take, which is captured already.*convert"):
            capture(source, **more)


def test_a_batch_takes_such_files_and_tells_takes_from_them(
    truth: Take, written: Path, tmp_path: Path
) -> None:
    assert expand(str(written))[0].source == (str(written),)
    take = truth.save(tmp_path / "hand.take.npz")
    assert expand(str(take))[0].take == take
    other = tmp_path / "other.npz"
    np.savez(other, poses=np.zeros((3, 165)))
    assert (expand(str(other))[0].take, expand(str(other))[0].source) == (None, (str(other),))
    folder = tmp_path / "frames"
    folder.mkdir()
    (folder / "a_000000_keypoints.json").write_text("{}")
    assert is_recording(folder)
    assert expand(str(folder))[0].source == (str(folder),)


def test_more_hands_than_a_take_holds(
    written: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hands = json.loads(written.read_text())["hands"]
    many = changed(written, hands=(hands * 201)[:201])
    (tmp_path / "a.npz").write_text("a good file")
    assert main(["capture", str(many), "-o", str(tmp_path / "a.npz")]) == 1
    assert "there are 201 hands in this input, and a take holds at most 200" in capsys.readouterr().err
    assert (tmp_path / "a.npz").read_text() == "a good file"


def test_more_hands_in_a_frame_than_are_read(written: Path) -> None:
    for hand in (hands := json.loads(written.read_text())["hands"][:1]):
        del hand["keypoints_3d"]
    with pytest.raises(InputError, match="there are 4001 hands in frame"):
        read_recording(changed(written, hands=hands * 4001), CaptureOptions())


def test_an_input_is_not_written_over(written: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good = written.read_bytes()
    for verb in ("capture", "convert"):
        assert main([verb, str(written), "-o", str(written)]) == 1
        assert "this is an input, which stays" in capsys.readouterr().err
    assert written.read_bytes() == good
