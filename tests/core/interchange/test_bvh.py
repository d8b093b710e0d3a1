"""BVH: fingers of skeletons with many names and rest poses, and our own with MotionBuilder's names."""

from __future__ import annotations

from itertools import cycle
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from handfit_core.capturing.pipeline import capture
from handfit_core.common.errors import HandfitError, InputError
from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, SIDES, Side
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.interchange.formats.bvh import WRITER
from handfit_core.interchange.opening import read_recording
from handfit_core.interchange.recording import Recording
from handfit_core.retarget.bones import Bones
from handfit_core.retarget.transfer import palm_frame
from handfit_core.take import Take
from tests.core.interchange.known_hands import HANDS
from tests.core.retarget.rigs import OTHERS, RIGS, TIPS, Built, Rig, add_hand, body, names_of
from tests.takes import take_of, track_of

CAMERA = Intrinsics(1000.0, 1000.0, 640.0, 360.0)
FRAMES = 5


def take(betas: np.ndarray | None = None) -> Take:
    """Both hands, turned every way."""
    rows, shape = slice(FRAMES), {} if betas is None else {"betas": betas}
    hands = [
        track_of(side, 2.0 * h.global_orient[rows], h.hand_pose[rows], h.transl[rows], CAMERA, **shape)
        for side, h in HANDS.items()
    ]
    return take_of(hands, CAMERA, 1280, 720, fps=30.0, frame_numbers=np.arange(3, 3 + FRAMES))


def text_of(bones: Bones, turns: np.ndarray, order: str = "ZYX") -> str:
    """A BVH file, the bones (T, B, 3, 3) turned relative to their parents; written for the tests, so that a
    mistake in the package's own is not made twice."""
    lines = ["HIERARCHY"]
    row: list[int] = []

    def add(bone: int) -> None:
        row.append(bone)
        parent = int(bones.parents[bone])
        offset = (bones.heads[bone] - (bones.heads[parent] if parent >= 0 else 0.0)) * 100.0
        lines.extend([f"{'JOINT' if parent >= 0 else 'ROOT'} {bones.names[bone]}", "{"])
        lines.append("OFFSET " + " ".join(f"{x:.9f}" for x in offset))
        named = " ".join(f"{axis}rotation" for axis in order)
        lines.append(
            f"CHANNELS 6 Xposition Yposition Zposition {named}" if parent < 0 else f"CHANNELS 3 {named}"
        )
        for child in bones.children[bone]:
            add(child)
        if not bones.children[bone]:
            lines.extend(["End Site", "{", "OFFSET 0 0 0", "}"])
        lines.append("}")

    add(0)
    lines += ["MOTION", f"Frames: {len(turns)}", "Frame Time: 0.04"]
    for frame in turns:
        numbers = [*(bones.heads[0] * 100.0)]
        for bone in row:
            numbers += Rotation.from_matrix(frame[bone]).as_euler(order, degrees=True).tolist()
        lines.append(" ".join(f"{x:.9f}" for x in numbers))
    return "\n".join(lines)


def read(tmp_path: Path, text: str) -> Recording:
    path = tmp_path / "hand.bvh"
    path.write_text(text, encoding="utf-8")
    return read_recording(path)


def still(bones: Bones) -> np.ndarray:
    return np.broadcast_to(np.eye(3), (FRAMES, len(bones.names), 3, 3))


def in_palm(joints: np.ndarray, tips: np.ndarray, side: Side) -> np.ndarray:
    """(15, 3) directions of fingers' bones in their hand's own palm, from (16, 3) joints and (5, 3) tips."""
    knuckles = {f: joints[FINGER_JOINTS[f][0]] for f in FINGERS}
    frame, _ = palm_frame(joints[0], knuckles, side)
    ends = np.concatenate([joints, tips])
    steps = [
        ends[b] - ends[a]
        for f, finger in enumerate(FINGERS)
        for a, b in zip(FINGER_JOINTS[finger], (*FINGER_JOINTS[finger][1:], 16 + f), strict=True)
    ]
    return np.array([step / np.linalg.norm(step) @ frame for step in steps])


@pytest.mark.parametrize("betas", [None, np.linspace(-1.5, 1.5, 10)])
def test_our_own_comes_back(tmp_path: Path, betas: np.ndarray | None) -> None:
    true = take(betas)
    WRITER.write(true, tmp_path / "out.bvh")
    again = capture(tmp_path / "out.bvh")
    assert again.fps == pytest.approx(30.0)
    for hand in again.hands:
        (was,) = (track for track in true.hands if track.side == hand.side)
        exact = 1e-5 if betas is None else 2e-3
        np.testing.assert_allclose(hand.betas, was.betas, atol=1e-3)
        for name in ("hand_pose", "global_orient"):
            own, theirs = (rotvec_to_rotmat(np.reshape(getattr(one, name), (-1, 3))) for one in (hand, was))
            np.testing.assert_allclose(own, theirs, atol=exact, err_msg=name)
        moved = hand.joints_3d - hand.joints_3d[:1, :1]
        model = load_model(None, hand.side)
        truth = model.keypoints(was.betas, was.global_orient, was.hand_pose, was.transl)
        np.testing.assert_allclose(moved, truth - truth[:1, :1], atol=1e-4)


@pytest.mark.parametrize(
    ("rig", "order"), zip([*RIGS[1:6], *OTHERS], cycle(["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"]))
)
@pytest.mark.parametrize("bend", [0.0, 0.4])
def test_any_rest_pose_names_and_order(tmp_path: Path, rig: Rig, order: str, bend: float) -> None:
    """Fingers point where the file's own do, by a forward pass over its bones: that is what a rest pose that
    is not ours must not change."""
    built, rng = Built(), np.random.default_rng(7)
    named = {side: {s: n.replace(" ", "_") for s, n in names_of(rig, side).items()} for side in SIDES}
    for side in SIDES:
        fore, place = body(built, side)
        add_hand(built, side, named[side], rng, parent=fore, place=place, bend=bend, stretch=0.1, tips=True)
    bones = built.bones()
    turns = still(bones).copy()
    moved = [bones.index[named[side][joint]] for side in SIDES for joint in range(16)]
    turns[:, moved] = rotvec_to_rotmat(rng.uniform(-0.3, 0.3, (FRAMES, len(moved), 3)))
    places, turned = np.empty((FRAMES, len(bones.names), 3)), np.empty_like(turns)
    for bone, parent in enumerate(bones.parents.tolist()):
        step = bones.heads[bone] - (bones.heads[parent] if parent >= 0 else 0.0)
        places[:, bone] = step if parent < 0 else places[:, parent] + turned[:, parent] @ step
        turned[:, bone] = turns[:, bone] if parent < 0 else turned[:, parent] @ turns[:, bone]
    for hand in read(tmp_path, text_of(bones, turns, order)).posed:
        names, zero = named[hand.side], np.zeros((FRAMES, 3))
        at = [bones.index[names[joint]] for joint in range(16)]
        ends = (f"{names[joints[2]]}_tip" for joints in FINGER_JOINTS.values())
        tips = [bones.index[names.get(TIPS + finger, end)] for finger, end in enumerate(ends)]
        posed = load_model(None, hand.side).posed(None, zero, hand.hand_pose, zero)
        for row in range(FRAMES):
            theirs = in_palm(places[row, at], places[row, tips], hand.side)
            ours = in_palm(posed.joints[row], posed.keypoints[row, 4::4], hand.side)
            angle = np.degrees(np.arccos(np.clip((theirs * ours).sum(axis=1), -1.0, 1.0)))
            assert np.delete(angle, [2, 5, 8, 11, 14]).max() < 0.01, (row, angle)


@pytest.fixture
def own(tmp_path: Path) -> str:
    """What this program writes."""
    WRITER.write(take(), tmp_path / "own.bvh")
    return (tmp_path / "own.bvh").read_text()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t[:-200], "cut off"),
        (lambda t: t.replace("MOTION", "MOVES"), "no MOTION"),
        (lambda t: t.replace("Frames: 5", "Frames: 999999999"), "999999999 frames"),
        (lambda t: t[: t.rstrip().rindex(" ")] + " 1e300\n", "too large"),
    ],
)
def test_bad_files_are_named_in_a_sentence(tmp_path: Path, own: str, change, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read(tmp_path, change(own))


def test_other_names_and_blank_lines(tmp_path: Path, own: str) -> None:
    """Hands are known by their structure, too."""
    renamed = own.replace("Thumb", "Tail").replace("Index", "Toe").replace("Hand", "Foo")
    for text in (renamed, own.replace("MOTION", "\n\n  Motion \n\n")):
        assert len(read(tmp_path, text).posed) == 2


@pytest.mark.parametrize("mittens", [False, True])
def test_bodies_without_fingers(tmp_path: Path, mittens: bool) -> None:
    """And as in the motions of Carnegie Mellon's library, whose fingers begin in the wrist: LThumb, and
    LeftFingerBase with LeftHandIndex1."""
    built = Built()
    for side in SIDES:
        fore, place = body(built, side)
        if mittens:
            name, out = side.title(), np.array([0.01 if side == "left" else -0.01, 0.0, 0.0])
            hand = built.add(f"{name}Hand", fore, place)
            base = built.add(f"{name}FingerBase", hand, place)
            built.add(f"{name}HandIndex1", base, place + out)
            built.add(f"{name[0]}Thumb", hand, place)
    bones = built.bones()
    with np.errstate(all="raise"), pytest.raises(InputError, match="a hand with two fingers"):
        read(tmp_path, text_of(bones, still(bones)))


def test_radians_and_still_fingers_are_pointed_out(tmp_path: Path, own: str) -> None:
    head, _, motion = own.partition("Frame Time:")
    time, *lines = motion.splitlines()
    numbers = np.radians([[*map(float, line.split())] for line in lines])
    numbers = (numbers + np.pi) % (2.0 * np.pi) - np.pi
    radians = [" ".join(f"{x:.9f}" for x in row) for row in numbers]
    for rows, words, count in ((radians, "radians", 1), (lines[:1] * 5, "do not move", 2)):
        assumed = read(tmp_path, "\n".join([f"{head}Frame Time:{time}", *rows, ""])).assumed
        assert sum(words in phrase for phrase in assumed) >= count


def test_two_hands_of_a_side_are_refused(tmp_path: Path) -> None:
    one = take()
    twice = take_of([one.hands[0], one.hands[0]], CAMERA, 1280, 720, frame_numbers=one.frame_numbers)
    with pytest.raises(HandfitError, match="one of each side"):
        WRITER.write(twice, tmp_path / "x.bvh")


def test_frames_that_are_far_apart_are_not_filled(tmp_path: Path) -> None:
    """As names of pictures may have them; and every second frame is a file of half the rate."""
    true = take()
    for numbers, count, seconds in (
        (np.array([1, 2, 3, 4, 20_000]), 5, 1 / 30),
        (2 * np.arange(FRAMES), FRAMES, 2 / 30),
        (np.array([1, 2, 3, 4, 8]), 8, 1 / 30),
    ):
        one = take_of(true.hands, CAMERA, 1280, 720, fps=30.0, frame_numbers=numbers)
        WRITER.write(one, tmp_path / "far.bvh")
        text = (tmp_path / "far.bvh").read_text()
        assert f"\nFrames: {count}\nFrame Time: {seconds:.9g}\n" in text
        assert len(text.partition("Frame Time")[2].splitlines()) == count + 1
