"""The whole core on the bundled sample, against the pose that was rendered; and on real photos."""

import json
import zipfile
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import handfit_core
from handfit_core import Intrinsics, Progress, Take, capture
from handfit_core.capturing import fitting, pipeline
from handfit_core.capturing.fitting import hand_track
from handfit_core.capturing.options import CaptureOptions
from handfit_core.capturing.pipeline import add_arms, hand_summaries
from handfit_core.capturing.sources import _rate
from handfit_core.common.errors import (
    Cancelled,
    HandModelError,
    InputError,
    NoHandFoundError,
    OptionError,
    PlugInError,
)
from handfit_core.common.registry import Registry
from handfit_core.common.skeleton import SIDES
from handfit_core.detect.detector import DETECTORS, Backend, Detector
from handfit_core.detect.keypoints import Detections, Track
from handfit_core.fit.solvers import SOLVERS, Solver, TrackSolver, get_solver
from handfit_core.geometry.lens import Lens
from handfit_core.geometry.similarity import align
from handfit_core.hand_model import load_model, save_model_npz
from handfit_core.hand_model.length import flat_hand_length
from handfit_core.hand_model.motion import HandMotion
from handfit_core.media.lenses import MeasuredLens, save_lens
from handfit_core.media.opening import open_media
from handfit_core.tasks import report
from tests.conftest import ROOT
from tests.core.fit.detections import track_of
from tests.takes import seen_as

SAMPLE = ROOT / "samples" / "rendered_hand"
PATTERN, PHOTO = str(SAMPLE / "hand.%04d.jpg"), SAMPLE / "hand.0001.jpg"


@pytest.fixture(scope="module")
def truth() -> Take:
    return Take.load(SAMPLE / "truth.take.npz")


@pytest.fixture(scope="module")
def progress() -> list[Progress]:
    return []


@pytest.fixture(scope="module")
def take(truth: Take, progress: list[Progress]) -> Take:
    return capture(PATTERN, progress=progress.append, frames="1-24:4", intrinsics=truth.intrinsics)


def test_a_take_describes_its_source(take, progress):
    assert (take.source.kind, take.source.name) == ("sequence", "hand")
    assert [Path(f).name for f in take.source.files] == [f"hand.{n:04d}.jpg" for n in range(1, 25, 4)]
    np.testing.assert_array_equal(take.frame_numbers, range(1, 25, 4))
    assert (take.width, take.height, take.fps) == (640, 480, 24.0)
    assert (take.solver, take.model) == ("fast", "open-hand")
    assert take.model_digests == {"right": load_model(None, "right").digest}
    counted = [(p.stage, p.done, p.total) for p in progress]
    assert counted == [(stage, done, 6) for stage in ("detect", "fit") for done in range(1, 7)]


def test_finds_the_hand_that_was_rendered(take, truth):
    (hand,) = take.hands
    assert hand.side == "right"
    assert hand.detected.all()
    expected = truth.hands[0]
    rows = np.asarray(take.frame_numbers) - 1
    joints = expected.joints_3d[rows]
    aligned = [align(a, b, with_scale=True).apply(a) for a, b in zip(hand.joints_3d, joints, strict=True)]
    assert np.linalg.norm(np.array(aligned) - joints, axis=-1).mean() < 0.012  # metres, similarity-aligned
    pixels = np.linalg.norm(take.intrinsics.project(hand.joints_3d) - expected.keypoints_2d[rows], axis=-1)
    assert pixels.mean() < 12.0
    # Nobody sees a hand's size in a picture, but an adult's hand is no further off than this.
    depth = hand.joints_3d[:, 0, 2] / joints[:, 0, 2]
    assert np.all((depth > 0.7) & (depth < 1.4))


def test_a_take_is_consistent(take):
    (hand,) = take.hands
    joints = (
        load_model(None, "right").posed(hand.betas, hand.global_orient, hand.hand_pose, hand.transl).keypoints
    )
    np.testing.assert_allclose(hand.joints_3d, joints, atol=1e-9)
    errors = np.linalg.norm(take.intrinsics.project(joints) - hand.keypoints_2d, axis=-1).mean(axis=-1)
    np.testing.assert_allclose(hand.reprojection_error, errors)
    assert np.all(hand.score > 0.5)
    assert hand_summaries(take)[0]["mean_reprojection_error_px"] == pytest.approx(errors.mean())
    nowhere = seen_as(hand, detected=np.zeros(6, dtype=bool))
    assert hand_summaries(replace(take, hands=(nowhere,)))[0]["mean_reprojection_error_px"] is None


def stopped(stage: str, done: int, **options: Any) -> tuple[Take, list[int]]:
    """A capture that is asked to stop once so much is done, and how far its fit came."""
    seen: list[Progress] = []

    def should_stop() -> bool:
        return any(p.stage == stage and p.done >= done for p in seen)

    taken = capture(PATTERN, progress=seen.append, should_stop=should_stop, **options)
    return taken, [p.done for p in seen if p.stage == "fit"]


def test_stopped_while_finding_keeps_what_was_found(monkeypatch):
    """And a slow solver fits a little of it."""
    take, fitted = stopped("detect", 5)
    np.testing.assert_array_equal(take.frame_numbers, range(1, 6))
    assert [Path(f).name for f in take.source.files] == [f"hand.{n:04d}.jpg" for n in range(1, 6)]
    assert take.hands[0].detected.all()
    assert fitted == [1, 2, 3, 4, 5]
    assert np.all(take.hands[0].reprojection_error < 15.0)
    monkeypatch.setattr(fitting, "LAST_FITS_SECONDS", 0.0)
    take, _ = stopped("detect", 4, solver="paper-a")
    np.testing.assert_array_equal(take.frame_numbers, range(1, 5))
    np.testing.assert_array_equal(take.hands[0].detected, [True, False, False, False])


@pytest.mark.slow
def test_stopped_while_fitting_keeps_what_was_fitted():
    take, _ = stopped("fit", 2, solver="paper-a-plus", frames="1-5")
    np.testing.assert_array_equal(take.frame_numbers, range(1, 6))
    (hand,) = take.hands
    np.testing.assert_array_equal(hand.detected, [True, True, False, False, False])
    assert np.isnan(hand.keypoints_2d[2:]).all()
    assert np.isfinite(hand.joints_3d[:2]).all()


def test_stopped_before_a_hand_was_found():
    with pytest.raises(Cancelled, match="hand: stopped before a hand was found"):
        capture(PATTERN, should_stop=lambda: True)
    with pytest.raises(Cancelled, match="stopped before"):
        stopped("detect", 0, frames="1-3", hands="left")

    def stop(progress: Progress) -> None:
        raise InterruptedError

    with pytest.raises(InterruptedError):
        capture(PATTERN, progress=stop)


@pytest.fixture(scope="module")
def two_right_hands(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A photo of two hands that the detector rightly calls right ones."""
    path = tmp_path_factory.mktemp("two") / "two.png"
    halves = [cv2.imread(str(SAMPLE / f"hand.{n:04d}.jpg")) for n in (1, 10)]
    cv2.imwrite(str(path), np.hstack([half for half in halves if half is not None]))
    return path


def test_a_take_keeps_what_the_solver_was_given(two_right_hands, monkeypatch):
    """Also where one of two right hands is taken for a left one."""
    given: list[Track] = []

    def watched(*options: Any) -> TrackSolver:
        solve = get_solver(*options)
        return lambda model, track, *rest, **named: given.append(track) or solve(model, track, *rest, **named)

    monkeypatch.setattr(fitting, "get_solver", watched)
    take = capture(two_right_hands, hands="both")
    assert [hand.side for hand in take.hands] == ["right", "left"]
    for hand, track in zip(take.hands, given, strict=True):
        detected, kept = track.detections, hand.detections
        assert kept.side == detected.side == [SIDES.index("right")]
        assert (kept.score, kept.right_side) == (detected.score, detected.right_side)
        np.testing.assert_array_equal(kept.keypoints, detected.keypoints)
        np.testing.assert_array_equal(kept.world, detected.world)


def test_hand_length_decides_size_and_distance(two_right_hands, caplog):
    """An odd one is remarked on, once."""
    model = load_model(None, "right")
    small, large = (capture(PHOTO, hand_length=length).hands[0] for length in (0.16, 0.20))
    for hand, length in ((small, 0.16), (large, 0.20)):
        assert flat_hand_length(model, hand.betas) == pytest.approx(length, rel=0.01)
    assert large.transl[0, 2] / small.transl[0, 2] == pytest.approx(0.20 / 0.16, rel=0.05)
    assert not caplog.records
    assert len(capture(two_right_hands, hand_length=0.1).hands) == 2
    assert [("100 mm long" in r.getMessage()) for r in caplog.records] == [True]
    capture(PHOTO, hand_length=0.16, solver="paper-a")
    assert "paper-a takes no notice of the hand's length" in caplog.text


def test_a_bare_take_has_what_a_captures_has_but_hands():
    options = CaptureOptions(frames="3-9:2", lens=(1.5, 0.5, 0.25), solver="fast-per-frame")  # type: ignore
    captured, bare = capture(PATTERN, options), pipeline.bare_take(PATTERN, options)
    assert bare.intrinsics == Intrinsics(960.0, 960.0, 320.0, 120.0)
    np.testing.assert_array_equal(bare.frame_numbers, captured.frame_numbers)
    for name in ("source", "fps", "width", "height", "intrinsics", "solver", "model"):
        assert getattr(bare, name) == getattr(captured, name)
    assert bare.hands == ()
    with pytest.raises(InputError):
        pipeline.bare_take(SAMPLE / "gone.jpg", CaptureOptions())


@pytest.mark.parametrize(
    ("numbers", "rate"), [([1], 24.0), ([1, 3, 5, 6, 8, 10], 12.0), ([7, 8, 20, 21], 24.0)]
)
def test_frames_per_second_that_are_used(numbers, rate):
    """Of a sequence, 24 of its own; a frame that is missing does not count."""
    assert _rate(open_media(PATTERN), numbers) == rate


def test_filled_frames_have_a_pose_but_nothing_seen():
    truth = Take.load(SAMPLE / "truth.take.npz").hands[0]
    keypoints = np.concatenate([truth.keypoints_2d[0], np.zeros((21, 1))], axis=1)
    found = Detections.hand("right", 0.9, keypoints, np.zeros((21, 3)))
    rows = [np.array(a[:3]) for a in (truth.global_orient, truth.hand_pose, truth.transl)]
    for row in rows:
        row[2] = np.nan
    fit = HandMotion("right", truth.betas, *rows)
    camera = Intrinsics.assumed(640, 480)
    track = hand_track(load_model(None, "right"), track_of("right", [found, None, None]), fit, camera)
    np.testing.assert_array_equal(track.detected, [True, False, False])
    np.testing.assert_array_equal(track.filled, [False, True, False])
    np.testing.assert_array_equal(np.isfinite(track.joints_3d).all(axis=(1, 2)), [True, True, False])
    for seen_only in (track.keypoints_2d, track.reprojection_error, track.score):
        assert np.isfinite(seen_only[0]).all()
        assert np.isnan(seen_only[1:]).all()
    assert track.doubtful is None  # nobody looked
    assert track.refinable
    assert track.detections.frame.tolist() == [0]
    assert np.isnan(track.detections.right_side).all()  # nobody judged


@pytest.mark.parametrize("detector", ["direct", "mediapipe", "other"])
def test_likely_errors_are_of_what_they_were_measured_for(detector, monkeypatch):
    direct = DETECTORS.get("direct")
    others = Backend(open=direct.open, fingerprint=direct.fingerprint)
    if detector == "other":
        monkeypatch.setattr(DETECTORS, "get", lambda _name: others)
    taken = capture(PHOTO, detector=detector)
    (hand,), (told,) = taken.hands, hand_summaries(taken)
    assert hand.expected_error is not None
    assert np.isfinite(hand.expected_error).all() == (detector != "other") == told["error_known"]
    assert (hand.doubtful is None) == (detector == "other")
    assert (told["mean_expected_error"] is None) == (detector == "other")


def test_likely_errors_of_another_landmark_model_are_not_known(landmark_model, tmp_path, monkeypatch):
    path = tmp_path / "named.task"
    with zipfile.ZipFile(landmark_model) as known, zipfile.ZipFile(path, "w") as task:
        for name in known.namelist():
            task.writestr(name, known.read(name) + b"\0")
    monkeypatch.setenv("HANDFIT_LANDMARK_MODEL", str(path))
    assert [told["error_known"] for told in hand_summaries(capture(PHOTO))] == [False]


def test_other_programs_keypoints_have_no_likely_error(tmp_path):
    truth, path = Take.load(SAMPLE / "truth.take.npz"), tmp_path / "hands.json"
    points = np.pad(truth.hands[0].keypoints_2d[0], [(0, 0), (0, 1)])
    hand = {"handedness": truth.hands[0].side, "keypoints": points.tolist()}
    path.write_text(json.dumps({"frames": [{"hands": [hand]}]}))
    taken = capture(PHOTO, keypoints=path)
    (told,) = hand_summaries(taken)
    assert not told["error_known"]
    assert told["mean_expected_error"] is None
    assert taken.hands[0].doubtful is None
    result = report.Result("hands.json", "hands", status="ok")
    result.describe(taken)
    assert "(good" not in report.line(result)
    assert "likely error not known" in report.line(result)


@pytest.mark.parametrize(
    ("options", "error", "said"),
    [
        ({"intrinsics": Intrinsics(31.0, 640.0, 320.0, 240.0)}, OptionError, "between 32 and 640000 pixels"),
        ({"lens": (0.04, 0.5, 0.5)}, OptionError, "between 32 and 640000 pixels for a picture of 640x480"),
        ({"hands": "left"}, NoHandFoundError, "no left hand was found, only a right one"),
        ({"model": "gone.pkl"}, HandModelError, "no such hand model"),
        ({"model": "left.npz"}, HandModelError, "this is a left hand"),
        ({"solver": "magic"}, OptionError, "no solver 'magic'.*paper-a, "),
        ({"detector": "magic"}, OptionError, "no detector"),
    ],
    ids=str,
)
def test_what_cannot_be_captured(options, error, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save_model_npz(load_model(None, "left"), tmp_path / "left.npz")
    with pytest.raises(error, match=said):
        capture(PHOTO, **options)


SEEN = Detections.hand(
    "right",
    0.9,
    np.random.default_rng(0).uniform(100, 200, (21, 3)),
    np.random.default_rng(1).normal(0, 0.05, (21, 3)),
)


def plug_in(monkeypatch: pytest.MonkeyPatch, registry: Registry[Any], part: object) -> None:
    """As if a package had brought this part, of the name toy."""
    monkeypatch.setitem(registry._offered, "toy", EntryPoint("toy", "toys:TOY", registry._group))
    monkeypatch.setitem(registry._parts, "toy", part)


def finding(monkeypatch: pytest.MonkeyPatch, find: Callable[[float], object]) -> None:
    """Have a detector of the name toy that says this at each time in seconds."""

    class Toy(Detector):
        def find(self, rgb: np.ndarray | None, time: float = 0.0) -> Any:  # noqa: ARG002
            return find(time)

    plug_in(monkeypatch, DETECTORS, Backend(lambda _: Toy(), lambda _: "toy"))


def test_hands_without_numbers_are_left_out_and_their_stretch_is_kept(monkeypatch, caplog):
    lost = replace(SEEN, world=np.full((1, 21, 3), np.nan))
    finding(monkeypatch, lambda time: lost if 0.05 < time < 0.2 else SEEN)
    (hand,) = capture(PATTERN, frames="1-8", detector="toy").hands
    np.testing.assert_array_equal(hand.detected, [True] * 2 + [False] * 3 + [True] * 3)
    assert hand.present.all()
    (warning,) = [r.getMessage() for r in caplog.records]
    assert warning == "3 hands of the detector toy have numbers that are not finite: left out"


@pytest.mark.parametrize(
    ("find", "said"),
    [
        (lambda _: 1 / 0, "ZeroDivisionError: division by zero"),
        (lambda _: replace(SEEN, world=np.zeros((1, 20, 3))), "ValueError"),
    ],
)
def test_what_fails_in_a_detector_of_others_names_it(monkeypatch, find, said):
    finding(monkeypatch, find)
    with pytest.raises(
        PlugInError, match=rf"^the detector toy of toys failed \({said}.*choose another detector$"
    ):
        capture(PHOTO, detector="toy")


@pytest.mark.parametrize("make", [lambda *_: 1 / 0, lambda *_: lambda *_: 1 / 0, lambda *_: lambda *_: None])
def test_what_fails_in_a_part_of_others_names_it(monkeypatch, make):
    plug_in(monkeypatch, SOLVERS, Solver(make, "Toy", ""))
    with pytest.raises(PlugInError, match=r"^the solver toy of toys failed \((ZeroDivision|Attribute)Error"):
        capture(PHOTO, solver="toy")
    plug_in(monkeypatch, DETECTORS, Backend(lambda _: Path("gone").stat(), lambda _: "toy"))  # type: ignore
    with pytest.raises(PlugInError, match=r"^the detector toy of toys failed \(FileNotFoundError"):
        capture(PHOTO, detector="toy")


def test_public_names():
    assert all(getattr(handfit_core, name) is not None for name in handfit_core.__all__)


@pytest.mark.parametrize(
    ("photo", "sides"),
    [
        ("mona_lisa.jpg", ["right", "left"]),
        ("thumbs_up.png", ["right"]),
        ("two_hands.jpg", ["left", "left"]),  # both show their backs; they are two left hands
    ],
)
def test_photos(samples, photo, sides):
    found = capture(samples / "photos" / photo)
    assert [track.side for track in found.hands] == sides
    for track in found.hands:
        size = np.ptp(track.keypoints_2d[0], axis=0).max()
        half_hidden = (photo, track.side) == ("mona_lisa.jpg", "left")  # measured: 4.01 %
        assert track.reprojection_error[0] < (0.05 if half_hidden else 0.04) * size


def test_detector_agrees_with_mediapipes_own_output(samples):
    """Pixels of the same video from another build of the same model."""
    video = samples / "videos" / "asl_hand.mp4"
    points = np.array(json.loads((video.parent / "asl_hand.mediapipe_2d.json").read_text()))[:10, :, :2]
    (hand,) = capture(video, frames="1-10").hands
    assert np.median(np.linalg.norm(hand.keypoints_2d - points, axis=-1)) < 10.0


@pytest.mark.slow
def test_arms_are_stopped_as_hands_are(samples):
    """A capture keeps its hands, and a take to which they were to be added stays as it was."""
    photo = samples / "photos" / "mona_lisa.jpg"
    seen: list[Progress] = []
    stop = lambda: len(seen) > 1  # noqa: E731
    take = capture(photo, arms=True, progress=seen.append, should_stop=stop)
    assert [p.stage for p in seen][:2] == ["detect", "arms"]
    assert take.hands
    assert not any(hand.arm or hand.no_arm for hand in take.hands)
    with pytest.raises(Cancelled, match="stopped before the arms were found"):
        add_arms(take, should_stop=lambda: True)
    assert all(hand.arm for hand in add_arms(take).hands)


def test_a_measured_lens_is_taken_out_of_what_is_detected(tmp_path, monkeypatch):
    """By its name, in pictures of another size."""
    monkeypatch.setenv("HANDFIT_DATA", str(tmp_path))
    plain = capture(PHOTO)
    width, height = plain.width, plain.height
    camera, distortion = Intrinsics(1.2 * width, 1.2 * width, width, height), (-0.2, 0.05, 0.0, 0.0, 0.0)
    lens = Lens(camera, distortion, 2 * width, 2 * height)
    save_lens("a/b", MeasuredLens(lens, 0.2, 1.0, 20))
    taken = capture(PHOTO, lens="a/b")
    half = lens.scaled(width, height)
    assert taken.intrinsics == half.intrinsics
    assert taken.intrinsics == Intrinsics(0.6 * width, 0.6 * width, width / 2.0, height / 2.0)
    for hand, before in zip(taken.hands, plain.hands, strict=True):
        moved = half.undistorted(before.keypoints_2d)
        assert np.abs(moved - before.keypoints_2d).max() > 1.0
        np.testing.assert_array_equal(hand.keypoints_2d, moved)
    assert capture(PHOTO, lens=lens).hands[0].joints_3d.tobytes() == taken.hands[0].joints_3d.tobytes()
    with pytest.raises(OptionError, match="measured in pictures of 100x300"):
        capture(PHOTO, lens=Lens(lens.intrinsics, lens.distortion, 100, 300))
