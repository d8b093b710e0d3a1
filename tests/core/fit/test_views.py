"""Two cameras that film the same hands: found from hands that were projected into both."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from handfit_core.capturing.fitting import hand_track
from handfit_core.capturing.joining import Clip, joined
from handfit_core.capturing.options import CaptureOptions
from handfit_core.common.errors import InputError, OptionError
from handfit_core.common.skeleton import Side
from handfit_core.detect.keypoints import Landmarked
from handfit_core.fit.fast import fitter_of
from handfit_core.fit.terms.free_cameras import CAMERA_SIZE, CameraPrior, Filmed, FilmedState, projected
from handfit_core.fit.views.cameras import HandPair, Known, adjust
from handfit_core.fit.views.courses import offset_scores
from handfit_core.fit.views.hands import ViewedHand
from handfit_core.fit.views.rig_file import read_rig, write_rig
from handfit_core.fit.views.verdict import Evidence, degrees_apart, rotation_between, verdict_of
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.hand_model.chain import HAND_SIZE, State
from handfit_core.hand_model.motion import HandMotion
from handfit_core.interchange.taking import seen_of
from handfit_core.media.source import Source
from handfit_core.take import Take, chosen
from tests.core.fit.differences import close, of_increments
from tests.core.fit.hands import RELAXED, make_state, observe

CAMERA = Intrinsics(600.0, 600.0, 320.0, 240.0)
TURN = rotvec_to_rotmat(np.array([0.1, 0.9, -0.2]))
SHIFT = np.array([-0.45, 0.03, 0.25])
OFFSET = 0.11
"""seconds from the first view's start to the second one's, 3.3 frames"""
FRAMES, FPS = 70, 30.0


def moving(times: np.ndarray, side: Side = "right", seed: int = 0) -> State:
    """A hand that opens and closes and turns, half a metre before the first camera."""
    rng = np.random.default_rng(seed)
    rate, phase = rng.uniform(2.0, 5.0, size=5), rng.uniform(0.0, 6.0, size=5)
    angles = np.tile(RELAXED, (len(times), 1, 1))
    angles[..., 2::3] += 0.35 * np.sin(times[:, None] * rate + phase)[..., None]
    if side == "left":
        angles *= np.tile([-1.0, -1.0, 1.0], 3)
    times = times * (1.0 + 0.4 * seed) + seed
    turns = np.stack([1.2 + 0.3 * np.sin(times), 0.6 * np.sin(2.0 * times), 0.4 * np.cos(times)], axis=1)
    wrist = np.stack([0.05 * np.sin(times), 0.04 * np.cos(2.0 * times), 0.5 + 0.03 * np.sin(times)], axis=1)
    return State(rotvec_to_rotmat(turns), angles, wrist, np.zeros((len(times), 10)), np.full(len(times), 0.5))


def from_second(state: State) -> State:
    return replace(state, root=TURN @ state.root, wrist=state.wrist @ TURN.T + SHIFT)


def viewed(state: State, times: np.ndarray, side: Side = "right") -> ViewedHand:
    """What a view has that errs nowhere in the picture, but in depth."""
    chain = fitter_of(load_model(None, side)).chain
    points = chain.points(state)
    seen = observe(points)
    table = Landmarked(seen.pixels, seen.pixel_sigma, 0.7 * seen.depth, seen.depth_sigma)
    bent = replace(state, angles=state.angles + 0.1, wrist=state.wrist * 1.1)
    return ViewedHand(
        times, table, FPS, np.arange(len(times)), points, bent, chain.points(bent), side, CAMERA
    )


def pair(side: Side = "right", seed: int = 0) -> HandPair:
    times = np.arange(FRAMES) / FPS
    first = viewed(moving(times, side, seed), times, side)
    second = viewed(from_second(moving(times + OFFSET, side, seed)), times, side)
    return HandPair(fitter_of(load_model(None, side)), first, second)


def take_of(state: State, name: str, side: Side = "right") -> Take:
    """A take of a hand that was detected where it is."""
    model = load_model(None, side)
    betas, orient, pose, transl = fitter_of(model).chain.parameters(state)
    motion = HandMotion(side, betas[0], orient, pose, transl)
    track = seen_of(model, motion, CAMERA, FPS)
    return Take(
        source=Source("video", (name,)),
        fps=FPS,
        frame_numbers=np.arange(1, 1 + len(state)),
        width=640,
        height=480,
        intrinsics=CAMERA,
        solver="fast",
        model="open-hand",
        model_digests={},
        hands=(hand_track(model, track, motion, CAMERA),),
    )


def takes(seed: int = 0, other: int | None = None) -> tuple[Clip, Clip]:
    times = np.arange(FRAMES) / FPS
    second = from_second(moving(times + OFFSET, seed=seed if other is None else other))
    return (
        Clip(take_of(moving(times, seed=seed), "/a.mp4"), lens_known=True),
        Clip(take_of(second, "/b.mp4"), lens_known=True),
    )


def test_derivatives_by_cameras():
    chain = fitter_of(load_model(None, "right")).chain
    count = HAND_SIZE + CAMERA_SIZE
    state = make_state(1, chain).select(np.zeros(2 * count, dtype=int))
    many = len(state)
    filmed = FilmedState(
        **vars(state),
        rotation=np.tile(TURN, (many, 1, 1)),
        translation=np.tile(SHIFT, (many, 1)),
        log_focal=np.full((many, 2), np.log(600.0)),
        offset=np.full(many, OFFSET),
    )
    speed = np.tile(np.random.default_rng(0).normal(size=(1, 21, 2)) * 30.0, (many, 1, 1))
    pixels = observe(chain.points(state)).pixels
    prior = CameraPrior(np.log([500.0, 700.0]), np.array([0.3, 0.2]), 0.0, 0.03)
    seen = observe(chain.points(state))

    def rows(state: FilmedState, camera: int):
        there = pixels - camera * speed * (state.offset - OFFSET)[:, None, None]
        view = Filmed(there, speed, np.array([320.0, 240.0]), np.full(there.shape, 4.0))
        return projected(chain.pose(state), view, camera)

    for camera in (0, 1):
        found = of_increments(
            lambda shift, c=camera: rows(filmed.moved(shift, np.zeros((many, 5, 9))), c).residual, count
        )
        whole = chain.jacobian(chain.pose(filmed), rows(filmed, camera).columns, shape=True)[0]
        close(whole[..., 9:-1], found, rtol=1e-5, atol=1e-4)
    found = of_increments(
        lambda shift: prior(chain.pose(filmed.moved(shift, np.zeros((many, 5, 9)))), seen).residual, count
    )
    close(prior(chain.pose(filmed), seen).jacobian[0], found, rtol=1e-5, atol=1e-4)


def test_offset_from_courses():
    best, *others = offset_scores([pair()])
    assert abs(best.offset - OFFSET) * FPS < 0.3
    assert all(other.score < 0.7 * best.score for other in others)


@pytest.mark.parametrize("sides", [("right",), ("left",), ("left", "right")])
def test_cameras_are_recovered(sides):
    """From poses that are wrong by six degrees a joint, a tenth too far away, and two frames off."""
    pairs = [pair(side, seed) for seed, side in enumerate(sides)]
    found = adjust(pairs, OFFSET + 2.0 / FPS, Known((600.0, 600.0), (0.02, 0.02)))
    assert found is not None
    assert rotation_between(found.rotation, TURN) < 1.5
    assert abs(found.offset - OFFSET) * FPS < 0.1
    way, true = found.translation, SHIFT
    assert way @ true > 0.999 * np.linalg.norm(way) * np.linalg.norm(true)
    assert np.linalg.norm(way - true) < 0.1 * np.linalg.norm(true)
    assert found.residual < 0.5
    few = adjust([pairs[0].at(np.arange(20, 26))], OFFSET, Known((600.0, 600.0), (0.3, 0.3)))
    assert few is not None
    assert all(more > 2.0 * less for more, less in zip(few.left_open, found.left_open, strict=True))
    told = Known((600.0, 600.0), (0.0, 0.0), TURN, SHIFT, 0.0)
    held = adjust(pairs, OFFSET, told)
    assert held is not None
    close(held.rotation, TURN)
    close(held.translation, SHIFT)
    assert held.offset == OFFSET


def test_two_takes_become_one(tmp_path):
    first, second = takes()
    take = joined(first, second, CaptureOptions())
    assert take.verdict is not None
    assert take.verdict.agreement == "good", take.verdict.text
    assert take.cameras is not None
    assert rotation_between(take.cameras.rotation[1], TURN) < 6.0
    assert abs(take.cameras.time_offset[1] - OFFSET) * FPS < 0.5
    (seen,) = take.hands[0].seen_by
    assert seen is not None
    np.testing.assert_array_equal(seen.keypoints_2d, second.take.hands[0].keypoints_2d)
    # Of 66 moments in common the pixels come from 67 frames.
    assert seen.used.sum() == FRAMES - 3
    again = Take.load(take.save(tmp_path / "take.npz"))
    assert again.verdict == take.verdict
    assert again.cameras is not None
    for name in ("rotation", "translation", "intrinsics", "time_offset"):
        np.testing.assert_array_equal(getattr(again.cameras, name), getattr(take.cameras, name))
    assert again.cameras.views[0].source == second.take.source
    assert again.to_bytes() == take.to_bytes()
    later = chosen(take, "both", None, None), chosen(take, "both", _range("11-60"), None)
    assert [each.cameras and each.cameras.time_offset[1] for each in later] == pytest.approx(
        [take.cameras.time_offset[1], take.cameras.time_offset[1] - 10.0 / FPS]
    )


def _range(text: str):
    from handfit_core.media.frame_range import FrameRange

    return FrameRange.parse(text)


def test_a_mirrored_view_is_turned_back():
    first, second = takes()
    plain = joined(first, second, CaptureOptions())
    mirrored = replace(second, take=_mirrored(second.take))
    take = joined(first, mirrored, CaptureOptions())
    assert take.cameras is not None
    assert plain.cameras is not None
    assert take.cameras.views[0].mirrored
    assert rotation_between(take.cameras.rotation[1], plain.cameras.rotation[1]) < 2.0


def _mirrored(take: Take) -> Take:
    (hand,) = take.hands
    flip = np.diag([-1.0, 1.0, 1.0])
    orient, pose = (
        rotmat_to_rotvec(flip @ rotvec_to_rotmat(each.reshape(len(each), -1, 3)) @ flip).reshape(each.shape)
        for each in (hand.global_orient, hand.hand_pose)
    )
    model = load_model(None, "left")
    motion = HandMotion("left", hand.betas, orient, pose, hand.transl * [-1.0, 1.0, 1.0])
    return replace(take, hands=(hand_track(model, seen_of(model, motion, CAMERA, FPS), motion, CAMERA),))


@pytest.mark.parametrize(
    ("views", "said"),
    [
        (lambda: takes(0, 7), "The views do not agree"),
        (lambda: (takes()[0], takes()[0]), "Both views look from the same place"),
    ],
)
def test_views_that_do_not_belong_together(views, said):
    """The better view's own take is kept."""
    first, second = views()
    take = joined(first, second, CaptureOptions())
    assert take.verdict is not None
    assert take.verdict.agreement == "failed"
    assert said in take.verdict.text
    assert take.cameras is None
    assert take.hands in (first.take.hands, second.take.hands)


GOOD = Evidence(3.3, 2.0, 1.2, 80, 70.0, 5.0, 0.8)


@pytest.mark.parametrize(
    ("changes", "agreement", "said"),
    [
        (
            {},
            "good",
            "Offset 3.30 frames, 80 frames in common, cameras 70 degrees apart, views agree to 2.0 px",
        ),
        ({"apart": 12.0}, "doubtful", "too close together (12 degrees)"),
        ({"common": 25}, "doubtful", "Only 25 frames are in common"),
        ({"score": 0.05}, "doubtful", "The fingers hardly move"),
        ({"left_open": (1.2, 1.0)}, "doubtful", "Where the second camera stands is uncertain"),
        ({"left_open": (0.5, 9.0)}, "doubtful", "Where the second camera stands is uncertain"),
        ({"left_open": (9.0, 9.0), "cameras_known": True}, "good", ""),
        ({"residual": 1.9}, "doubtful", "agree badly"),
        ({"halves": 20.0}, "doubtful", "seem to have moved"),
        ({"dropped": 0.2}, "doubtful", "In 20% of the frames"),
        ({"residual": 1.9, "common": 25}, "failed", "do not agree"),
        ({"residual": 2.5}, "failed", "do not agree"),
        ({"halves": 60.0}, "failed", "do not agree"),
        ({"common": 12}, "failed", "in only 12 frames"),
        ({"apart": 1.0}, "failed", "same place"),
    ],
)
def test_verdict(changes, agreement, said):
    verdict = verdict_of(replace(GOOD, **changes))
    assert verdict.agreement == agreement
    assert said in verdict.text


def test_degrees_apart():
    quarter = rotvec_to_rotmat(np.array([0.0, np.pi / 2, 0.0]))
    # The second camera stands at (1, 0, 1) and looks at the hand from the side.
    point = np.array([[0.0, 0.0, 1.0]])
    assert degrees_apart(quarter, -quarter @ np.array([1.0, 0.0, 1.0]), point) == pytest.approx(90.0)


def test_calibrations(tmp_path):
    first, second = takes()
    take = joined(first, second, CaptureOptions())
    assert take.cameras is not None
    path = tmp_path / "rig.toml"
    write_rig(path, take)
    rig = read_rig(path, ["a", "b"], [(640, 480), (640, 480)])
    close(rig.rotation, take.cameras.rotation[1])
    close(rig.translation, take.cameras.translation[1])
    close(list(vars(rig.lenses[1].intrinsics).values()), take.cameras.intrinsics[1])
    other_way = read_rig(path, ["b", "a"], [(640, 480), (320, 240)])
    close(other_way.rotation, rig.rotation.T)
    assert other_way.lenses[1].intrinsics.fx == pytest.approx(rig.lenses[0].intrinsics.fx / 2.0)
    known = joined(first, second, CaptureOptions(), rig)
    assert known.cameras is not None
    close(known.cameras.rotation[1], rig.rotation)
    in_mm = tmp_path / "mm.toml"
    shift = np.round(take.cameras.translation[1], 6).tolist()
    text = path.read_text().replace(
        f"translation = {take.cameras.translation[1].tolist()}", f"translation = {shift}"
    )
    in_mm.write_text(text.replace(f"{shift}", f"{[1000.0 * v for v in shift]}"))
    close(read_rig(in_mm, ["a", "b"], [(640, 480)] * 2).translation, shift)
    with pytest.raises(
        OptionError, match="the first view's camera was calibrated for 640x480, and a has another"
    ):
        read_rig(path, ["a", "b"], [(480, 480), (640, 480)])
    path.write_text(path.read_text() + path.read_text().split("[metadata]")[0].replace("cam_", "more_"))
    with pytest.raises(InputError, match="it has 4 cameras"):
        read_rig(path, ["x", "y"], [(640, 480)] * 2)
    with pytest.raises(OptionError, match="the take has one view"):
        write_rig(path, first.take)
