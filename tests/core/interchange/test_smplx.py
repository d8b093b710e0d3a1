"""SMPL-X and SMPL+H animations, and parameters under smplx's names; written ones are read by smplx."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.__main__ import main
from handfit_core.errors import InputError, OptionError
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.interchange.recording import usual_place
from handfit_core.interchange.skeletons import UP_AXES
from handfit_core.interchange.writers import writer_for
from handfit_core.media.frame_range import FrameRange
from handfit_core.pipeline import capture
from handfit_core.skeleton import SIDES, Side
from handfit_core.take import Take, chosen
from tests.core.interchange.known_hands import (
    EXACT,
    FRAMES,
    HANDS,
    assert_same_hand,
    assert_same_turns,
    hand_of,
    matrices,
    mean_of,
    own_mano,
    read,
    says,
)
from tests.imitation_mano import imitation_arrays

CHAINS: dict[Side, list[str]] = {
    side: [
        "spine1",
        "spine2",
        "spine3",
        *(f"{side}_{part}" for part in ("collar", "shoulder", "elbow", "wrist")),
    ]
    for side in SIDES
}
JOINTS = (
    "pelvis left_hip right_hip spine1 left_knee right_knee spine2 left_ankle right_ankle spine3 left_foot "
    "right_foot neck left_collar right_collar head left_shoulder right_shoulder left_elbow right_elbow "
    "left_wrist right_wrist"
).split()
"""Of a body, as smplx's joint_names.py has them"""


def body(turn: np.ndarray, seed: int = 0) -> np.ndarray:
    """(T, 66) of a body that stands upright in the world that `turn` brings before the camera, and whose
    wrists are turned as `HANDS`: the wrist's own rotation makes up for the random joints before it."""
    rng = np.random.default_rng(seed)
    poses = rng.uniform(-0.3, 0.3, (FRAMES, 22, 3))
    upright = turn.T @ UP_AXES["y"]  # SMPL's rest is y-up
    poses[:, 0] = rotmat_to_rotvec(upright @ rotvec_to_rotmat(rng.uniform(-0.2, 0.2, (FRAMES, 3))))
    for side, names in CHAINS.items():
        before = rotvec_to_rotmat(poses[:, 0])
        for name in names[:-1]:
            before = before @ rotvec_to_rotmat(poses[:, JOINTS.index(name)])
        wanted = turn.T @ rotvec_to_rotmat(HANDS[side].global_orient)
        poses[:, JOINTS.index(names[-1])] = rotmat_to_rotvec(np.swapaxes(before, -1, -2) @ wanted)
    return poses.reshape(FRAMES, 66)


def amass(path: Path, joints: int, turn: np.ndarray, **changes: Any) -> Path:
    """An animation as AMASS has it: of 52 joints (SMPL+H) or 55 (SMPL-X)."""
    between = np.zeros((FRAMES, 3 * (joints - 52)))
    hands = [HANDS[side].hand_pose for side in SIDES]
    arrays: dict[str, Any] = {
        "poses": np.concatenate([body(turn), between, *hands], axis=1),
        "trans": np.zeros((FRAMES, 3)),
        "betas": np.zeros(16),
        "gender": np.array("female"),
        "mocap_frame_rate" if joints == 55 else "mocap_framerate": np.array(120.0),
        **changes,
    }
    np.savez(path, **{name: value for name, value in arrays.items() if value is not None})
    return path


@pytest.mark.parametrize(
    ("turn", "up"), [(UP_AXES["y"], "y-up"), (UP_AXES["z"], "z-up"), (np.eye(3), "camera's")]
)
@pytest.mark.parametrize("joints", [52, 55])
def test_hands_of_a_body(tmp_path: Path, joints: int, turn: np.ndarray, up: str) -> None:
    recording = read(amass(tmp_path / "a.npz", joints, turn))
    assert (recording.format, recording.fps) == ("smplx", 120.0)
    for side in SIDES:
        assert_same_hand(hand_of(recording, side), HANDS[side], placed=False)
        np.testing.assert_array_equal(hand_of(recording, side).transl, [usual_place(side)] * FRAMES)
    assert says(recording, f"taken to be {'the ' if up == 'camera' else ''}{up}" if up != "camera's" else up)
    assert says(recording, "where the wrists are is not known")


def test_the_fingers_of_a_body_in_parts(tmp_path: Path) -> None:
    """As AMASS' SMPL-X files have them besides poses."""
    whole = body(UP_AXES["z"])
    path = tmp_path / "a.npz"
    np.savez(
        path,
        root_orient=whole[:, :3],
        pose_body=whole[:, 3:],
        pose_hand=np.concatenate([HANDS[side].hand_pose for side in SIDES], axis=1),
        trans=np.zeros((FRAMES, 3)),
        mocap_frame_rate=60,
    )
    recording = read(path)
    assert recording.format == "smplx"
    for side in SIDES:
        assert_same_hand(hand_of(recording, side), HANDS[side], placed=False)


def test_the_order_of_little_and_ring(tmp_path: Path) -> None:
    """SMPL-X has the little finger before the ring finger, as MANO: joint 6 bends the little finger."""
    pose = np.zeros((FRAMES, 165))
    pose[:, :3] = rotmat_to_rotvec(np.eye(3))
    pose[:, 120 + 18 + 2] = 1.0  # right_pinky1 is joint 40 + 6
    path = amass(tmp_path / "a.npz", 55, UP_AXES["y"], poses=pose)
    take = capture(path)
    points = take.hands[[hand.side for hand in take.hands].index("right")].joints_3d[0]
    rest = load_model(None, "right").keypoints(None, np.zeros(3), np.zeros(45), np.zeros(3))
    moved = np.linalg.norm(
        (points - points[0]) - (rest - rest[0]) @ rotvec_to_rotmat(take.hands[-1].global_orient[0]).T, axis=1
    )
    assert moved[20] > 0.03
    assert moved[16] < 1e-6


def test_fingers_that_never_move_are_told(tmp_path: Path) -> None:
    """As in the many files of AMASS whose markers were on the body alone."""
    poses = np.zeros((FRAMES, 156))
    poses[:, 66:] = np.tile(HANDS["left"].hand_pose[0], 2)
    assert says(read(amass(tmp_path / "a.npz", 52, UP_AXES["y"], poses=poses)), "the fingers never move")
    assert not says(read(amass(tmp_path / "b.npz", 52, UP_AXES["y"])), "never move")


def test_hands_without_a_place_are_apart(tmp_path: Path) -> None:
    """The left hand is on the camera's right, as of a person who faces it; the wrists are 15 cm apart."""
    left, right = capture(amass(tmp_path / "a.npz", 55, UP_AXES["y"])).hands
    apart = left.joints_3d[:, 0] - right.joints_3d[:, 0]
    np.testing.assert_allclose(apart[:, 0], 0.158, atol=1e-6)
    assert np.ptp(apart, axis=0).max() < 1e-9


def test_beat2_counts_from_the_mean(tmp_path: Path) -> None:
    model = own_mano(tmp_path / "mano")
    relative = np.concatenate(
        [
            body(UP_AXES["y"]),
            np.zeros((FRAMES, 9)),
            *(HANDS[side].hand_pose - mean_of(side) for side in SIDES),
        ],
        axis=1,
    )
    path = amass(tmp_path / "a.npz", 55, UP_AXES["y"], poses=relative, model=np.array("smplx2020"))
    recording = read(path, model=str(model))
    for side in SIDES:
        assert_same_hand(hand_of(recording, side), HANDS[side], placed=False)
    with pytest.raises(OptionError, match=r"count from MANO's mean pose \(--hand-mean flat"):
        read(path)
    flat = hand_of(read(path, hand_mean="flat"), "left")
    assert_same_turns(flat.hand_pose, HANDS["left"].hand_pose - mean_of("left"))


def test_amass_is_read_with_the_mean_when_told(tmp_path: Path) -> None:
    model = own_mano(tmp_path / "mano")
    recording = read(amass(tmp_path / "a.npz", 52, UP_AXES["z"]), hand_mean="mean", model=str(model))
    for side in SIDES:
        assert_same_turns(hand_of(recording, side).hand_pose, HANDS[side].hand_pose + mean_of(side))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"poses": np.zeros((FRAMES, 72))}, "without hands it has fewer"),
        ({"poses": np.zeros((FRAMES, 100))}, "156 or 165 numbers a frame"),
        ({"poses": np.zeros((FRAMES, 165))}, "never move"),
        ({"poses": np.zeros((0, 165))}, "is 0x165"),
        ({"poses": np.full((FRAMES, 165), 90.0)}, "degrees"),
        ({"poses": np.full((FRAMES, 165), np.nan)}, "never move|no hand"),
        ({"mocap_frame_rate": np.array(-1.0)}, "frame rate is -1"),
        ({"mocap_frame_rate": np.array("fast")}, "must be numbers"),
    ],
    ids=["SMPL", "width", "zeros", "empty", "degrees", "NaN", "rate", "text"],
)
def test_what_is_wrong_is_said(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        read(amass(tmp_path / "bad.npz", 55, UP_AXES["y"], **changes))
    assert "\n" not in str(caught.value)


def test_a_cut_file(tmp_path: Path) -> None:
    path = amass(tmp_path / "a.npz", 55, UP_AXES["y"])
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(InputError, match=r"a\.npz"):
        read(path)


# SMPLer-X and ARCTIC's bodies


def frame_of(frame: int, person: int, whole: np.ndarray, *, flat: bool = False) -> dict[str, np.ndarray]:
    """What SMPLer-X writes of one person in one picture: hands that count from the mean."""
    fingers = {
        f"{side}_hand_pose": (HANDS[side].hand_pose[frame] - (0.0 if flat else mean_of(side))).reshape(15, 3)
        for side in SIDES
    }
    return {
        "global_orient": whole[frame, :3].reshape(1, 3),
        "body_pose": whole[frame, 3:].reshape(21, 3),
        **{
            f"{side}_hand_pose": pose * (1.0 if person == 0 else 0.5)
            for side, pose in zip(SIDES, fingers.values(), strict=True)
        },
        "jaw_pose": np.zeros((1, 3)),
        "betas": np.ones((1, 10)),
        "transl": np.zeros((1, 3)),
    }


@pytest.mark.parametrize("given", ["folder", "its parent"])
def test_smpler_x(tmp_path: Path, given: str) -> None:
    model = own_mano(tmp_path / "mano")
    folder = tmp_path / "out" / "smplx"
    folder.mkdir(parents=True)
    whole = body(np.eye(3))
    for frame in range(FRAMES):
        for person in (0, 1):
            values = frame_of(frame, person, whole)
            np.savez(folder / f"{frame + 1:05}_{person}.npz", **values)
    path = folder if given == "folder" else folder.parent
    with pytest.raises(OptionError, match="give your own MANO"):
        read(path)
    recording = read(path, model=str(model), person=1)
    assert len(recording.posed) == 2
    assert recording.frame_numbers.tolist() == list(range(1, FRAMES + 1))
    for side in SIDES:
        assert_same_hand(hand_of(recording, side), HANDS[side], placed=False)
    assert len(read(path, model=str(model)).posed) == 4
    with pytest.raises(InputError, match="no person 3: it has 2"):
        read(path, model=str(model), person=3)
    (folder / "00003_0.npz").write_bytes(b"nothing")
    with pytest.raises(InputError, match=r"00003_0\.npz must hold hands, or a body"):
        read(path, model=str(model))


@pytest.mark.parametrize("count", [1, 2, 3, 4, FRAMES])
def test_arctics_bodies_are_flat(tmp_path: Path, count: int) -> None:
    """Three turns of the pelvis are as many numbers as one matrix has."""
    whole = body(UP_AXES["z"])[:count]
    content = {
        "transl": np.zeros((count, 3)),
        "global_orient": whole[:, :3],
        "body_pose": whole[:, 3:],
        "jaw_pose": np.zeros((count, 3)),
        **{f"{side}_hand_pose": HANDS[side].hand_pose[:count] for side in SIDES},
    }
    path = tmp_path / "box_grab_01.smplx.npy"
    np.save(path, content, allow_pickle=True)
    recording = read(path)
    for side in SIDES:
        assert_same_turns(hand_of(recording, side).global_orient, HANDS[side].global_orient[:count])
        assert_same_turns(hand_of(recording, side).hand_pose, HANDS[side].hand_pose[:count])
    assert says(recording, "z-up")


# Written


@pytest.fixture(scope="module")
def take() -> Take:
    """A take of both hands; the left one is not seen in the third frame."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "both.npz"
        arrays: dict[str, Any] = {"fps": 25.0, "frame_numbers": np.arange(4, 4 + FRAMES)}
        for side, hand in HANDS.items():
            arrays |= {
                f"{side}_global_orient": hand.global_orient,
                f"{side}_hand_pose": hand.hand_pose,
                f"{side}_transl": hand.transl,
                f"{side}_present": np.arange(FRAMES) != (2 if side == "left" else 99),
            }
        np.savez(path, **arrays)
        return capture(path)


@pytest.mark.parametrize("ending", [".smplx.npz", ".mano.npz"])
def test_what_is_written_is_read_back(take: Take, tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"out{ending}"
    writer_for(path).write(take, path)
    recording = read(path)
    assert recording.fps == 25.0
    for hand in take.hands:
        found = hand_of(recording, hand.side)
        np.testing.assert_array_equal(found.present, hand.present)
        there = hand.present
        assert_same_turns(found.global_orient[there], hand.global_orient[there])
        assert_same_turns(found.hand_pose[there], hand.hand_pose[there])
        if ending == ".mano.npz":
            np.testing.assert_allclose(found.transl[there], hand.transl[there], atol=EXACT)
            assert recording.intrinsics == take.intrinsics
            np.testing.assert_array_equal(recording.frame_numbers, take.frame_numbers)


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_few_frames(take: Take, tmp_path: Path, count: int) -> None:
    few = chosen(take, "right", FrameRange(4, 3 + count), None)
    path = tmp_path / "out.mano.npz"
    writer_for(path).write(few, path)
    found = hand_of(read(path), "right")
    assert_same_turns(found.global_orient, few.hands[0].global_orient)


def test_smplx_as_amass_tools_read_it(take: Take, tmp_path: Path) -> None:
    """What Meshcapade's add-on asks of a file, and what AMASS' notebooks take from it."""
    path = tmp_path / "out.smplx.npz"
    writer_for(path).write(take, path)
    with np.load(path, allow_pickle=False) as data:
        assert {"trans", "gender", "mocap_frame_rate", "betas", "poses"} <= set(data)
        assert str(data["gender"]) == "neutral"
        assert str(data["surface_model_type"]) == "smplx"
        assert int(data["mocap_frame_rate"]) == 25
        assert (data["poses"].shape, data["trans"].shape, data["betas"].shape) == (
            (FRAMES, 165),
            (FRAMES, 3),
            (16,),
        )
        poses = data["poses"]
    assert np.isfinite(poses).all()
    still = np.ones(165, dtype=bool)
    still[60:66] = still[75:] = False
    assert not poses[:, still].any()
    assert_same_turns(poses[:, 120:], HANDS["right"].hand_pose)
    # A hand whose camera frame is the world's upside down: its wrist's y is minus the camera's.
    right = rotvec_to_rotmat(poses[:, 63:66])
    np.testing.assert_allclose(right[:, 1], -matrices(HANDS["right"].global_orient)[:, 0, 1], atol=1e-9)


def test_holes_and_steps(take: Take, tmp_path: Path) -> None:
    """Every second frame of a source at 25 a second, one of them missing: 12.5 a second, the hole held."""
    from dataclasses import replace

    numbers = np.array([2, 4, 6, 10, 12, 14, 16])
    path = tmp_path / "out.mano.npz"
    writer_for(path).write(replace(take, frame_numbers=numbers), path)
    recording = read(path)
    assert recording.fps == 12.5
    assert recording.frame_numbers.tolist() == list(range(2, 17, 2))
    right = hand_of(recording, "right")
    assert right.present.tolist() == [True, True, True, False, True, True, True, True]


def test_the_command_converts(take: Take, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, back = tmp_path / "first.take.npz", tmp_path / "back.smplx.npz"
    take.save(first)
    assert main(["convert", str(first), "-o", str(back), "--progress", "none"]) == 0
    assert main(["info", str(back)]) == 0
    said = capsys.readouterr().out
    assert "smplx" in said
    assert "left hand in 6 frames, right hand in 7 frames" in said
    again = tmp_path / "again.take.npz"
    assert main(["convert", str(back), "-o", str(again), "--progress", "none"]) == 0
    read_again = Take.load(again)
    assert_same_turns(read_again.hands[1].hand_pose, take.hands[1].hand_pose)


def test_smplx_itself_poses_our_hands(take: Take, tmp_path: Path) -> None:
    """The package, given a model in MANO's format, puts every vertex where we do."""
    smplx = pytest.importorskip("smplx", reason="smplx is not installed")
    torch = pytest.importorskip("torch", reason="torch is not installed")
    path = tmp_path / "out.mano.npz"
    writer_for(path).write(take, path)
    data = dict(np.load(path, allow_pickle=False))
    for side in SIDES:
        arrays = {**imitation_arrays(side), "bs_style": "lbs", "bs_type": "lrotmin"}
        file = tmp_path / f"MANO_{side.upper()}.pkl"
        file.write_bytes(pickle.dumps(arrays))
        layer = smplx.MANO(str(file), is_rhand=side == "right", use_pca=False, flat_hand_mean=True)
        given = {
            name: torch.from_numpy(data[f"{side}_{name}"]).float()
            for name in ("global_orient", "hand_pose", "transl")
        }
        posed = layer(betas=torch.zeros(1, 10).expand(FRAMES, 10), **given)
        model = load_model(file, side)
        ours = model.posed(
            None, *(data[f"{side}_{name}"] for name in ("global_orient", "hand_pose", "transl"))
        )
        np.testing.assert_allclose(posed.vertices.detach().numpy(), ours.vertices, atol=1e-5)
