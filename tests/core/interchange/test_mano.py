"""Trackers and bodies that keep MANO's parameters: hands that are known come back out of each layout."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.capturing.pipeline import capture
from handfit_core.common.errors import InputError, OptionError
from handfit_core.common.skeleton import NUM_BETAS, SIDES, other_side
from handfit_core.common.values import Unfit
from handfit_core.detect.keypoints import MOST_IN_FRAME
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.interchange.mano import POSE, FoundHands, followed
from handfit_core.interchange.opening import is_recording
from handfit_core.interchange.recording import ReadOptions, usual_place
from handfit_core.interchange.skeletons import UP_AXES
from handfit_core.interchange.writers import writer_for
from handfit_core.take import TAKE_LIMITS, Take
from tests.conftest import ROOT
from tests.core.interchange import mano_files as files
from tests.core.interchange.known_hands import (
    EXACT,
    FRAMES,
    HANDS,
    assert_same_hand,
    assert_same_turns,
    coefficients_of,
    hand_of,
    joints_turned,
    known_hand,
    matrices,
    mean_of,
    own_mano,
    read,
    says,
)
from tests.core.interchange.mano_files import FOCAL, NUMBERS, laid_out, network, written
from tests.imitation_mano import imitation_arrays

LAYOUTS = files.layouts()
MIRROR = np.array([-1.0, 1.0, 1.0])
PICTURES = ROOT / "samples" / "rendered_hand"
SAID = {
    "hamer": ("mirrored crop", "shapes (betas) are MANO's", "frames per second"),
    "wilor-mini": ("left ones already",),
    "hawor": (),
    "dyn-hamr": (),
    "smplx": (", as the body stands so", "where the wrists are is not known"),
    "smplx-keywords": ("-up, as the body stands so",),
    "hot3d": ("taken to be y-up",),
    "interhand-mano": ("the camera's axes",),
    "dexycb": ("taken for a right hand",),
    "freihand": ("one hand's frames",),
}


OF_MEAN = {"hot3d", "arctic", "interhand-mano", "dexycb", "freihand"}
ONE_HAND = {"dexycb", "ho3d", "freihand"}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_hands_come_back(tmp_path: Path, layout: str) -> None:
    reader, contents = LAYOUTS[layout]
    path = laid_out(tmp_path / "clip", contents)
    own = {"model": str(own_mano(tmp_path / "mano"))} if reader in OF_MEAN else {}
    gone = [3] if layout == "HaWoR, a clip" else [6] if "world" in layout else []
    for given in filter(Path.exists, (path, path / "cam_space")):
        assert is_recording(given)
        recording = read(given, picture_size=(1280, 720), **own)
        assert recording.format == reader
        assert np.diff(recording.frame_numbers).tolist() == [1] * (FRAMES - 1)
        for side in SIDES[1:] if reader in ONE_HAND else SIDES:
            placed = "smplx" not in reader and reader != "freihand"
            assert_same_hand(hand_of(recording, side), HANDS[side], placed=placed)
            gone_now = gone if side == "left" else []
            assert np.flatnonzero(~hand_of(recording, side).present).tolist() == gone_now
    for words in SAID.get(reader, ()):
        assert says(recording, words), words
    if layout.startswith("AMASS, "):
        assert says(recording, f"{layout.rpartition(', ')[2]}, as the body stands so")
        assert recording.fps == (60.0 if "parts" in layout else 120.0)
        np.testing.assert_array_equal(recording.posed[0].transl, [usual_place("left")] * FRAMES)
    assert says(recording, "count from 1") == (gone == [3])
    assert says(recording, "its world was taken to have the camera's axes, as in HaWoR") == (gone == [6])
    if reader in ("hamer", "wilor-mini"):
        assert vars(recording.intrinsics) == pytest.approx({"fx": FOCAL, "fy": FOCAL, "cx": 640, "cy": 360})


@pytest.mark.parametrize("layout", ["HaMeR, by picture", "HaWoR, a clip", "Dyn-HaMR"])
def test_betas_fit_the_users_mano(tmp_path: Path, layout: str) -> None:
    model = own_mano(tmp_path / "mano")
    contents = {"a.npz": files.dyn_hamr(model)} if layout == "Dyn-HaMR" else LAYOUTS[layout][1]
    recording = read(laid_out(tmp_path / "clip", contents), model=str(model))
    for side in SIDES:
        assert_same_hand(hand_of(recording, side), HANDS[side])
        np.testing.assert_allclose(hand_of(recording, side).betas, HANDS[side].betas, atol=1e-6)
    assert not says(recording, "betas")


# Left hands, means and frames


def test_a_missing_mirror_is_noticed(tmp_path: Path) -> None:
    """Left hands that are read with the other convention bend backwards, and the right reader is named."""
    path = written(tmp_path / "hamer.npz", files.rows_of_hands())
    wrong = read(path, reader="wilor-mini")
    assert says(wrong, "the left hand's fingers bend further back than fingers can, as if a mirror were")
    assert says(wrong, "--reader hamer")
    assert not says(read(path), "bend further")
    assert_same_hand(hand_of(wrong, "right"), HANDS["right"])
    # Dyn-HaMR's is_right: the mirror of a right hand is a left one, so that its pose is sound; what is not is
    # a left hand that is stored as one.
    wrong = read(dyn(tmp_path / "a.npz", is_right=np.zeros((2, FRAMES)), cam_R=None))
    assert [hand.side for hand in wrong.posed] == ["left", "left"]
    unmirrored = np.stack([hand.hand_pose for hand in HANDS.values()])
    assert says(read(dyn(tmp_path / "b.npz", pose_body=unmirrored)), "its is_right may be wrong")


def dyn(path: Path, **changes: Any) -> Path:
    return written(path, files.dyn_hamr(**changes))


def alone(**changes: Any) -> dict[str, Any]:
    """The right hand's rows as HaMeR has them."""
    hand = HANDS["right"]
    values = {"global_orient": joints_turned(hand)[:, :1], "hand_pose": joints_turned(hand)[:, 1:]}
    return {**values, "right": np.ones(FRAMES), "pred_cam_t_full": hand.transl, **changes}


def test_a_missing_mean_is_noticed(tmp_path: Path) -> None:
    """Nearly flat hands that count from the mean pose bend backwards."""
    mean = load_model(None, "right").hands_mean
    flat, bent = known_hand("right", bend=(0.0, 10.0)), known_hand("right", bend=(80.0, 95.0))
    path = written(tmp_path / "hands.npz", alone(hand_pose=matrices(flat.hand_pose - mean)))
    assert says(read(path), "--hand-mean mean")
    with pytest.raises(OptionError, match="give your own MANO"):
        read(path, hand_mean="mean")
    twice = alone(hand_pose=matrices(bent.hand_pose + mean), pred_cam_t_full=None)
    recording = read(written(tmp_path / "twice.npz", twice))
    assert says(recording, "--hand-mean flat")
    assert says(recording, "where the hands are is not told (pred_cam_t_full)")
    added = read(path, hand_mean="mean", model=str(own_mano(tmp_path / "mano")))
    assert not np.allclose(hand_of(added, "right").hand_pose, flat.hand_pose - mean)


NAMED: list[tuple[str, list[int], str]] = [
    ("take2_{frame:04}", [1, 2, 3], ""),
    ("frame_{frame:04}_hand_{hand}", [1, 2, 3], "the hands', as in frame_0001_hand_0"),
    ("2024-05-17_{frame}", [1, 2, 3], "the frames', as in 2024-05-17_1"),
    ("img_{frame:03}_{hand}_mano2", [], "several clips"),
    ("img_{frame:03}_mano2", [1, 2, 3], "the hands'"),
    ("take{hand}_{frame:04}", [], r"several clips \(take0_\.\. and take1_\.\., for example\).*frame_0001_0"),
]


@pytest.mark.parametrize("kind", ["folder", "keys"])
@pytest.mark.parametrize(("name", "frames", "said"), NAMED, ids=[each[0] for each in NAMED])
def test_frames_by_their_names(tmp_path: Path, kind: str, name: str, frames: list[int], said: str) -> None:
    """The last number is the frame's, or the hand's where the names differ in the one before it, too."""
    content: dict[str, Any] = {}
    for frame in range(3):
        for row in range(2):
            one = files.at_row(network(frame), slice(row, row + 1))
            content.setdefault(name.format(frame=frame + 1, hand=row), []).append(one)
    if kind == "keys":
        path = written(tmp_path / "hands.json", content)
    else:
        path = laid_out(tmp_path / "folder", {f"{called}.json": of for called, of in content.items()})
    if not frames:
        with pytest.raises(InputError, match=said):
            read(path)
        return
    recording = read(path)
    assert recording.frame_numbers.tolist() == frames
    assert [hand.present.tolist() for hand in recording.posed] == [[True] * 3] * 2
    assert says(recording, "the last numbers") == bool(said)
    assert said in " ".join(recording.assumed)


def test_rows_of_one_side_and_points_beside_hands(tmp_path: Path) -> None:
    """Rows are frames; HaMeR's demo keeps arrays of points beside its pictures."""
    recording = read(written(tmp_path / "rows.npz", alone()))
    assert_same_hand(hand_of(recording, "right"), HANDS["right"])
    assert says(recording, "one hand's frames")
    (tmp_path / "rows.npz").unlink()
    folder = laid_out(tmp_path, LAYOUTS["HaMeR, a file a hand"][1])
    np.save(folder / "000001_0_3dkeypoints.npy", np.zeros((1, 21, 3)))
    assert read(folder).frame_numbers.tolist() == list(NUMBERS)


def test_frames_that_are_told_and_hands_that_are_none(tmp_path: Path) -> None:
    """A frame's number, size and rate stand around its hands; zeros are no hand; captures are not mixed."""
    told = read(written(tmp_path / "a.json", files.frames_with_hands()))
    assert (told.frame_numbers.tolist(), told.size, told.fps) == (list(NUMBERS), (1280, 720), 25.0)
    model = str(own_mano(tmp_path / "mano"))
    labels = dict(LAYOUTS["DexYCB"][1])
    labels["labels_000003.npz"] = {"pose_m": np.zeros((1, 51))}
    (left,) = read(laid_out(tmp_path / "dexycb", labels), model=model, hands="left").posed
    assert left.side == "left"
    assert np.flatnonzero(~left.present).tolist() == [2]
    (frames,) = LAYOUTS["InterHand2.6M"][1]["a_MANO.json"].values()
    with pytest.raises(InputError, match=r"several clips \(0/\.\. and 1/\.\."):
        read(written(tmp_path / "b.json", {"0": frames, "1": frames}), model=model)


# Persons


def test_persons(tmp_path: Path) -> None:
    """Rows in another order in each picture; hands are told apart by where they are."""
    first, second = HANDS["right"], known_hand("right", 5)
    away = second.transl + [0.5, 0.0, 0.2]
    for frame in range(FRAMES):
        rows = [(first, first.transl), (second, away)][:: 1 if frame % 2 else -1]
        content = {
            "global_orient": np.stack([joints_turned(hand)[frame, :1] for hand, _ in rows]),
            "hand_pose": np.stack([joints_turned(hand)[frame, 1:] for hand, _ in rows]),
            "pred_cam_t_full": np.stack([place[frame] for _, place in rows]),
            "right": np.ones(2),
        }
        written(tmp_path / "two" / f"{frame + 1}.npz", content)
    posed = read(tmp_path / "two").posed
    by_x = sorted(posed, key=lambda hand: float(np.asarray(hand.transl)[0, 0]))
    for found, hand in zip(by_x, (first, second), strict=True):
        assert_same_turns(found.hand_pose, hand.hand_pose)
    (one,) = read(tmp_path / "two", person=2).posed
    assert one.hand_pose.shape == (FRAMES, 45)
    with pytest.raises(InputError, match="no person 3: it has 2"):
        read(tmp_path / "two", person=3)
    path = dyn(tmp_path / "a.npz")
    assert len(read(path, person=1).posed) == 2
    with pytest.raises(InputError, match="no person 2: it has 1"):
        read(path, person=2)


def right_hands(*places: tuple[int, float], persons: list[int] | None = None) -> FoundHands:
    """Right hands in these frames, at these x."""
    count = len(places)
    frames, x = (np.array(column) for column in zip(*places, strict=True))
    transl = np.column_stack([x, np.zeros(count), np.full(count, 0.5)])
    person = np.full(count, -1) if persons is None else np.array(persons)
    betas = np.full((count, NUM_BETAS), np.nan)
    pose = np.zeros((count, 3)), np.zeros((count, POSE)), transl
    return FoundHands(frames.astype(int), np.ones(count, dtype=int), person, betas, *pose)


def test_each_hand_goes_to_the_nearest_that_is_free() -> None:
    """In whatever order hands come; one that is new begins a new track."""
    places = [(0.3, 0.0), (0.01, 0.31), (0.32, 0.02, 0.9)]
    found = right_hands(*((frame, x) for frame, row in enumerate(places) for x in row))
    first, second, third = followed(found, np.arange(3), ReadOptions(), [])
    for track, xs in ((first, [0.3, 0.31, 0.32]), (second, [0.0, 0.01, 0.02]), (third, [0.9])):
        np.testing.assert_allclose(track.transl[track.present, 0], xs)


def test_hands_and_persons_are_bounded() -> None:
    most = TAKE_LIMITS.max_hands
    crowd = [(1, float(x)) for x in range(most + 1)]
    assert len(followed(right_hands(*crowd[1:]), np.array([1]), ReadOptions(), [])) == most
    for hands, said in (
        (right_hands(*crowd), "more than 200 hands"),
        (right_hands(*crowd, persons=list(range(len(crowd)))), "more than 200 hands"),
        (right_hands(*[(1, 0.0)] * (MOST_IN_FRAME + 1)), "4001 hands in frame 1, and at most 4000"),
        (right_hands((1, 0.0), (1, 1.0), persons=[0, 0]), "twice in one frame"),
    ):
        with pytest.raises((Unfit, ValueError), match=said):
            followed(hands, np.array([1]), ReadOptions(), [])


# Cameras


def test_the_focal_length_of_a_crop_is_not_the_pictures(tmp_path: Path) -> None:
    """HaMeR's and WiLoR's own output has 5000 pixels for the crop of 256, whatever the picture is."""
    frames = {f"{n:04}": {**network(n), "focal_length": np.full((2, 2), 5000.0)} for n in range(FRAMES)}
    for more, focal in (({}, FOCAL), ({"scaled_focal_length": 900.0}, 900.0)):
        path = written(tmp_path / "hamer.json", {name: {**each, **more} for name, each in frames.items()})
        camera = read(path, picture_size=(1280, 720)).intrinsics
        assert camera is not None
        assert camera.fx == pytest.approx(focal)


def test_takes_have_the_networks_camera(tmp_path: Path) -> None:
    """Alone, and beside pictures, which tell the size."""
    path = written(tmp_path / "hamer.npz", files.rows_of_hands())
    take = capture(path, picture_size=(1280, 720), fps=25)
    assert [hand.side for hand in take.hands] == ["left", "right"]
    assert (take.fps, take.solver, take.width) == (25.0, "hamer", 1280)
    assert take.program == Take.from_bytes(take.to_bytes()).program == "HaMeR or WiLoR"
    assert take.intrinsics.fx == pytest.approx(FOCAL)
    np.testing.assert_allclose(take.hands[1].transl, HANDS["right"].transl, atol=1e-6)
    take = capture(PICTURES, keypoints=path)
    assert take.source.kind == "sequence"
    focal = 5000.0 / 256.0 * max(take.width, take.height)
    assert take.intrinsics == Intrinsics(focal, focal, take.width / 2.0, take.height / 2.0)
    assert [int(hand.present.sum()) for hand in take.hands] == [FRAMES, FRAMES]
    assert capture(PICTURES, keypoints=path, lens=(1.0, 0.5, 0.5)).intrinsics.fx == take.width


def test_hands_lie_where_their_pictures_have_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """HaWoR's far to the side, where a virtual camera would not see them; one in no wanted frame is none."""
    aside = np.tile([0.3, 0.0, 0.5], (FRAMES, 1))
    monkeypatch.setattr(files, "HANDS", {side: replace(hand, transl=aside) for side, hand in HANDS.items()})
    folder = laid_out(tmp_path / "video", files.hawor())
    placed = read(folder).posed[0].transl
    for take in (
        capture(str(PICTURES / "hand.%04d.jpg"), keypoints=folder),
        capture(folder, intrinsics=[900.0, 900.0, 960.0, 540.0]),
    ):
        np.testing.assert_allclose(take.hands[0].transl[: FRAMES - 4], placed[: FRAMES - 4], atol=1e-9)
    assert "moved" not in caplog.text
    take = capture(folder)
    assert np.nanmin(take.hands[0].transl[:, 2]) > 0.7
    assert "outside the view of a virtual camera: all are moved before it, by -0.30, " in caplog.text
    assert [hand.side for hand in capture(folder, frames="4").hands] == ["right"]


def test_every_point_of_dyn_hamr(tmp_path: Path) -> None:
    """By the other way round: Dyn-HaMR poses right hands, mirrors their points, and looks at them."""
    path = dyn(tmp_path / "world_results.npz")
    data = dict(np.load(path))
    take = capture(path)
    assert (take.width, take.height, take.intrinsics.fx) == (1280, 720, 1400.0)
    right, (turned, moved) = load_model(None, "right"), files.cameras()
    for track, hand in enumerate(take.hands):
        pose = (data[name][track] for name in ("root_orient", "pose_body", "trans"))
        points = right.keypoints(None, *pose) * (MIRROR if hand.side == "left" else 1.0)
        seen = (turned[:, None] @ points[..., None])[..., 0] + moved[:, None]
        np.testing.assert_allclose(hand.joints_3d, seen, atol=EXACT)


# Bodies


def amass(path: Path, **changes: Any) -> Path:
    return written(path, files.amass(55, UP_AXES["y"], **changes))


def test_fingers_that_never_move_are_told(tmp_path: Path) -> None:
    """As in the many files of AMASS whose markers were on the body alone."""
    poses = np.zeros((FRAMES, 156))
    poses[:, 66:] = np.tile(HANDS["left"].hand_pose[0], 2)
    for changes, still in (({"poses": poses}, True), ({}, False)):
        path = written(tmp_path / "a.npz", files.amass(52, UP_AXES["y"], **changes))
        assert says(read(path), "the fingers never move") == still


def test_what_poses_count_from(tmp_path: Path) -> None:
    """BEAT2's files from the mean, AMASS' from the flat hand, and all as they are told to."""
    model = str(own_mano(tmp_path / "mano"))
    relative = [hand.hand_pose - mean_of(side) for side, hand in HANDS.items()]
    poses = np.concatenate([files.body(UP_AXES["y"]), np.zeros((FRAMES, 9)), *relative], axis=1)
    beat2 = amass(tmp_path / "a.npz", poses=poses, model=np.array("smplx2020"))
    with pytest.raises(OptionError, match=r"count from MANO's mean pose \(--hand-mean flat"):
        read(beat2)
    flat = written(tmp_path / "b.npz", files.amass(52, UP_AXES["z"]))
    added = read(flat, hand_mean="mean", model=model)
    for side, hand in HANDS.items():
        assert_same_hand(hand_of(read(beat2, model=model), side), hand, placed=False)
        without = hand_of(read(beat2, hand_mean="flat"), side)
        assert_same_turns(without.hand_pose, hand.hand_pose - mean_of(side))
        assert_same_turns(hand_of(added, side).hand_pose, hand.hand_pose + mean_of(side))


def test_smpler_x(tmp_path: Path) -> None:
    """A file for each person in each picture, whose hands count from the mean."""
    model = str(own_mano(tmp_path / "mano"))
    folder = tmp_path / "out" / "smplx"
    for frame in range(FRAMES):
        values = files.keywords(slice(frame, frame + 1), np.eye(3))
        for side in SIDES:
            values[f"{side}_hand_pose"] = (values[f"{side}_hand_pose"] - mean_of(side)).reshape(15, 3)
        for person in (0, 1):
            written(folder / f"{frame + 1:05}_{person}.npz", values)
            values["left_hand_pose"] = 0.5 * values["left_hand_pose"]
    for path in (folder, folder.parent):
        with pytest.raises(OptionError, match="give your own MANO"):
            read(path)
        recording = read(path, model=model, person=1)
        assert recording.frame_numbers.tolist() == list(range(1, FRAMES + 1))
        for side in SIDES:
            assert_same_hand(hand_of(recording, side), HANDS[side], placed=False)
    assert len(read(path, model=model).posed) == 4
    with pytest.raises(InputError, match="no person 3: it has 2"):
        read(path, model=model, person=3)
    (folder / "00003_0.npz").write_bytes(b"nothing")
    with pytest.raises(InputError, match=r"00003_0\.npz must hold hands, or a body"):
        read(path, model=model)


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_few_frames_of_a_body(tmp_path: Path, count: int) -> None:
    """Three turns of the pelvis are as many numbers as one matrix has."""
    for side in SIDES:
        values = files.keywords(slice(count), UP_AXES["z"])
        del values[f"{other_side(side)}_hand_pose"]
        (found,) = read(written(tmp_path / "box.smplx.npy", values)).posed
        assert_same_turns(found.global_orient, HANDS[side].global_orient[:count])
        assert_same_turns(found.hand_pose, HANDS[side].hand_pose[:count])


def test_directions_instead_of_angles(tmp_path: Path) -> None:
    """Hands may be coefficients of MANO's principal directions."""
    values = files.keywords(slice(None), UP_AXES["z"])
    for side, hand in HANDS.items():
        values[f"{side}_hand_pose"] = coefficients_of(hand.hand_pose, side)[:, :12]
    path = written(tmp_path / "body.npz", values)
    with pytest.raises(OptionError, match="coefficients of MANO's principal directions"):
        read(path)
    recording = read(path, model=str(own_mano(tmp_path / "mano")))
    for side in SIDES:
        components = imitation_arrays(side)["hands_components"][:12]
        assert_same_turns(hand_of(recording, side).hand_pose, values[f"{side}_hand_pose"] @ components)


# Written


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> Take:
    """A take of both hands; the left one is not seen in the third frame."""
    arrays: dict[str, Any] = {"fps": 25.0, "frame_numbers": np.arange(4, 4 + FRAMES)}
    for side, hand in HANDS.items():
        arrays |= {f"{side}_{name}": getattr(hand, name) for name in ("global_orient", "hand_pose", "transl")}
        arrays[f"{side}_present"] = np.arange(FRAMES) != (2 if side == "left" else 99)
    return capture(written(tmp_path_factory.mktemp("take") / "both.npz", arrays))


def wrote(take: Take, path: Path) -> Path:
    writer_for(path).write(take, path)
    return path


@pytest.mark.parametrize("ending", [".smplx.npz", ".mano.npz"])
def test_what_is_written_is_read_back(take: Take, tmp_path: Path, ending: str) -> None:
    recording = read(wrote(take, tmp_path / f"out{ending}"))
    assert recording.fps == 25.0
    for hand in take.hands:
        found = hand_of(recording, hand.side)
        np.testing.assert_array_equal(found.present, hand.present)
        assert_same_hand(found, HANDS[hand.side], placed=ending == ".mano.npz")
    if ending == ".mano.npz":
        assert recording.intrinsics == take.intrinsics
        np.testing.assert_array_equal(recording.frame_numbers, take.frame_numbers)


def test_smplx_as_amass_tools_read_it(take: Take, tmp_path: Path) -> None:
    """What Meshcapade's add-on asks of a file, and what AMASS' notebooks take from it."""
    with np.load(wrote(take, tmp_path / "out.smplx.npz"), allow_pickle=False) as data:
        assert (str(data["gender"]), str(data["surface_model_type"])) == ("neutral", "smplx")
        assert int(data["mocap_frame_rate"]) == 25
        shapes = [data[name].shape for name in ("poses", "trans", "betas")]
        assert shapes == [(FRAMES, 165), (FRAMES, 3), (16,)]
        poses = data["poses"]
    assert np.isfinite(poses).all()
    still = np.ones(165, dtype=bool)
    still[60:66] = still[75:] = False
    assert not poses[:, still].any()
    assert_same_turns(poses[:, 120:], HANDS["right"].hand_pose)
    # A hand whose camera frame is the world's upside down: its wrist's y is minus the camera's.
    right = rotvec_to_rotmat(poses[:, 63:66])
    np.testing.assert_allclose(right[:, 1], -matrices(HANDS["right"].global_orient)[:, 0, 1], atol=1e-9)


# What is wrong


def hamer(path: Path, **changes: Any) -> Path:
    return written(path, alone(**changes))


def hawor(path: Path, **changes: Any) -> Path:
    return laid_out(path.parent, files.hawor(**changes))


WRONG: list[tuple[Callable[..., Path], dict[str, Any], str]] = [
    (hamer, {"right": np.ones(FRAMES - 1)}, "rows where 6 are expected"),
    (hamer, {"global_orient": 2.0 * joints_turned(HANDS["right"])[:, :1]}, "no rotations"),
    (hamer, {"hand_pose": np.degrees(HANDS["right"].hand_pose)}, "degrees"),
    (hamer, {"pred_cam_t_full": np.full((FRAMES, 3), 1e12)}, "beyond"),
    (hawor, {"init_trans": [[[0.0, 0.0, 1.0]]]}, "init_trans has 1 rows where 3 are expected"),
    (hawor, {"init_root_orient": None}, "no hands of a layout that is known"),
    (dyn, {"is_right": np.ones(FRAMES)}, "is_right must have the shape BxT"),
    (dyn, {"intrins": np.array([1.0, 1.0, -5.0, 2.0])}, "intrins must be"),
    (amass, {"poses": np.zeros((FRAMES, 72))}, "without hands it has fewer"),
    (amass, {"poses": np.zeros((FRAMES, 165))}, "never move"),
    (amass, {"mocap_frame_rate": np.array(-1.0)}, "frame rate is -1"),
]


@pytest.mark.parametrize(("write", "changes", "said"), WRONG)
def test_what_is_wrong_is_said(
    tmp_path: Path, write: Callable[..., Path], changes: dict[str, Any], said: str
) -> None:
    with pytest.raises(InputError, match=said) as caught:
        read(write(tmp_path / "bad.npz", **changes))
    assert "\n" not in str(caught.value)
