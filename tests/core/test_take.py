"""The take file: round trip, and one clear sentence for every file that is not a take."""

from __future__ import annotations

import dataclasses
import json
import os
import pickle
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.arrays import check_arrays
from handfit_core.errors import OutputError, TakeError
from handfit_core.geometry.camera import Intrinsics
from handfit_core.media.source import Source
from handfit_core.skeleton import SIDES
from handfit_core.take import FORMAT_VERSION, TAKE_LIMITS, HandTrack, Take, is_take

FRAMES = 4
SHAPES = {
    "betas": (10,),
    "global_orient": (FRAMES, 3),
    "hand_pose": (FRAMES, 45),
    "transl": (FRAMES, 3),
    "joints_3d": (FRAMES, 21, 3),
    "keypoints_2d": (FRAMES, 21, 2),
    "reprojection_error": (FRAMES,),
    "score": (FRAMES,),
}


def track(side: Any = "right", seed: int = 0, **changes: Any) -> HandTrack:
    rng = np.random.default_rng(seed)
    arrays: dict[str, Any] = {name: rng.normal(size=shape) for name, shape in SHAPES.items()}
    detected = np.array([True, True, False, True])
    for name, array in arrays.items():
        if name != "betas":
            array[~detected] = np.nan
    return HandTrack(side=side, detected=detected, **(arrays | changes))


def take(**changes: Any) -> Take:
    fields: dict[str, Any] = {
        "source": Source("sequence", ("/shots/Hände 手_0007.png", "/shots/Hände 手_0009.png"), orientation=6),
        "fps": 23.976,
        "frame_numbers": np.array([7, 9, 10, 12]),
        "width": 1920,
        "height": 1080,
        "intrinsics": Intrinsics(1500.5, 1501.5, 960.0, 540.0),
        "solver": "lm",
        "model": "open-hand",
        "model_digests": {"right": "00ff", "left": "aa11"},
        "hands": (track("right"), track("left", 1)),
    }
    return Take(**(fields | changes))


def test_round_trip(tmp_path: Path) -> None:
    original = take()
    path = original.save(tmp_path / "new folder" / "take.npz")
    loaded = Take.load(path)
    for field in dataclasses.fields(Take):
        if field.name not in ("frame_numbers", "hands"):
            assert getattr(loaded, field.name) == getattr(original, field.name), field.name
    np.testing.assert_array_equal(loaded.frame_numbers, original.frame_numbers)
    assert [h.side for h in loaded.hands] == ["right", "left"]
    for ours, theirs in zip(loaded.hands, original.hands, strict=True):
        assert ours.detected.dtype == bool
        np.testing.assert_array_equal(ours.detected, theirs.detected)
        for name in SHAPES:
            # Bit for bit, the NaN of frames without a hand included.
            np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name), err_msg=name)
        assert np.isnan(ours.hand_pose[2]).all()


def test_a_take_without_hands_is_a_take(tmp_path: Path) -> None:
    assert Take.load(take(hands=()).save(tmp_path / "t.npz")).hands == ()


def test_it_is_a_plain_archive_without_pickles(tmp_path: Path) -> None:
    path = take().save(tmp_path / "take.npz")
    with np.load(path, allow_pickle=False) as archive:
        assert all(archive[name].dtype != object for name in archive.files)
        assert json.loads(str(archive["header"]))["version"] == FORMAT_VERSION


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"fps": 0.0}, "frame rate"),
        ({"fps": float("nan")}, "frame rate"),
        ({"width": 0}, "frame rate and size"),
        ({"frame_numbers": np.array([7, 9, 9, 12])}, "must increase"),
        ({"frame_numbers": np.array([], dtype=int), "hands": ()}, "at least one frame"),
        ({"source": Source("photo", ())}, "pictures"),
    ],
)
def test_what_blender_could_not_build_is_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(TakeError, match=words):
        take(**changes)


FILLED = np.array([False, False, True, False])
DOUBTFUL = np.array([False, True, False, False])
OF_MODEL = ("global_orient", "hand_pose", "transl", "joints_3d")
AS_SEEN = ("keypoints_2d", "reprojection_error", "score")


def bridged(**changes: Any) -> HandTrack:
    """A track whose third frame was not detected, and filled."""
    whole: dict[str, Any] = {name: np.nan_to_num(getattr(track(), name), nan=0.5) for name in OF_MODEL}
    return track(**{**whole, "filled": FILLED, "doubtful": DOUBTFUL, **changes})


def test_filled_and_doubtful_frames_come_back(tmp_path: Path) -> None:
    loaded = Take.load(take(hands=(bridged(), track("left"))).save(tmp_path / "t.npz"))
    ours, plain = loaded.hands
    for flags, expected in ((ours.filled, FILLED), (ours.doubtful, DOUBTFUL)):
        assert flags is not None
        assert flags.dtype == bool
        np.testing.assert_array_equal(flags, expected)
    np.testing.assert_array_equal(ours.present, [True, True, True, True])
    assert np.isfinite(ours.transl).all()
    assert all(np.isnan(getattr(ours, name)[2]).all() for name in AS_SEEN)
    # None stays None.
    assert plain.filled is None
    assert plain.doubtful is None
    np.testing.assert_array_equal(plain.present, plain.detected)


def test_expected_errors_come_back_finger_by_finger(tmp_path: Path) -> None:
    expected = np.where(track().detected[:, None], np.linspace(0.004, 0.03, 5), np.nan)
    expected[0] = np.nan  # corrected by hand
    loaded = Take.load(take(hands=(track(expected_error=expected), track("left"))).save(tmp_path / "t.npz"))
    np.testing.assert_array_equal(loaded.hands[0].expected_error, expected)
    assert loaded.hands[1].expected_error is None, "a take that an older version made has none"


def test_takes_from_before_there_were_flags(tmp_path: Path) -> None:
    path = edited(take(hands=(bridged(),)).save(tmp_path / "t.npz"), hand0_filled=None, hand0_doubtful=None)
    (hand,) = Take.load(path).hands
    assert hand.filled is None
    assert hand.doubtful is None
    np.testing.assert_array_equal(hand.present, hand.detected)


def test_a_filled_frame_has_a_pose() -> None:
    with pytest.raises(TakeError, match="the right hand's transl is not finite where the hand is present"):
        take(hands=(bridged(transl=track().transl),))


DETECTED = np.array([True, True, False, True])


def as_detected(**changes: Any) -> HandTrack:
    """A track that holds what the detector found; its second frame was named the other side."""
    rng = np.random.default_rng(5)
    arrays: dict[str, Any] = {
        "keypoints_depth": rng.normal(size=(FRAMES, 21)),
        "world_landmarks": rng.normal(size=(FRAMES, 21, 3)) * 0.05,
        "right_side": np.array([0.9, 0.3, 0.0, np.nan]),
        "placed": rng.normal(size=(FRAMES, 21, 2)),
        "touches": np.where(np.arange(21) == 8, 4.0, np.full((FRAMES, 21), np.nan)),
    }
    for array in arrays.values():
        array[~DETECTED] = np.nan
    covered = np.arange(21) > np.array([[21], [5], [21], [21]])
    return track(
        **{**arrays, "other_side": np.array([False, True, False, False]), "overlapped": covered, **changes}
    )


def test_what_the_detector_found_comes_back(tmp_path: Path) -> None:
    original = as_detected()
    (hand, old) = Take.load(take(hands=(original, track("left"))).save(tmp_path / "t.npz")).hands
    assert hand.refinable
    for name in (
        "keypoints_depth",
        "world_landmarks",
        "right_side",
        "other_side",
        "overlapped",
        "placed",
        "touches",
    ):
        np.testing.assert_array_equal(getattr(hand, name), getattr(original, name), err_msg=name)
        assert getattr(old, name) is None
    hands = hand.detections()
    check_arrays(hands)
    assert original.keypoints_depth is not None
    assert original.world_landmarks is not None
    assert hands.overlapped is not None
    np.testing.assert_array_equal(hands.frame, np.flatnonzero(DETECTED))
    np.testing.assert_array_equal(hands.overlapped[1], np.arange(21) > 5)
    np.testing.assert_array_equal(hands.keypoints_2d, original.keypoints_2d[DETECTED])
    np.testing.assert_array_equal(hands.keypoints[..., 2], original.keypoints_depth[DETECTED])
    np.testing.assert_array_equal(hands.world, original.world_landmarks[DETECTED])
    np.testing.assert_array_equal(hands.score, original.score[DETECTED])
    np.testing.assert_array_equal(hands.right_side, [0.9, 0.3, np.nan])
    assert [SIDES[side] for side in hands.side] == ["right", "left", "right"]
    assert SIDES[hands.likely_side[1]] == "right"
    some = hand.detections(np.array([3, 2, 1]))
    assert some.frame.tolist() == [0, 2]
    np.testing.assert_array_equal(some.keypoints, hands.keypoints[[2, 1]])


def test_older_takes_cannot_be_fitted_again(tmp_path: Path) -> None:
    (hand,) = Take.load(take(hands=(track(),)).save(tmp_path / "t.npz")).hands
    assert not hand.refinable
    with pytest.raises(TakeError, match="capture it again"):
        hand.detections()
    assert not dataclasses.replace(as_detected(), world_landmarks=None).refinable
    plain = dataclasses.replace(as_detected(), right_side=None, other_side=None).detections()
    assert [SIDES[side] for side in plain.side] == ["right"] * 3
    assert np.isnan(plain.right_side).all()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"keypoints_depth": np.zeros((FRAMES, 20))}, "keypoints_depth has shape"),
        ({"keypoints_depth": np.full((FRAMES, 21), np.nan)}, "keypoints_depth is not finite"),
        ({"right_side": np.full(FRAMES, 1.5)}, "right_side must lie between 0 and 1"),
    ],
    ids=str,
)
def test_what_the_detector_found_is_checked(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    with pytest.raises(TakeError, match=said):
        take(hands=(as_detected(**changes),))
    path = take(hands=(as_detected(),)).save(tmp_path / "t.npz")
    name, array = next(iter(changes.items()))
    assert said in message_of(edited(path, **{f"hand0_{name}": array}))


def test_compact_bytes_come_back_in_32_bits() -> None:
    original = take(hands=(as_detected(), track("left", 1)))
    back = Take.from_bytes(original.to_bytes())
    assert back.source == original.source
    assert back.intrinsics == original.intrinsics
    np.testing.assert_array_equal(back.frame_numbers, original.frame_numbers)
    for ours, theirs in zip(back.hands, original.hands, strict=True):
        for field in dataclasses.fields(HandTrack):
            found, expected = getattr(ours, field.name), getattr(theirs, field.name)
            if expected is None or field.name == "side":
                assert found == expected
                continue
            assert found.dtype == expected.dtype, field.name
            kept = expected.astype(np.float32) if found.dtype == np.float64 else expected
            np.testing.assert_array_equal(found, kept, err_msg=field.name)


def test_compact_bytes_are_much_smaller_and_deterministic_in_content() -> None:
    original = take(hands=(as_detected(), track("left", 1)))
    small, whole = original.to_bytes(), original.to_bytes(compact=False)
    assert len(small) < 0.7 * len(whole)
    # Compact once is compact for good.
    assert Take.from_bytes(small).to_bytes() == Take.from_bytes(Take.from_bytes(small).to_bytes()).to_bytes()


def test_bytes_that_are_no_take() -> None:
    for data in (b"", b"hello", take().to_bytes()[:-30]):
        with pytest.raises(TakeError, match=r"^the take in shot\.blend: not a take file"):
            Take.from_bytes(data, where="the take in shot.blend")


def test_wrong_sides_are_refused() -> None:
    with pytest.raises(TakeError, match="'middle'"):
        take(hands=(track("middle"),))


def test_source_names() -> None:
    assert Source("photo", ("/a/b/IMG_0042.jpg",)).name == "IMG_0042"
    assert Source("sequence", ("/a/shot_0001.png",)).name == "shot"
    assert Source("sequence", ("/a/clap/0001.png",)).name == "clap"


def message_of(path: Path) -> str:
    with pytest.raises(TakeError) as caught:
        Take.load(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def edited(path: Path, **changes: Any) -> Path:
    """Rewrite a take with header fields changed; a value of None drops the array of that name."""
    with np.load(path) as archive:
        arrays = dict(archive)
    header = json.loads(str(arrays["header"]))
    for name, value in changes.items():
        if name in arrays:
            if value is None:
                del arrays[name]
            else:
                arrays[name] = value
        else:
            header[name] = value
    arrays["header"] = np.array(json.dumps(header))
    np.savez(path, **arrays)
    return path


def test_a_newer_version_says_update(tmp_path: Path) -> None:
    path = edited(take().save(tmp_path / "t.npz"), version=FORMAT_VERSION + 1)
    assert "update the add-on" in message_of(path)


@pytest.mark.parametrize(
    "changes",
    [
        {"hand0_betas": None},
        {"hand1_score": None},
        {"frame_numbers": None},
        {"frame_numbers": np.zeros((4, 2))},
        {"frame_numbers": np.arange(5)},
        {"hand0_transl": np.zeros((4, 2))},
        {"sides": None},
        {"sides": ["right", "left", "right"]},
        {"sides": ["up", "left"]},
        {"fps": "fast"},
        {"source": "a photo"},
        {"intrinsics": {"fx": 1.0}},
        {"intrinsics": {"fx": -1.0, "fy": 1.0, "cx": 0.0, "cy": 0.0}},
    ],
    ids=str,
)
def test_incomplete_takes(tmp_path: Path, changes: dict[str, Any]) -> None:
    assert "capture it again" in message_of(edited(take().save(tmp_path / "t.npz"), **changes))


def test_other_files_are_not_takes(tmp_path: Path) -> None:
    path = tmp_path / "t.npz"
    assert "no such take" in message_of(path)
    for data in (b"", b"hello", b"PK\x03\x04" + bytes(50), pickle.dumps({"a": 1})):
        path.write_bytes(data)
        assert "not a take file" in message_of(path)
    np.savez(path, a=np.arange(3))
    assert "not a take file" in message_of(path)
    with path.open("wb") as stream:
        np.save(stream, np.arange(3))
    assert "not a take file" in message_of(path)
    assert "not a take file" in message_of(edited(take().save(path), format="something else"))


def test_pickles_inside_are_not_run(tmp_path: Path) -> None:
    trace = tmp_path / "trace"

    class Evil:
        def __reduce__(self) -> Any:
            return (exec, (f"open({str(trace)!r}, 'w').close()",))

    path = edited(take().save(tmp_path / "t.npz"), hand0_betas=np.array([Evil()], dtype=object))
    assert "holds object as hand0_betas" in message_of(path)
    assert not trace.exists()


def test_truncated_or_damaged_anywhere(tmp_path: Path) -> None:
    whole = take().save(tmp_path / "whole.npz").read_bytes()
    path = tmp_path / "t.npz"
    for end in range(0, len(whole), 199):
        path.write_bytes(whole[:end])
        message_of(path)
    refused = 0
    for spot in range(0, len(whole), 61):
        for flip in (0x01, 0xFF):
            damaged = bytearray(whole)
            damaged[spot] ^= flip
            path.write_bytes(damaged)
            try:
                Take.load(path)  # dates and the like may change without harm
            except TakeError:
                refused += 1
    assert refused > len(whole) / 61


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"version": "1"}, "not a take file"),
        ({"version": True}, "not a take file"),
        ({"version": 0}, "not a take file"),
        ({"fps": True}, "fps must be a finite number"),
        ({"fps": 10**400}, "fps must be a finite number"),
        ({"fps": float("inf")}, "fps must be a finite number"),
        ({"fps": 1e-300}, "frame rate"),
        ({"width": 10**30}, "width must be a whole number"),
        ({"width": 2**40}, "frame rate and size"),
        ({"height": 720.5}, "height must be a whole number"),
        ({"solver": ["fast"]}, "solver must be a text"),
        ({"solver": "a" * 1000}, "solver must be a text"),
        ({"model": None}, "model must be a text"),
        ({"model": "a\0b"}, "model must be a text"),
        ({"model": "a" * 100_000}, "model must be a text"),
        ({"model_digests": "abc"}, "model_digests must be an object"),
        ({"model_digests": {"left": 3}}, "model_digests must be a text"),
        ({"sides": "right"}, "sides must be a list"),
        ({"sides": [["right"], {}]}, "sides must be"),
        ({"sides": ["right"] * 100_000}, "sides must be at most"),
        ({"intrinsics": {"fx": "1", "fy": 1.0, "cx": 0.0, "cy": 0.0}}, "fx must be a finite number"),
        ({"intrinsics": {"fx": 1.0, "fy": 1.0, "cx": 0.0, "cy": 0.0, "k1": 0.0}}, "intrinsics must be"),
        ({"source": {"kind": "clip", "files": ["/a"], "orientation": 1}}, "kind must be one of"),
        ({"source": {"kind": "photo", "files": "/a", "orientation": 1}}, "files must be a list"),
        ({"source": {"kind": "photo", "files": [3], "orientation": 1}}, "files must be a text"),
        ({"source": {"kind": "photo", "files": ["\ud800"], "orientation": 1}}, "files must be a text"),
        ({"source": {"kind": "photo", "files": ["/a"], "orientation": 9}}, "orientation must be"),
        ({"frame_numbers": np.array([1.0, 2.0, 3.0, 4.0])}, "frame_numbers"),
        ({"frame_numbers": np.array([1, 2, 3, 2**63 - 1])}, "frame_numbers lie beyond"),
        ({"frame_numbers": np.array([1, 2, 3, 2**64 - 1], dtype=np.uint64)}, "frame_numbers lie beyond"),
        ({"frame_numbers": np.array([-(2**63), 0, 1, 2**62])}, "frame_numbers lie beyond"),
        ({"hand0_betas": np.full(10, 1e6)}, "betas holds numbers beyond"),
        ({"hand0_betas": np.arange(10)}, "holds int64 as hand0_betas"),
        ({"hand0_detected": np.ones(FRAMES)}, "holds float64 as hand0_detected"),
        ({"hand0_transl": np.full((FRAMES, 3), 1e12)}, "transl holds numbers beyond"),
        ({"hand0_score": np.array(["1.0"] * FRAMES)}, "as hand0_score"),
    ],
    ids=lambda value: str(value)[:60],
)
def test_everything_in_a_file_is_of_its_kind(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    message = message_of(edited(take().save(tmp_path / "t.npz"), **changes))
    assert said in message
    assert len(message) < 500 + len(str(tmp_path))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_a_take_that_is_no_file(tmp_path: Path) -> None:
    """A named pipe would be waited for, and a device has no end."""
    pipe = tmp_path / "t.npz"
    os.mkfifo(pipe)
    assert "no file, but a pipe" in message_of(pipe)
    assert "no file, but a pipe" in message_of(Path("/dev/zero"))
    assert "cannot be read" in message_of(tmp_path)
    with pytest.raises(TakeError, match="cannot be read"):
        Take.load("a" * 5000)


def test_what_is_saved_of_a_very_long_sequence_can_be_read() -> None:
    files = tuple(f"/shots/{'a long folder name ' * 9}/frame.{number:08d}.png" for number in range(150_000))
    source = Source("sequence", files)
    assert Take.from_bytes(take(source=source).to_bytes()).source == source
    with pytest.raises(TakeError, match=r"the paths of 70000 pictures have .* capture fewer frames at once"):
        Source("sequence", ("a" * 1000,) * 70_000)


def test_a_small_file_takes_no_more_memory_than_small_takes(tmp_path: Path) -> None:
    """Members that nobody knows are not read, and known ones not beyond what such a take can have."""
    path = take().save(tmp_path / "t.npz")
    zeros = np.zeros((200_000, 45))  # 72 MB
    hundred = {f"hand{i}_hand_pose": zeros for i in range(100, 103)} | {"what": zeros}
    with np.load(path) as archive:
        np.savez_compressed(path, **dict(archive), **hundred)
    del zeros, hundred
    tracemalloc.start()
    try:
        assert len(Take.load(path).frame_numbers) == FRAMES
        assert tracemalloc.get_traced_memory()[1] < 20_000_000
    finally:
        tracemalloc.stop()


def test_a_take_holds_so_many_hands(tmp_path: Path) -> None:
    hand = track()
    assert (
        len(Take.load(take(hands=(hand,) * TAKE_LIMITS.max_hands).save(tmp_path / "a.npz")).hands)
        == TAKE_LIMITS.max_hands
    )
    with pytest.raises(TakeError, match="at most 200 hands, not 201"):
        take(hands=(hand,) * (TAKE_LIMITS.max_hands + 1))


def test_what_nobody_could_read_is_not_saved(tmp_path: Path) -> None:
    path = take().save(tmp_path / "a.npz")
    good = path.read_bytes()
    with pytest.raises(OutputError, match=r"a\.npz: nothing was written"):
        take(solver="x" * 101).save(path)
    assert path.read_bytes() == good


def test_a_take_is_not_saved_over_its_picture(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_text("a picture")
    with pytest.raises(OutputError, match="this is an input"):
        take(source=Source("photo", (str(tmp_path / "a.png"),))).save(tmp_path / "a.png")
    assert (tmp_path / "a.png").read_text() == "a picture"


@pytest.mark.skipif(os.name == "nt", reason="needs pipes with names")
def test_a_pipe_and_a_crowded_zip_are_no_takes(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.npz")
    assert not is_take(tmp_path / "pipe.npz")
    entry = b"PK\1\2" + bytes(24) + b"\1\0" + bytes(16) + b"x"
    end = b"PK\5\6" + bytes(4) + b"\xff\xff" * 2 + (len(entry) * 400_000).to_bytes(4, "little") + bytes(6)
    (tmp_path / "zip.npz").write_bytes(entry * 400_000 + end)
    tracemalloc.start()
    try:
        assert not is_take(tmp_path / "zip.npz")
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()
    assert is_take(take().save(tmp_path / "a.npz"))
