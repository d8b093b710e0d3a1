"""HaWoR's folders of JSON in the camera's frame, and its hands in the world as arrays."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.errors import InputError
from handfit_core.interchange.opening import is_recording
from handfit_core.pipeline import capture
from handfit_core.skeleton import SIDES
from tests.conftest import ROOT
from tests.core.interchange.known_hands import FRAMES, HANDS, assert_same_hand, hand_of, own_mano, read, says

SEQUENCE = str(ROOT / "samples" / "rendered_hand" / "hand.%04d.jpg")


def clip(folder: Path, **changes: Any) -> Path:
    """The folder that HaWoR makes of a clip: the right hand in one piece, the left one in two."""
    for index, side in enumerate(SIDES):
        at = folder / "cam_space" / str(index)
        at.mkdir(parents=True)
        hand = HANDS[side]
        for first, last in [(0, 2), (4, FRAMES - 1)] if side == "left" else [(0, FRAMES - 1)]:
            rows = slice(first, last + 1)
            content = {
                "init_root_orient": hand.matrices[None, rows, 0].tolist(),
                "init_hand_pose": hand.matrices[None, rows, 1:].tolist(),
                "init_trans": hand.transl[None, rows].tolist(),
                "init_betas": np.tile(hand.betas, (1, last - first + 1, 1)).tolist(),
                **changes,
            }
            (at / f"{first}_{last}.json").write_text(json.dumps(content), encoding="utf-8")
    (folder / "extracted_images").mkdir()
    return folder


@pytest.mark.parametrize("given", ["clip", "cam_space"])
def test_the_camera_space(tmp_path: Path, given: str) -> None:
    folder = clip(tmp_path / "video")
    path = folder if given == "clip" else folder / "cam_space"
    assert is_recording(path)
    recording = read(path)
    assert recording.format == "hawor"
    assert recording.frame_numbers.tolist() == list(range(1, FRAMES + 1))
    assert_same_hand(hand_of(recording, "right"), HANDS["right"])
    left = hand_of(recording, "left")
    assert left.present.tolist() == [True, True, True, False, True, True, True]
    np.testing.assert_allclose(np.asarray(left.transl)[left.present], HANDS["left"].transl[left.present])
    assert says(recording, "count from 1")
    assert len(capture(path).hands) == 2


def test_hands_lie_where_their_pictures_have_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Far to the side, where a virtual camera would not see them."""
    aside = np.tile([0.3, 0.0, 0.5], (FRAMES, 1))
    hands = {side: replace(hand, transl=aside) for side, hand in HANDS.items()}
    monkeypatch.setattr("tests.core.interchange.test_hawor.HANDS", hands)
    folder = clip(tmp_path / "video")
    camera = [900.0, 900.0, 960.0, 540.0]
    for take in (capture(SEQUENCE, keypoints=folder), capture(folder, intrinsics=camera)):
        placed = read(folder).posed[0].transl
        assert placed is not None
        np.testing.assert_allclose(take.hands[0].transl[: FRAMES - 4], placed[: FRAMES - 4], atol=1e-9)
    assert "moved" not in caplog.text
    alone = capture(folder)
    assert np.nanmin(alone.hands[0].transl[:, 2]) > 0.7
    assert "outside the view of a virtual camera: all are moved before it, by -0.30, " in caplog.text


def test_a_hand_that_is_not_in_the_wanted_frames_is_no_hand_of_the_take(tmp_path: Path) -> None:
    """The left one is not in the fourth."""
    take = capture(clip(tmp_path / "video"), frames="4")
    assert [hand.side for hand in take.hands] == ["right"]


def test_its_betas_fit_the_users_mano(tmp_path: Path) -> None:
    recording = read(clip(tmp_path / "video"), model=str(own_mano(tmp_path / "mano")))
    np.testing.assert_allclose(hand_of(recording, "left").betas, HANDS["left"].betas)


def five() -> dict[str, np.ndarray]:
    """world_space_res by names, left hand first; the left one is not there in the last frame."""
    both = [HANDS[side] for side in SIDES]
    valid = np.ones((2, FRAMES))
    valid[0, -1] = 0.0
    return {
        "trans": np.stack([hand.transl for hand in both]),
        "rot": np.stack([hand.global_orient for hand in both]),
        "hand_pose": np.stack([hand.hand_pose for hand in both]),
        "betas": np.stack([np.tile(hand.betas, (FRAMES, 1)) for hand in both]),
        "valid": valid,
    }


@pytest.mark.parametrize("kind", ["npz", "npz of pred_", "pickle"])
def test_the_world_space(tmp_path: Path, kind: str) -> None:
    path = tmp_path / ("world_space_res.pkl" if kind == "pickle" else "world_space_res.npz")
    if kind == "pickle":
        path.write_bytes(pickle.dumps(list(five().values())))
    else:
        np.savez(
            path, **{("pred_" if "pred" in kind else "") + name: value for name, value in five().items()}
        )
    recording = read(path)
    assert recording.format == "hawor"
    assert_same_hand(hand_of(recording, "right"), HANDS["right"])
    assert hand_of(recording, "left").present.sum() == FRAMES - 1
    assert says(recording, "its world")


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"init_trans": [[[0.0, 0.0, 1.0]]]}, "init_trans has 1 rows where 3 are expected"),
        ({"init_hand_pose": [[1.0]]}, "shape Nx45"),
        ({"init_root_orient": None}, "no hands or keypoints of a program that is known"),
        ({"init_betas": "none"}, "init_betas must be numbers|betas must be numbers"),
    ],
)
def test_what_is_wrong_is_said(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        read(clip(tmp_path / "video", **changes))


def test_a_name_of_a_milliard_frames(tmp_path: Path) -> None:
    folder = clip(tmp_path / "video")
    (folder / "cam_space" / "1" / f"0_{FRAMES - 1}.json").rename(
        folder / "cam_space" / "1" / "0_999999999.json"
    )
    with pytest.raises(InputError, match="1000000000 frames, and at most 100000 are read"):
        read(folder)
