"""Takes of two cameras made one. Of clips that do not go well together a sentence names the view, and what is
good becomes a take."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from handfit_core.__main__ import main
from handfit_core.capturing.fitting import hand_track
from handfit_core.capturing.options import CaptureOptions
from handfit_core.capturing.pipeline import capture
from handfit_core.capturing.views.joining import joined
from handfit_core.capturing.views.readings import ViewTake
from handfit_core.capturing.views.verdict import rotation_between
from handfit_core.common.errors import HandfitError
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.hand_model.motion import HandMotion
from handfit_core.interchange.taking import seen_of
from handfit_core.media.frame_range import FrameRange
from handfit_core.take import Take, at_rows, chosen
from tests.core.capturing.views.filmed import (
    CAMERA,
    FPS,
    FRAMES,
    OFFSET,
    TURN,
    from_second,
    moving,
    take_of,
    takes,
)
from tests.takes import seen_as

PAIR = "two_cameras/apart75"


def rows(clip: ViewTake, least: int, most: int) -> ViewTake:
    """Its frames with these numbers."""
    return replace(clip, take=chosen(clip.take, "both", FrameRange.parse(f"{least}-{most}"), None))


def bumped(degrees: float) -> tuple[ViewTake, ViewTake]:
    """The second camera turns in mid-shot."""
    first, second = takes()
    times = np.arange(FRAMES) / FPS + OFFSET
    state = from_second(moving(times))
    turn = cv2.Rodrigues(np.radians(degrees) * np.array([0.3, 0.8, 0.5]))[0]
    late = (np.arange(FRAMES) >= FRAMES // 2)[:, None]
    root = np.where(late[..., None], turn @ state.root, state.root)
    wrist = np.where(late, state.wrist @ turn.T, state.wrist)
    return first, replace(second, take=take_of(replace(state, root=root, wrist=wrist), "/b.mp4"))


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
    later = chosen(take, "both", None, None), chosen(take, "both", FrameRange.parse("11-60"), None)
    assert [each.cameras and each.cameras.time_offset[1] for each in later] == pytest.approx(
        [take.cameras.time_offset[1], take.cameras.time_offset[1] - 10.0 / FPS]
    )


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
        (lambda: takes(0, 7), "do not agree"),
        (lambda: (takes()[0],) * 2, "one clip given twice"),
        (lambda: (rows(takes()[0], 1, 22), takes()[1]), "frames at the same time, and 20"),
        (lambda: (rows(takes()[0], 1, 30), rows(takes()[1], 40, 70)), "view, "),
        (lambda: bumped(25.0), "a camera was moved"),
    ],
    ids=["other scenes", "one clip twice", "few frames", "other moments", "moved camera"],
)
def test_views_that_do_not_belong_together(views, said):
    first, second = views()
    take = joined(first, second, CaptureOptions())
    assert take.verdict is not None
    assert take.verdict.agreement == "failed", take.verdict.text
    assert said in take.verdict.text
    assert any(f"The {nth} view, {name}, was used alone." in take.verdict.text for nth, name in NAMED)
    assert take.cameras is None
    assert take.hands


NAMED = (("first", "a"), ("second", "b"), ("second", "a"))


def test_an_offset_that_leaves_nothing_in_common():
    take = joined(*takes(), CaptureOptions(view="b.mp4", offset=120.0))
    assert take.verdict is not None
    assert "with an offset of 120 seconds. The first view" in take.verdict.text


def test_frames_of_a_rate_that_varies():
    """Two of three of the second view's frames are missing in its first half."""
    first, second = takes()
    kept = np.array([i for i in range(FRAMES) if i >= FRAMES // 2 or i % 3 == 0])
    fewer = replace(
        second.take,
        frame_numbers=1 + kept,
        hands=tuple(at_rows(hand, kept) for hand in second.take.hands),
    )
    take = joined(first, ViewTake(fewer, lens_known=True), CaptureOptions())
    assert take.verdict is not None
    assert take.verdict.agreement != "failed", take.verdict.text
    assert take.cameras is not None
    assert abs(take.cameras.time_offset[1] - OFFSET) * FPS < 0.5
    again = Take.from_bytes(take.to_bytes())
    assert again.cameras is not None
    np.testing.assert_array_equal(again.cameras.views[0].frame_numbers, 1 + kept)


def test_frames_that_the_second_view_alone_has():
    first, second = takes()
    (hand,), missing = first.take.hands, slice(30, 56)
    lost = np.zeros(FRAMES, dtype=bool)
    lost[missing] = True
    seen = {
        name: np.where(
            lost.reshape(-1, *[1] * (value.ndim - 1)), False if value.dtype == bool else np.nan, value
        )
        for name, value in vars(hand).items()
        if isinstance(value, np.ndarray) and value.shape[:1] == (FRAMES,)
    }
    gap = replace(first, take=replace(first.take, hands=(seen_as(replace(hand, **seen), detected=~lost),)))
    whole, take = (joined(each, second, CaptureOptions()).hands[0] for each in (first, gap))
    np.testing.assert_array_equal(take.filled, lost)
    away = np.linalg.norm(take.joints_3d[lost] - whole.joints_3d[lost], axis=2)
    assert away.mean() < 0.012
    alone = joined(gap, rows(second, 1, 20), CaptureOptions()).hands[0]
    assert not alone.present[lost].any()


@pytest.mark.usefixtures("landmark_model")
class TestFiles:
    """Captures of real files."""

    def test_a_view_without_hands(self, samples, tmp_path):
        clip, empty = samples / PAIR / "clip1_a.mp4", tmp_path / "wall.mp4"
        film = cv2.VideoWriter(str(empty), cv2.VideoWriter_fourcc(*"mp4v"), 30.0, (320, 240))
        for _ in range(12):
            film.write(np.full((240, 320, 3), 90, np.uint8))
        film.release()
        take = capture(empty, view=str(clip), quality="draft", hands="auto")
        assert take.verdict is not None
        said = f"No hand was found in the first view. The second view, {clip.stem}, was used alone."
        assert take.verdict.text == said
        assert take.hands

    @pytest.mark.slow
    def test_stopped_while_views_are_joined(self, samples):
        seen: list[tuple[str, int]] = []

        view = str(samples / PAIR / "clip1_b.mp4")
        take = capture(
            samples / PAIR / "clip1_a.mp4",
            CaptureOptions(view=view, quality="draft"),
            lambda each: seen.append((each.stage, each.view)),
            lambda: ("join", 0) in seen,
        )
        assert take.verdict is not None
        assert take.verdict.text.startswith(
            "The capture was stopped before both views were joined. The first"
        )
        assert take.hands
        of_views = [(stage, view) for view in (0, 1) for stage in ("detect", "fit")]
        assert list(dict.fromkeys(seen)) == [*of_views, ("join", 0)]

    def test_a_batch_of_pairs(self, samples, tmp_path):
        folder = tmp_path / "in"
        folder.mkdir()
        for view in "ab":
            (folder / f"shot_{view}.mp4").symlink_to(samples / PAIR / f"clip1_{view}.mp4")
        words = ["batch", str(folder), "-o", str(tmp_path / "out"), "--jobs", "1", "--progress", "none"]
        assert main([*words, "--views", "--baseline", "0.6", "--quality", "draft"]) == 0
        (entry,) = json.loads((tmp_path / "out" / "report.json").read_text())["inputs"]
        assert (entry["name"], entry["views"]["agreement"]) == ("shot", "good")
        assert Take.load(tmp_path / "out" / "shot" / "shot.take.npz").cameras is not None

    @pytest.mark.parametrize("text", ["", "[cam_0]\nname = 'x'\n"], ids=["empty", "one camera"])
    def test_a_calibration_that_is_none(self, samples, tmp_path, text):
        """A calibration file that is none is refused before hands are looked for."""
        rig = tmp_path / "rig.toml"
        rig.write_text(text)
        views = [str(samples / PAIR / f"clip1_{view}.mp4") for view in "ab"]
        with pytest.raises(HandfitError, match=r"rig\.toml: not a calibration of two cameras"):
            capture(views[0], None, lambda _: pytest.fail("began"), view=views[1], cameras=str(rig))


def test_views_of_many_hours_are_told_of():
    clips = [replace(clip, take=replace(clip.take, fps=FPS / 20_000.0)) for clip in takes()]
    verdict = joined(*clips, CaptureOptions()).verdict
    assert verdict is not None
    assert verdict.agreement == "failed"
    assert verdict.text.startswith("The views are longer than the 60 minutes in which")
