"""The take file: round trip, and one clear sentence for every file that is not a take."""

import dataclasses
import json
import os
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.common.arrays import arrays_of, check_arrays, declared
from handfit_core.common.errors import OutputError, TakeError
from handfit_core.common.skeleton import SIDES
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.arm import ArmMotion
from handfit_core.media.source import Source
from handfit_core.take import FORMAT_VERSION, TAKE_LIMITS, HandTrack, Take, at_rows, is_take
from handfit_core.take.found import FoundRows

FRAMES = 4
DETECTED = np.array([True, True, False, True])
SHAPES = {
    "betas": (10,),
    "global_orient": (FRAMES, 3),
    "hand_pose": (FRAMES, 45),
    "transl": (FRAMES, 3),
    "joints_3d": (FRAMES, 21, 3),
    "reprojection_error": (FRAMES,),
}
FOUND = {"keypoints_2d": (FRAMES, 21, 2), "score": (FRAMES,)}
OF_MODEL = ("global_orient", "hand_pose", "transl", "joints_3d")


def track(side: Any = "right", seed: int = 0, **changes: Any) -> HandTrack:
    rng = np.random.default_rng(seed)
    arrays: dict[str, Any] = {name: rng.normal(size=shape) for name, shape in (SHAPES | FOUND).items()}
    for name, array in arrays.items():
        if name != "betas":
            array[~DETECTED] = np.nan
    found = {name: changes.pop(name) for name in declared(FoundRows) if name in changes}
    found = {"detected": DETECTED} | {name: arrays.pop(name) for name in FOUND} | found
    detections = FoundRows(**found).detections("left" if side == "left" else "right")
    return HandTrack(side=side, detections=detections, **(arrays | changes))


def full(**changes: Any) -> HandTrack:
    """A track with all that one may hold; its third frame is filled, its second was named the other side."""
    rng = np.random.default_rng(5)
    arrays: dict[str, Any] = {
        "keypoints_depth": rng.normal(size=(FRAMES, 21)),
        "world_landmarks": rng.normal(size=(FRAMES, 21, 3)) * 0.05,
        "right_side": np.array([0.9, 0.3, 0.0, np.nan]),
        "placed": rng.normal(size=(FRAMES, 21, 2)),
        "touches": np.where(np.arange(21) == 8, 4.0, np.full((FRAMES, 21), np.nan)),
        "expected_error": np.tile(np.linspace(0.004, 0.03, 5), (FRAMES, 1)),
    }
    for array in arrays.values():
        array[~DETECTED] = np.nan
    arrays["expected_error"][0] = np.nan  # corrected by hand
    arrays |= {name: np.nan_to_num(getattr(track(), name), nan=0.5) for name in OF_MODEL}
    flags = {"filled": ~DETECTED, "doubtful": np.arange(FRAMES) == 1, "other_side": np.arange(FRAMES) == 1}
    covered = np.arange(21) > np.array([[21], [5], [21], [21]])
    return track(**{**arrays, **flags, "overlapped": covered, **changes})


def with_arm(present: Any = None) -> HandTrack:
    """A track whose arm is there in two of its frames, or says that it is in others."""
    there = np.array([True, False, False, True])
    rng = np.random.default_rng(6)
    points = {n: rng.normal(size=(FRAMES, 3)) for n in ("shoulder", "elbow", "wrist")}
    arrays = {**points, "expected_error": rng.uniform(size=(FRAMES, 2))}
    for array in arrays.values():
        array[~there] = np.nan
    there = there if present is None else present
    return track(arm=ArmMotion(lengths=np.array([0.3, 0.25]), present=there, **arrays))


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


def message_of(path: Path) -> str:
    with pytest.raises(TakeError) as caught:
        Take.load(path)
    said = str(caught.value)
    assert str(path) in said
    assert "\n" not in said
    assert len(said) < 500 + len(str(path))
    return said


def edited(path: Path, **changes: Any) -> Path:
    """Rewrite a take with arrays and fields of its header changed; a value of None drops the array."""
    with np.load(path) as archive:
        arrays = dict(archive)
    header = json.loads(str(arrays["header"]))
    for name, value in changes.items():
        (arrays if name in arrays else header)[name] = value
    arrays["header"] = np.array(json.dumps(header))
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})
    return path


@pytest.mark.parametrize("compact", [False, True])
def test_round_trip(compact, tmp_path):
    original = take(hands=(full(), track("left", 1)))
    path = original.save(tmp_path / "new folder" / "take.npz", compact=compact)
    loaded = Take.load(path)
    for field in dataclasses.fields(Take):
        if field.name not in ("frame_numbers", "hands"):
            assert getattr(loaded, field.name) == getattr(original, field.name), field.name
    np.testing.assert_array_equal(loaded.frame_numbers, original.frame_numbers)
    assert [h.side for h in loaded.hands] == ["right", "left"]
    pairs = [*zip(loaded.hands, original.hands, strict=True)]
    for found, expected in [*pairs, *((found.rows, expected.rows) for found, expected in pairs)]:
        arrays = arrays_of(expected)
        assert arrays_of(found).keys() == arrays.keys()
        for name, array in arrays.items():
            assert getattr(found, name).dtype == array.dtype, name
            kept = array.astype(np.float32) if compact and array.dtype == np.float64 else array
            np.testing.assert_array_equal(getattr(found, name), kept, err_msg=name)  # also NaN
    for found, _ in pairs:
        np.testing.assert_array_equal(found.present, DETECTED | (found.filled is not None))
    with np.load(path, allow_pickle=False) as archive:
        header = json.loads(str(archive["header"]))
        assert header["version"] == FORMAT_VERSION
        assert "arm" not in "".join([*archive, *header])
    small, whole = original.to_bytes(), original.to_bytes(compact=False)
    assert len(small) < 0.7 * len(whole)
    assert Take.from_bytes(small).to_bytes() == Take.from_bytes(Take.from_bytes(small).to_bytes()).to_bytes()
    assert Take.load(take(hands=()).save(tmp_path / "t.npz")).hands == ()


def test_arms_come_back():
    """Or why there is none; of a hand whose arm nobody looked for, neither."""
    original = take(hands=(track(), with_arm(), track("left", no_arm="no arm: no body is in the picture")))
    loaded = Take.from_bytes(original.to_bytes(compact=False))
    assert [hand.no_arm for hand in loaded.hands] == ["", "", "no arm: no body is in the picture"]
    assert [hand.arm is None for hand in loaded.hands] == [True, False, True]
    found, expected = (arrays_of(each.hands[1].arm or track()) for each in (loaded, original))
    for name, array in expected.items():
        np.testing.assert_array_equal(found[name], array, err_msg=name)
    some = at_rows(loaded.hands[1], np.array([3, 0])).arm
    assert some is not None
    np.testing.assert_array_equal(some.elbow, expected["elbow"][[3, 0]])
    assert at_rows(loaded.hands[1], np.array([1, 2])).arm is None


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"fps": 0.0}, "frame rate"),
        ({"frame_numbers": np.array([7, 9, 9, 12])}, "must increase"),
        ({"frame_numbers": np.array([], dtype=int), "hands": ()}, "at least one frame"),
        ({"source": Source("photo", ())}, "pictures"),
        ({"hands": (track("middle"),)}, "'middle'"),
        (
            {"hands": (full(transl=track().transl),)},
            "the right hand's transl is not finite where the hand is present",
        ),
        (
            {"hands": (with_arm(present=DETECTED),)},
            "the right arm's shoulder is not finite where the hand is present",
        ),
        ({"hands": (track(),) * (TAKE_LIMITS.max_hands + 1)}, "at most 200 hands, not 201"),
    ],
)
def test_what_blender_could_not_build_is_refused(changes, words):
    with pytest.raises(TakeError, match=words):
        take(**changes)


def test_detections():
    hand = full()
    assert hand.refinable
    hands = hand.detections
    check_arrays(hands)
    np.testing.assert_array_equal(hands.frame, np.flatnonzero(DETECTED))
    np.testing.assert_array_equal(hands.overlapped[1], np.arange(21) > 5)
    np.testing.assert_array_equal(hands.keypoints_2d, hand.keypoints_2d[DETECTED])
    np.testing.assert_array_equal(hands.keypoints[..., 2], hand.rows.keypoints_depth[DETECTED])
    np.testing.assert_array_equal(hands.world, hand.rows.world_landmarks[DETECTED])
    np.testing.assert_array_equal(hands.score, hand.score[DETECTED])
    np.testing.assert_array_equal(hands.right_side, [0.9, 0.3, np.nan])
    assert [SIDES[side] for side in hands.side] == ["right", "left", "right"]
    assert SIDES[hands.likely_side[1]] == "right"
    some = hand.detections_at(np.array([3, 2, 1]))
    assert some.frame.tolist() == [0, 2]
    np.testing.assert_array_equal(some.keypoints, hands.keypoints[[2, 1]])


def test_older_takes(tmp_path):
    """Without flags nothing was filled; without detections no frame can be fitted again."""
    path = edited(
        take(hands=(full(),)).save(tmp_path / "t.npz"), hand0_filled=None, hand0_world_landmarks=None
    )
    (hand,) = Take.load(path).hands
    assert hand.filled is None
    np.testing.assert_array_equal(hand.present, hand.detected)
    assert not hand.refinable
    with pytest.raises(TakeError, match="capture it again"):
        hand.detections_at(np.arange(FRAMES))
    plain = full(right_side=None, other_side=None).detections
    assert [SIDES[side] for side in plain.side] == ["right"] * 3
    assert np.isnan(plain.right_side).all()


def test_sources():
    assert Source("photo", ("/a/b/IMG_0042.jpg",)).name == "IMG_0042"
    assert Source("sequence", ("/a/shot_0001.png",)).name == "shot"
    assert Source("sequence", ("/a/clap/0001.png",)).name == "clap"
    with pytest.raises(TakeError, match=r"the paths of 70000 pictures have .* capture fewer frames at once"):
        Source("sequence", ("a" * 1000,) * 70_000)


def source(**changes: Any) -> dict[str, Any]:
    return {"source": {"kind": "photo", "files": ["/a"], "orientation": 1, **changes}}


def camera(**changes: Any) -> dict[str, Any]:
    return {"intrinsics": {"fx": 1.0, "fy": 1.0, "cx": 0.0, "cy": 0.0, **changes}}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"version": FORMAT_VERSION + 1}, "update the add-on"),
        ({"version": "1"}, "not a take file"),
        ({"format": "something else"}, "not a take file"),
        ({"fps": 10**400}, "fps must be a finite number"),
        ({"width": 10**30}, "width must be a whole number"),
        ({"solver": "a" * 1000}, "solver must be a text"),
        ({"model_digests": "abc"}, "model_digests must be an object"),
        ({"sides": None}, "sides must be a list"),
        ({"sides": ["right"] * 100_000}, "sides must be at most"),
        ({"sides": ["right", "left", "right"]}, "it lacks 'hand2_"),
        (camera(fx=-1.0), "focal lengths"),
        (source(kind="clip"), "kind must be one of"),
        (source(files=["\ud800"]), "files must be a text"),
        ({"frame_numbers": np.zeros((4, 2), dtype=int)}, "frame_numbers must be a list"),
        ({"frame_numbers": np.array([1, 2, 3, 2**64 - 1], dtype=np.uint64)}, "frame_numbers lie beyond"),
        ({"hand0_betas": None}, "it lacks 'hand0_betas"),
        ({"arms": ["0"]}, "arms must be an object"),
        ({"arms": {"0": ""}}, "it lacks 'arms/hand0_shoulder"),
        ({"hand0_detected": np.ones(FRAMES)}, "holds float64 as hand0_detected"),
        ({"hand0_keypoints_depth": np.full((FRAMES, 21), np.nan)}, "keypoints_depth is not finite where"),
    ],
    ids=lambda value: str(value)[:60],
)
def test_everything_in_a_file_is_of_its_kind(tmp_path, changes, said):
    both = take(hands=(full(), track("left", 1)))
    assert said in message_of(edited(both.save(tmp_path / "t.npz"), **changes))


def test_other_files_are_not_takes(tmp_path):
    path = tmp_path / "t.npz"
    assert "no such take" in message_of(path)
    np.savez(path, a=np.arange(3))
    for data in (path.read_bytes(), b"", b"PK\x03\x04" + bytes(50), take().to_bytes()[:-30]):
        path.write_bytes(data)
        assert "not a take file" in message_of(path)
        assert not is_take(path)
        with pytest.raises(TakeError, match=r"^the take in shot\.blend: not a take file"):
            Take.from_bytes(data, where="the take in shot.blend")
    assert is_take(take().save(path))
    edited(path, hand0_betas=np.array([{}], dtype=object))  # which would be read by running it
    assert "holds object as hand0_betas" in message_of(path)


def test_truncated_or_damaged_anywhere():
    whole, refused = take().to_bytes(), 0
    for spot in range(0, len(whole), 97):
        with pytest.raises(TakeError):
            Take.from_bytes(whole[:spot])
        damaged = bytearray(whole)
        damaged[spot] ^= 0xFF
        try:
            Take.from_bytes(bytes(damaged))  # dates and the like may change without harm
        except TakeError:
            refused += 1
    assert refused > 0.5 * len(whole) / 97


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_a_take_that_is_no_file(tmp_path):
    """A named pipe would be waited for, and a device has no end."""
    pipe = tmp_path / "t.npz"
    os.mkfifo(pipe)
    assert not is_take(pipe)
    for path in (pipe, Path("/dev/zero")):
        assert "no file, but a pipe" in message_of(path)
    assert "cannot be read" in message_of(tmp_path)
    with pytest.raises(TakeError, match="cannot be read"):
        Take.load("a" * 5000)


def test_a_small_file_takes_no_more_memory_than_small_takes(tmp_path):
    """Members that nobody knows are not read, known ones not beyond what such a take can have, and a zip's
    crowded directory not at all."""
    path, crowded = take().save(tmp_path / "t.npz"), tmp_path / "zip.npz"
    zeros = np.zeros((200_000, 45))  # 72 MB
    hundred = {f"hand{i}_hand_pose": zeros for i in range(100, 103)} | {"what": zeros}
    with np.load(path) as archive:
        np.savez_compressed(path, **dict(archive), **hundred)
    del zeros, hundred
    entry = b"PK\1\2" + bytes(24) + b"\1\0" + bytes(16) + b"x"
    end = b"PK\5\6" + bytes(4) + b"\xff\xff" * 2 + (len(entry) * 400_000).to_bytes(4, "little") + bytes(6)
    crowded.write_bytes(entry * 400_000 + end)
    tracemalloc.start()
    try:
        assert not is_take(crowded)
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
        assert len(Take.load(path).frame_numbers) == FRAMES
        assert tracemalloc.get_traced_memory()[1] < 20_000_000
    finally:
        tracemalloc.stop()


def test_what_is_not_saved(tmp_path):
    """What nobody could read, and what would replace the picture that it was made from."""
    path = take().save(tmp_path / "a.npz")
    good = path.read_bytes()
    with pytest.raises(OutputError, match=r"a\.npz: nothing was written"):
        take(solver="x" * 101).save(path)
    with pytest.raises(OutputError, match="this is an input"):
        take(source=Source("photo", (str(path),))).save(path)
    assert path.read_bytes() == good
