"""Takes, help texts and the take's fields are what they were when tests/golden was written."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.__main__ import _parser
from handfit_core.capturing.pipeline import capture
from handfit_core.common.skeleton import SIDES
from handfit_core.detect.detector import Quality
from handfit_core.hand_model import save_model_npz
from handfit_core.take import Take
from tests.conftest import ROOT
from tests.core.detect.clips import write_two_hands
from tests.golden import TAKE, Golden, numbers
from tests.imitation_mano import imitation_model

SAMPLE = str(ROOT / "samples" / "rendered_hand" / "hand.%04d.jpg")
PHOTOS = {
    "painting": ROOT / "samples" / "mona_lisa" / "mona_lisa.jpg",
    "photo": ROOT / "samples" / "rendered_hand" / "hand.0012.jpg",
}

PROCESSORS = 15
"""Tenths of a pixel or millimetre by which takes differ from processor to processor"""


def described(take: Take) -> str:
    """A take in lines: all facts, and the numbers of five frames."""
    lines = [
        f"{take.source.kind} of {len(take.frame_numbers)} frames from {take.frame_numbers[0]}",
        f"{take.width} x {take.height}, {take.fps:g} per second, by {take.solver} with {take.model}",
        f"intrinsics {numbers(np.array([take.intrinsics.fx, take.intrinsics.fy]), 1)}",
    ]
    for hand in take.hands:
        rows = np.flatnonzero(hand.present)
        rows = rows[np.unique(np.linspace(0, len(rows) - 1, 5).round().astype(int))]
        lines += [f"{hand.side} hand in {int(hand.present.sum())} frames"]
        lines += [f"  shown in {np.flatnonzero(hand.detected).tolist()}"]
        for row in rows:
            wrist = hand.joints_3d[row] - hand.joints_3d[row, 0]
            lines += [
                f"  frame {take.frame_numbers[row]}",
                f"    keypoints_2d px {numbers(hand.keypoints_2d[row], 1)}",
                f"    joints from wrist mm {numbers(1000.0 * wrist, 1)}",
            ]
            if hand.expected_error is not None:
                lines.append(f"    expected_error mm {numbers(1000.0 * hand.expected_error[row], 1)}")
    return "\n".join(lines) + "\n"


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("clip") / "two.mp4"
    write_two_hands(path)
    return path


@pytest.mark.usefixtures("landmark_model")
@pytest.mark.parametrize("quality", ["standard", "draft"])
@pytest.mark.parametrize("name", PHOTOS)
def test_photos(golden: Golden, name: str, quality: Quality) -> None:
    golden.check(f"{name}-{quality}.txt", described(capture(PHOTOS[name], quality=quality)), PROCESSORS)


@pytest.mark.usefixtures("landmark_model")
@pytest.mark.parametrize("quality", ["standard", "draft"])
def test_a_sequence(golden: Golden, quality: Quality) -> None:
    golden.check(f"sequence-{quality}.txt", described(capture(SAMPLE, quality=quality)), PROCESSORS)


@pytest.mark.usefixtures("landmark_model")
@pytest.mark.parametrize("quality", ["standard", "draft"])
def test_a_video(golden: Golden, clip: Path, quality: Quality) -> None:
    take = capture(clip, frames="30-130", quality=quality)
    golden.check(f"video-{quality}.txt", described(take), PROCESSORS)


@pytest.mark.usefixtures("landmark_model")
def test_a_model_of_ones_own(golden: Golden, tmp_path: Path) -> None:
    for side in SIDES:
        save_model_npz(imitation_model(side), tmp_path / f"MANO_{side.upper()}.npz")
    take = capture(PHOTOS["photo"], model=tmp_path)
    golden.check("own-model.txt", described(take).replace(str(tmp_path), "MODEL"), PROCESSORS)


def test_keypoints_of_another_program(golden: Golden, tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    take = Take.load(TAKE)
    lines = ["frame,hand,landmark,x,y,z"]
    for hand in take.hands:
        for row in np.flatnonzero(hand.detected):
            for point, (x, y) in enumerate(hand.keypoints_2d[row]):
                lines.append(f"{take.frame_numbers[row]},{hand.side},{point},{x:.3f},{y:.3f},0")
    path.write_text("\n".join(lines), encoding="utf-8")
    read = capture(path, picture_size=(take.width, take.height), fps=take.fps)
    golden.check("keypoints.txt", described(read), PROCESSORS)


def test_todays_take_opens(golden: Golden) -> None:
    golden.check("two_hands.txt", described(Take.load(TAKE)), 1)


def test_fields_of_a_take(golden: Golden, tmp_path: Path) -> None:
    with np.load(Take.load(TAKE).save(tmp_path / "again.take.npz"), allow_pickle=False) as arrays:
        lines = [f"{name} {arrays[name].dtype.kind} {arrays[name].shape}" for name in arrays.files]
    golden.check("take-fields.txt", "\n".join(sorted(lines)) + "\n")


def test_help(golden: Golden, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    texts = [f"==== {parser.prog}\n{parser.format_help()}" for parser in parsers(_parser())]
    golden.check("help.txt", "\n".join(texts))


def parsers(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """A parser and those of its commands."""
    yield parser
    actions: list[Any] = parser._actions
    for action in actions:
        if isinstance(action, argparse._SubParsersAction):
            for child in action.choices.values():
                yield from parsers(child)
